"""The hand-over's rate limit: physical on the whole way, and its rate kept."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_inertia.estimation.online.slew import Slew
from jax_inertia.maths import inertial_parameters

DT, STEPS, PAIRS = 0.003, 400, 500


@pytest.fixture(scope="module")
def pairs() -> np.ndarray:
    """Nominal bodies and what they may become with a load: (2, pairs, 10), of all sizes and shapes."""
    rng = np.random.default_rng(0)
    theta = rng.normal(size=(2, PAIRS, 10)) * np.array([0.5] + [0.5] * 3 + [0.3] * 3 + [0.1] * 3)
    theta[..., 1:4] -= 2.0
    load = np.asarray(inertial_parameters.from_log_cholesky_uut(jnp.asarray(theta)))
    return np.stack([load[0], load[0] + load[1]])


def path(slew: Slew, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """What is handed over, (steps + 1, pairs, 10)."""

    @jax.jit
    def run(start, end):
        def one(handed, _):
            handed = slew.step(handed, end, DT)
            return handed, handed

        return jax.lax.scan(one, start, None, length=STEPS)[1]

    return np.concatenate([start[None], np.asarray(run(jnp.asarray(start), jnp.asarray(end)))])


@pytest.mark.parametrize("reverse", [False, True], ids=["pick_up", "put_down"])
def test_every_step_is_physical_within_the_rate_and_arrives(pairs, reverse):
    start, end = pairs[::-1] if reverse else pairs
    slew = Slew(rate=3.0, reach=0.2)
    handed = path(slew, start, end)
    assert np.all(inertial_parameters.is_physical(jnp.asarray(handed)))
    step = np.abs(np.diff(handed, axis=0)) / 0.2 ** np.array([0.0] + [1.0] * 3 + [2.0] * 6)
    assert np.max(step) <= 3.0 * DT * (1 + 1e-9)
    # It uses what it is allowed until it has arrived, after distance / rate.
    distance = np.max(np.abs(end - start) / 0.2 ** np.array([0.0] + [1.0] * 3 + [2.0] * 6), axis=1)
    arrived = distance < 3.0 * DT * STEPS
    assert arrived.mean() > 0.2
    np.testing.assert_allclose(handed[-1, arrived], end[arrived], rtol=1e-9, atol=1e-12)
    late = int(0.99 * distance[arrived].max() / (3.0 * DT))
    slowest = np.flatnonzero(arrived)[np.argmax(distance[arrived])]
    assert not np.allclose(handed[late, slowest], end[slowest], rtol=1e-9, atol=1e-12)


def test_a_limit_on_each_component_would_leave_the_physical_set(pairs):
    """The alternative that the design rules out: how many of the same paths it would spoil."""
    start, end = pairs
    most = 3.0 * DT * 0.2 ** np.array([0.0] + [1.0] * 3 + [2.0] * 6)
    handed, spoilt = start.copy(), np.zeros(PAIRS, bool)
    for _ in range(STEPS):
        handed = handed + np.clip(end - handed, -most, most)
        spoilt |= ~np.asarray(inertial_parameters.is_physical(jnp.asarray(handed)))
    assert spoilt.mean() > 0.5


def test_a_moving_estimate_is_chased_and_never_left(pairs):
    """The target jumps at every step between bodies: still physical, since the set is convex."""
    slew = Slew(rate=50.0)
    handed = jnp.asarray(pairs[0])
    step = eqx.filter_jit(slew.step)
    for k in range(100):
        handed = step(handed, jnp.asarray(np.roll(pairs[k % 2], k, axis=0)), DT)
        assert np.all(inertial_parameters.is_physical(handed))


def test_the_mass_moves_at_the_paper_s_rate():
    """A ball's mass from 1 to 4 kg at 3 kg/s: one second."""
    eye = 0.001 * jnp.eye(3)
    one, four = (
        inertial_parameters.from_com(jnp.asarray(m), jnp.zeros(3), m * eye) for m in (1.0, 4.0)
    )
    slew = Slew(3.0)
    handed = slew.step(one, four, 0.5)
    assert float(handed[0]) == pytest.approx(2.5)
    np.testing.assert_allclose(slew.step(handed, four, 0.5), four, rtol=1e-12)
    assert np.array_equal(slew.step(four, four, 0.0), four)


@pytest.mark.parametrize("name", ["rate", "reach"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_settings_that_limit_nothing_are_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} is {value}; it must be positive and finite"):
        Slew(**{name: value})


@pytest.mark.parametrize("dt", [0.0, -DT, np.nan, np.inf])
def test_the_last_value_is_held_where_time_does_not_pass(pairs, dt):
    start, end = jnp.asarray(pairs)
    assert np.array_equal(eqx.filter_jit(Slew().step)(start, end, dt), start)


@pytest.mark.parametrize("fault", [np.nan, np.inf])
def test_a_body_without_a_finite_estimate_holds_and_the_others_go_on(pairs, fault):
    start, end = jnp.asarray(pairs)
    handed = np.array(Slew().step(start, end.at[0, 3].set(fault), DT))
    assert np.array_equal(handed[0], start[0])
    np.testing.assert_allclose(handed[1:], Slew().step(start, end, DT)[1:])
