"""The walking plan's parts: DCM recursion, swing, footholds, phases."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import FAST

from jax_inertia.control import walking as w
from jax_inertia.control.terms import Terms

OMEGA = jnp.asarray(3.1)


def walk(height: np.ndarray | None = None, **changes) -> w.Walk:
    ground = w.Ground(
        jnp.asarray(np.zeros((1, 1)) if height is None else height),
        jnp.array([-1.0, -1.0]),
        jnp.asarray(0.4),
    )
    numbers = {
        "start": 1.0,
        "step": 0.25,
        "knows_ground": 1.0,
        "half_width": 0.13,
        "pelvis_height": 1.02,
        "sole_centre": 0.053,
        "sole_depth": 0.083,
        "single": 0.6,
        "double": 0.2,
        "apex": 0.08,
        "landing_speed": 0.2,
        "feedback": 3.0,
        "height_rate": 8.0,
        "touchdown_force": 20.0,
        "level_share": 0.25,
    } | changes
    arrays = {name: jnp.asarray(float(x)) for name, x in numbers.items()}
    return w.Walk(ground=ground, posture=jnp.zeros(23), sole_half=jnp.array([0.11, 0.05]), **arrays)


def plan(**changes) -> w.Plan:
    base = w.begin(walk(), 1.05)
    names = tuple(changes)
    values = tuple(jnp.asarray(x) for x in changes.values())
    return eqx.tree_at(lambda p: tuple(getattr(p, n) for n in names), base, values)


def test_dcm_runs_from_lift_off_backwards_to_rest_over_the_last_step():
    """Integrating ξ̇ = ω (ξ − p) forwards along the planned p ends where the recursion began."""
    figures = walk()
    steps = jnp.array([[0.05, -0.13], [0.3, 0.13], [0.55, -0.13], [0.8, 0.13]])
    dcm = np.asarray(w._dcm_at_lift_off(figures, steps, OMEGA))
    dt, omega = 1e-5, float(OMEGA)
    for k in range(3):
        a, b = np.asarray(steps[k]), np.asarray(steps[k + 1])
        for i in range(20_000):
            p = a + (b - a) * (i + 0.5) / 20_000
            dcm = dcm + dt * omega * (dcm - p) * (1 + 0.5 * dt * omega)
        if k < 2:
            dcm = b + np.exp(omega * 0.6) * (dcm - b)
    np.testing.assert_allclose(dcm, steps[3], atol=2e-3)


def test_reference_is_continuous_from_double_to_single_support():
    figures, steps = walk(), jnp.array([[0.05, -0.13], [0.3, 0.13], [0.55, -0.13], [0.8, 0.13]])
    end = w._dcm_at_lift_off(figures, steps, OMEGA)
    zero = jnp.zeros(())
    double = plan(single=0.0, double=0.2, zmp=jnp.array([-0.2, 0.13]))
    p, dcm = w._reference_now(figures, double, steps[0], end, OMEGA, zero)
    single = plan(single=1.0)
    p_next, dcm_next = w._reference_now(figures, single, steps[0], end, OMEGA, figures.single)
    np.testing.assert_allclose(p, p_next, atol=1e-12)
    np.testing.assert_allclose(dcm, dcm_next, atol=1e-12)
    start, _ = w._reference_now(figures, double, steps[0], end, OMEGA, jnp.asarray(0.2))
    np.testing.assert_allclose(start, double.zmp, atol=1e-12)


@pytest.fixture(scope="module")
def swing():
    return jax.jit(w._swing, compiler_options=FAST)


def test_swing_starts_at_rest_and_lands_on_time(swing):
    figures = walk()
    start, target = jnp.array([0.0, 0.13, 0.083]), jnp.array([0.5, 0.15, 0.113])
    first = swing(figures, plan(lifted=start, time=0.0), target)
    np.testing.assert_allclose(first[0], start, atol=1e-12)
    np.testing.assert_allclose(first[1], 0.0, atol=1e-12)
    last = swing(figures, plan(lifted=start, time=0.6), target)
    np.testing.assert_allclose(last[0], target, atol=1e-9)
    np.testing.assert_allclose(last[1], [0.0, 0.0, -0.2], atol=1e-9)
    late = swing(figures, plan(lifted=start, time=0.7), target)
    np.testing.assert_allclose(late[0, 2], target[2] - 0.02, atol=1e-9)


def test_swing_velocity_and_acceleration_are_its_derivatives(swing):
    figures, step = walk(), 1e-6
    start, target = jnp.array([0.0, 0.13, 0.083]), jnp.array([0.5, 0.15, 0.113])
    for t in (0.1, 0.25, 0.35, 0.5):
        now, after, before = (
            swing(figures, plan(lifted=start, time=x), target) for x in (t, t + step, t - step)
        )
        np.testing.assert_allclose((after[0] - before[0]) / (2 * step), now[1], atol=1e-5)
        np.testing.assert_allclose((after[1] - before[1]) / (2 * step), now[2], atol=1e-4)


def test_swing_clears_the_highest_box_on_its_way(swing):
    height = np.zeros((10, 6))
    height[3] = 0.06  # x from 0.2 to 0.6
    figures = walk(height)
    start, target = jnp.array([0.0, 0.13, 0.083]), jnp.array([0.5, 0.13, 0.143])
    top = max(
        float(swing(figures, plan(lifted=start, time=t), target)[0, 2])
        for t in np.linspace(0, 0.6, 25)
    )
    assert top == pytest.approx(0.06 + 0.083 + 0.08, abs=1e-6)


def test_footholds_move_off_edges_only_where_the_ground_is_known():
    height = np.zeros((10, 6))
    height[3:] = 0.05  # an edge at x = 0.2
    wanted = jnp.array([0.12, 0.1])
    moved = w._foothold(walk(height), wanted)
    sole = moved[0] + 0.053 + np.array([-0.11, 0.11])
    assert sole.max() < 0.2 or sole.min() > 0.2
    np.testing.assert_allclose(w._foothold(walk(height, knows_ground=0.0), wanted), wanted)
    np.testing.assert_allclose(w._foothold(walk(), wanted), wanted)


def test_ground_is_zero_outside_its_boxes():
    ground = walk(np.full((2, 2), 0.03)).ground
    points = jnp.array([[-0.9, -0.9], [-0.3, -0.3], [5.0, 0.0], [-1.1, -0.9]])
    np.testing.assert_allclose(ground.at(points), [0.03, 0.03, 0.0, 0.0])


@pytest.mark.parametrize(
    ("time", "force", "lands"),
    [(0.2, 300.0, False), (0.5, 300.0, True), (0.5, 5.0, False), (0.9, 0.0, True)],
)
def test_a_foot_lands_by_force_late_in_its_swing_or_by_the_clock(time, force, lands):
    feet = jnp.array([[0.2, 0.13, 0.083], [0.0, -0.13, 0.083]])
    before = plan(single=1.0, stance=1.0, time=time)
    after = w._advance(walk(), before, feet, jnp.array([force, 800.0]), jnp.asarray(5.0), 0.003)
    assert bool(after.single == 0.0) == lands
    assert float(after.stance) == (0.0 if lands else 1.0)
    if lands:  # p starts from the foot that carried so far
        np.testing.assert_allclose(after.zmp, [0.053, -0.13])


@pytest.mark.parametrize(("single", "rises"), [(0.0, False), (1.0, True)])
def test_the_pelvis_rises_only_once_the_rear_foot_has_left(single, rises):
    """A step up of 6 cm from a long stride would stretch the rear knee before it can leave the ground."""
    one, three, nv = jnp.zeros(()), jnp.zeros(3), 29
    now = Terms(
        mass=jnp.zeros((nv, nv)),
        bias=jnp.zeros(nv),
        weight=one,
        com=jnp.array([0.15, 0.0, 0.95]),
        com_velocity=three,
        com_jacobian=jnp.zeros((3, nv)),
        com_bias=three,
        momentum=three,
        momentum_jacobian=jnp.zeros((3, nv)),
        momentum_bias=three,
        rotation=jnp.zeros((4, 3, 3)),
        position=jnp.array([[0, 0, 1], [0, 0, 1], [0.3, 0.13, 0.143], [0, -0.13, 0.083]]),
        velocity=jnp.zeros((4, 6)),
        jacobian=jnp.zeros((4, 6, nv)),
        jacobian_bias=jnp.zeros((4, 6)),
    )
    begun = plan(
        single=single, stance=0.0, time=0.1, double=0.2, height=jnp.array([1.02, 0.0]),
        target=jnp.array([0.55, -0.13, 0.143]), lifted=jnp.array([0.0, -0.13, 0.083]),
    )  # fmt: skip
    force, figures = jnp.array([900.0, 0.0 if single else 400.0]), walk(np.full((9, 6), 0.06))
    walking = jax.jit(lambda p: w.walking(figures, p, now, force, jnp.asarray(5.0), 0.003))
    height = walking(begun)[1].height
    assert (float(height[2]) > 1.0) == rises
    assert float(height[0]) == pytest.approx(1.02, abs=1e-3)


def test_unknown_ground_is_taken_to_be_as_high_as_the_last_footholds_were():
    """Heights about a plane: the mean that forgets is off by less than the foothold before is."""
    figures = walk(knows_ground=0.0)
    rng = np.random.default_rng(0)
    heights, state, off = rng.uniform(-0.02, 0.02, 400), plan(single=0.0, double=0.0), []
    expected = jax.jit(lambda p: w._level(figures, jnp.zeros(2), p))
    lift_off = jax.jit(
        lambda p, feet: w._advance(figures, p, feet, jnp.zeros(2), jnp.asarray(5.0), 0.003)
    )
    for k, height in enumerate(heights[:-1]):
        feet = jnp.full((2, 3), height + float(figures.sole_depth))
        state = lift_off(eqx.tree_at(lambda p: p.single, state, jnp.zeros(())), feet)
        off.append((float(expected(state)) - heights[k + 1], height - heights[k + 1]))
    mean, last = np.sqrt(np.mean(np.square(off[20:]), axis=0))
    assert mean < 0.8 * last
    # On a slope it lags by a few steps and no more.
    for k in range(60):
        feet = jnp.full((2, 3), 0.01 * k + float(figures.sole_depth))
        state = lift_off(eqx.tree_at(lambda p: p.single, state, jnp.zeros(())), feet)
    assert float(expected(state)) == pytest.approx(0.01 * (59 - 3), abs=0.002)
