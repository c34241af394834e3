"""What stands out of noise in the motion's own band, on numbers drawn as whitened noise has them."""

import numpy as np
import pytest

from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.strain import Strangeness, strangeness

ROWS, MODES = 20, 60


class Drawn(Evidence):
    """A log that is nothing but its slow numbers."""

    slow_modes = MODES

    def __init__(self, numbers: np.ndarray):
        self.y = numbers.ravel()
        self.used = np.ones((MODES, ROWS), bool)

    def slow(self, x):
        return x

    def charged(self, y):
        return y.ravel()


def noise(seed: int, draws: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((draws, MODES, ROWS))


def judged(numbers: np.ndarray, replicas: np.ndarray, known: bool = True) -> Strangeness:
    return strangeness(Drawn(numbers), replicas, float(numbers.size), known, [])


@pytest.fixture(scope="module")
def replicas():
    return noise(0, 6)


def test_noise_alone_does_not_stand_out(replicas):
    assert max(judged(x, replicas).most for x in noise(1, 1000)) < 1.0


def test_one_joint_of_many_stands_out_of_its_own_noise(replicas):
    for x in noise(2, 100):
        x[:, 7] *= 2.0
        found = judged(x, replicas)
        # Beside the noise of all joints it is nothing.
        assert found.misfit < 1.0 < found.slow


def test_where_the_noise_is_not_known_it_may_be_the_noise(replicas):
    (x,) = noise(3, 1)
    x[:, 7] *= 1.7
    assert judged(x, replicas, known=False).most < 1.0


def test_a_row_that_counts_nowhere_says_nothing(replicas):
    (x,) = noise(4, 1)
    still = replicas.copy()
    still[:, :, 3] = x[:, 3] = 0.0
    assert judged(x, still).most < 1.0
