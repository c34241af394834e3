"""What is decided between the fits of replays: effects taken back, and what is dropped."""

import numpy as np
import pytest

from jax_inertia.replay.fitting.errors import Weights
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.loop import ALL, Parameter
from jax_inertia.replay.record import Commanded, Record
from jax_inertia.replay.search import choice, held_out
from jax_inertia.replay.search.held_out import Unseen
from jax_inertia.replay.simulation.plant import Plant

NONE = np.zeros(0)


def table(*families: str) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(f, ALL if f == "target_delay" else k, 0.0, 1.0, -9.0, 9.0)
        for k, f in enumerate(families)
    )


def fitted(theta, sd, *families: str) -> Fit:
    size = np.eye(len(sd))
    weights = Weights(NONE, NONE)
    return Fit(
        table(*families), np.array(theta), np.diag(np.square(sd)), size, 9.0, NONE, NONE, weights
    )


def record() -> Record:
    """Two joints whose encoders have steps of 1 mrad."""
    time = 0.01 * np.arange(400)
    q = np.round(np.sin(np.outer(time, [3.0, 4.0])), 3)
    return Record(time, q, np.zeros(2), Commanded(time, q))


class Joints(Plant):
    def __init__(self):
        self.names = ("a", "b")


@pytest.fixture
def unseen(monkeypatch):
    """Replays of two joints that err by what their numbers miss of (0.3, 0.2), at every sample."""

    def errors(plant, table, thetas, records):
        miss = np.asarray(thetas)[:, :2] - [0.3, 0.2]
        miss[:, 0] += np.asarray(thetas)[:, 2:].sum(axis=1)
        return np.repeat(miss[:, None], 400, axis=1)

    monkeypatch.setattr(held_out, "replay_errors", errors)
    return Unseen(Joints(), [record()])


def test_effects_are_taken_back_one_at_a_time_and_show_by_a_step_of_an_encoder(unseen):
    found = fitted([0.3, 0.2, 2e-4], [1.0] * 3, *["coulomb_friction"] * 3)
    errors = unseen.taken_back(found, [(0,), (1,), (2,), (0, 1)])
    np.testing.assert_allclose(
        errors[:, 0],
        [[2e-4, 0], [2e-4 - 0.3, 0], [2e-4, -0.2], [0, 0], [2e-4 - 0.3, -0.2]],
        atol=1e-12,
    )
    assert unseen.shown(errors).tolist() == [True, True, False, True]


def test_a_number_that_harms_is_dropped_and_shares_are_of_what_is_left(unseen):
    """0.1 too much at one joint is taken back; then both others take what they should of the error."""
    found = fitted([0.3, 0.2, 0.1], [1.0] * 3, *["coulomb_friction"] * 3)
    left, shares = choice.gated(Joints(), found, [], [record()])
    assert left.theta.tolist() == [0.3, 0.2, 0.0]
    total = 0.3**2 + 0.2**2
    assert shares == pytest.approx({(0,): 0.3**2 / total, (1,): 0.2**2 / total})


def test_no_more_effects_are_dropped_than_may_be(unseen):
    """Five harm; the last look is at what is left after three are gone."""
    found = fitted([0.3, 0.2, *[0.02] * 5], [1.0] * 7, *["coulomb_friction"] * 7)
    left, shares = choice.gated(Joints(), found, [], [record()])
    assert np.sum(left.theta == 0.02) == 5 - choice._DROPPED
    assert set(shares) == {(k,) for k in np.flatnonzero(left.theta)}
