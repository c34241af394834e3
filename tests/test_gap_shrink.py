"""How large a gap is before and after, its floor, and how far it shrinks on another motion."""

import numpy as np
import pytest

from jax_inertia.gap.energies import Counted, Energies, holding

ROWS, RATE = 400, 50.0


def energies(rng, size=1.0, remains=0.0, model=0.0, seconds=8.0):
    """A gap of which a share remains, over noise of 0.2 N m and an error of the model, on two rows."""
    shape = (round(RATE * seconds), 2)
    gap = size * np.sin(np.arange(shape[0]) / 15.0)[:, None] * np.ones(2)
    error = model * np.cos(np.arange(shape[0]) / 9.0)[:, None] * np.ones(2)
    noise = 0.2 * rng.standard_normal(shape)
    replicas = 0.2 * rng.standard_normal((6, *shape))
    everywhere = Counted(np.ones(shape, bool))
    after = remains * gap + error + noise
    return Energies.of(everywhere, gap + error + noise, after, error, replicas)


def test_floor_is_noise_and_the_models_own_errors():
    shrink = energies(np.random.default_rng(0), size=3.0, remains=0.3, model=1.0).shrink
    assert shrink.sensors == pytest.approx(0.2, rel=0.05)
    assert shrink.excused == pytest.approx(np.sqrt(0.5), rel=0.05)
    assert shrink.share == pytest.approx(0.7, abs=0.03)


def test_errors_that_undo_what_is_left_are_no_floor_of_their_own():
    """An error of the model that runs against what an effect leaves takes from the energy, and does not add to it."""
    rng = np.random.default_rng(0)
    left = rng.standard_normal((ROWS, 2))
    everywhere, none = Counted(np.ones(left.shape, bool)), np.zeros((1, ROWS, 2))
    against = Energies.of(everywhere, 3.0 * left, left, -left, none).shrink
    assert against.excused == 0.0
    with_it = Energies.of(everywhere, 3.0 * left, left, left, none).shrink
    assert with_it.excused == pytest.approx(with_it.after)


def test_frequencies_that_the_motion_lacks_do_not_count():
    """A gap that noise above the motion's own band hides is measured below that."""
    rng = np.random.default_rng(0)
    slow = 0.3 * np.sin(np.arange(ROWS) / 15.0)[:, None] * np.ones(2)
    noise, *replicas = 0.5 * rng.standard_normal((7, ROWS, 2))
    everywhere = np.ones((ROWS, 2), bool)
    # 15 samples a radian are 8.5 half periods in all of them.
    band = Counted(everywhere, modes=20)
    assert band.rms(slow) == pytest.approx(0.3 / np.sqrt(2), rel=0.03)
    assert band.rms(noise) == pytest.approx(0.5 * np.sqrt(20 / ROWS), rel=0.3)
    everything, within = (
        Energies.of(c, slow + noise, 0.5 * slow + noise, 0.0 * slow, np.array(replicas)).shrink
        for c in (Counted(everywhere), band)
    )
    assert everything.share is None
    assert within.share == pytest.approx(0.5, abs=0.1)


def test_rows_that_hold_the_gap():
    assert holding([0.01, 0.4, 0.59]) == [2, 1]
    assert holding([0.0, 0.0]) == [0]


def test_what_no_model_predicts_does_not_count():
    rng = np.random.default_rng(0)
    moving = np.ones((ROWS, 2), bool)
    moving[100:200] = False
    torque = rng.standard_normal((ROWS, 2))
    at_rest = np.where(moving, torque, 50.0)
    zero = np.zeros_like(torque)
    shrink = Energies.of(Counted(moving), at_rest, at_rest, zero, zero[None]).shrink
    assert shrink.before == pytest.approx(1.0, rel=0.1)


def test_nothing_that_counts_is_no_gap():
    zero = np.zeros((ROWS, 2))
    nowhere = Counted(np.zeros((ROWS, 2), bool))
    shrink = Energies.of(nowhere, zero + 1.0, zero, zero, zero[None]).shrink
    assert (shrink.before, shrink.noise, shrink.share) == (0.0, 0.0, None)


@pytest.mark.parametrize("remains", [0.0, 0.2, 0.5])
def test_interval_holds_the_shrink_on_another_motion(remains):
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(100):
        interval = energies(rng, 0.6, remains).interval(RATE)
        share = energies(rng, 0.6, remains).shrink.share
        assert interval is not None
        assert share is not None
        held += interval[0] <= share <= interval[1]
    assert held >= 90


def test_interval_is_wider_where_equations_err():
    one = energies(np.random.default_rng(0), 3.0, 0.1)
    narrow, wide = one.interval(RATE), one.interval(RATE, 0.02 * float(one.before.sum()))
    assert narrow is not None
    assert wide is not None
    assert wide[0] < narrow[0] < narrow[1] < wide[1]


def test_below_the_floor_nothing_is_foretold():
    none, noise = np.zeros((ROWS, 2)), np.ones((1, ROWS, 2))
    everywhere = Counted(np.ones((ROWS, 2), bool))
    assert Energies.of(everywhere, none + 0.5, none + 0.5, none, noise).interval(RATE) is None
