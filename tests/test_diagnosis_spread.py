"""What parts of a log say of a number, against draws of noise that is as the evidence takes it, and that is not."""

import numpy as np
import pytest

from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.diagnosis.effects.joint import ViscousFriction
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search.evidence import Evidence
from jax_inertia.diagnosis.search.selection import Selection

ROWS, NOISE, DRAWS = 200, 0.3, 400


def columns(most: float) -> np.ndarray:
    """Two numbers' columns, of which one tenth of the rows says `most` times what another does of the first."""
    out = np.random.default_rng(0).normal(size=(ROWS, 2))
    out[60:80, 0] *= np.sqrt(most)
    return out


def spread(x: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(what the parts say, the posterior's own covariance) of two numbers that are zero."""
    h = Hypothesis(
        *(ViscousFriction(), Place("joint", "elbow", 0), (), x, 0),
        *(np.full(2, 5.0), np.zeros(2), 8.0),
    )
    evidence = Evidence(error[:, None], np.ones((ROWS, 1)), np.array([NOISE]))
    now = evidence.posterior((h,))
    # Of a log's residual its rows alone are asked for.
    residual = Residual.__new__(Residual)
    residual.y = error[:, None]
    selection = Selection(residual, evidence, now, (), ())
    return selection.spread, now.covariance


@pytest.mark.parametrize("most", [1.0, 100.0])
def test_of_noise_that_is_independent_parts_say_what_the_whole_does(most):
    rng, x = np.random.default_rng(1), columns(most)
    said, own = zip(*(spread(x, NOISE * rng.normal(size=ROWS)) for _ in range(DRAWS)), strict=True)
    np.testing.assert_allclose(
        np.diag(np.mean(said, axis=0)), np.diag(np.mean(own, axis=0)), rtol=0.15
    )


def test_of_what_goes_together_for_a_tenth_of_the_log_they_say_more():
    rng, x = np.random.default_rng(2), np.ones((ROWS, 2)) * [[1.0, 0.0]]
    together = [np.repeat(NOISE * rng.normal(size=10), ROWS // 10) for _ in range(DRAWS)]
    said, own = zip(*(spread(x, e) for e in together), strict=True)
    assert np.mean(said, axis=0)[0, 0] > 10 * np.mean(own, axis=0)[0, 0]
