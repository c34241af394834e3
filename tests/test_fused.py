"""A fleet's filter in a few kernels is the filter: run by hand here, and lowered for the GPU that it is for."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_inertia import load_model
from jax_inertia.dynamics.sparse_rows import moved_rows
from jax_inertia.estimation.inertial_filter import make_estimator
from jax_inertia.estimation.priors import Load
from jax_inertia.maths import fused_update, lanes
from jax_inertia.maths.fused_update import FusedSquareRoot
from jax_inertia.maths.gates import FixedGate
from jax_inertia.maths.kalman import Belief, Measurement, SquareRoot, Standard, update, update_by
from jax_inertia.maths.noise import CorrelatedNoise, IndependentNoise
from jax_inertia.maths.row_runs import spread_rows, take_rows
from jax_inertia.robots.pendulum import double_pendulum
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.generalised_motion import Motion

ROWS = (0, 1, 2, 5, 8)


def problems(robots: int, n: int, m: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Covariances with scales far apart, rows of unit noise, innovations."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(robots, n, n)) * np.logspace(-2, 1, n)[:, None]
    p = root @ np.swapaxes(root, 1, 2)
    return p, rng.normal(size=(robots, m, n)), rng.normal(size=(robots, m))


def by_hand(name, body, shapes, arrays, shared=()):
    """`lanes.lane_kernel` for as many lanes as there are samples, without a GPU."""
    count = arrays[0].shape[-1]
    out: list[dict] = [{} for _ in shapes]

    def reader(x):
        return lambda *at: x[at]

    def writer(into):
        return lambda value, *at: into.__setitem__(at, jnp.broadcast_to(value, (count,)))

    body(*map(reader, arrays), *map(reader, shared), *map(writer, out))
    return [
        jnp.stack([found[at] for at in np.ndindex(shape)]).reshape(*shape, count)
        for found, shape in zip(out, shapes, strict=True)
    ]


@pytest.fixture
def hand_run(monkeypatch):
    """Programs for a GPU take their kernels, which run by hand."""

    def chosen(*args, cuda=None, cpu=None, default=None):
        return (cuda or cpu or default)(*args)

    monkeypatch.setattr(lanes, "lane_kernel", by_hand)
    monkeypatch.setattr(fused_update, "lane_kernel", by_hand)
    monkeypatch.setattr(jax.lax, "platform_dependent", chosen)


@pytest.mark.parametrize("n", [1, 7])
def test_kernel_is_the_textbook_update(n: int, monkeypatch):
    monkeypatch.setattr(fused_update, "lane_kernel", by_hand)
    args = [jnp.asarray(x) for x in problems(33, n, 3)]
    found = jax.jit(fused_update.kernel)(*args)
    wanted = jax.vmap(Standard().correct)(*args)
    names = ("step", "covariance", "nis", "log_det")
    for name, one in zip(names, found, strict=True):
        right = np.asarray(getattr(wanted, name))
        # The margins that keep P⁺ positive are float32's.
        np.testing.assert_allclose(one, right, rtol=0, atol=3e-6 * np.abs(right).max())
    assert np.array_equal(found[1], np.swapaxes(found[1], 1, 2))


def one_h100() -> jax.sharding.AbstractMesh:
    """A GPU that need not be there: since jax 0.12 a kernel is lowered for a named one."""
    device = jax.sharding.AbstractDevice
    given = {"device_kind": "NVIDIA H100 80GB HBM3", "num_cores": 132, "platform": "gpu"}
    known = [field.name for field in dataclasses.fields(device)]  # jax 0.9 has no platform
    one = device(**{name: given[name] for name in known})
    return jax.sharding.AbstractMesh((), (), abstract_device=one)


def lowered(function, *args) -> str:
    """The program for a GPU of a function of so many samples."""
    names = ("mosaic_gpu", "mosaic_gpu_v2", "AllocateBuffer")
    checks = [jax.export.DisabledSafetyCheck.custom_call(x) for x in names]
    with jax.sharding.use_abstract_mesh(one_h100()):
        out = jax.export.export(jax.jit(function), platforms=["cuda"], disabled_checks=checks)
        return out(
            *(jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), args))
        ).mlir_module()


def test_kernel_lowers_for_a_gpu():
    args = [jax.ShapeDtypeStruct(x.shape, jnp.float32) for x in problems(200, 20, 3)]
    each = jax.vmap(lambda *x: FusedSquareRoot().correct(*x).step)
    assert "mosaic_gpu" in lowered(each, *args)


def fleet(form, robots: int = 130):
    """A filter of a pendulum's lower link, its step for so many robots, and what that takes."""
    robot = load_model(double_pendulum()).astype("float32")
    noise = {"sigma_tau": 2.0, "prior": Load(0.1)}
    filter_ = make_estimator(robot, ["lower"], form=form, iterations=1, **noise)
    rng = np.random.default_rng(0)
    q, v, a, tau = (jnp.asarray(rng.normal(size=(robots, 2)), jnp.float32) for _ in range(4))
    valid = jnp.asarray(rng.uniform(size=(robots, 2)) < 0.8)
    motion = Motion(time=jnp.zeros(robots, jnp.float32), q=q, v=v, tau=tau, valid=valid)
    states = jax.tree.map(lambda x: jnp.repeat(x[None], robots, 0), filter_.initial())
    step = jax.jit(jax.vmap(lambda s, x: filter_.step(s, x, 0.01)))
    return step, (states, Observation(motion, a))


def assert_same(found, wanted, tolerance: float) -> None:
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        a, b = np.asarray(a, float), np.asarray(b, float)
        size = np.abs(b[np.isfinite(b)]).max(initial=0.0)
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * size)


@pytest.mark.slow
def test_step_in_kernels_is_the_step(hand_run):
    found, args = fleet(FusedSquareRoot())
    wanted, _ = fleet(SquareRoot())
    assert_same(found(*args), wanted(*args), 2e-4)


def test_step_lowers_for_a_gpu():
    step, args = fleet(FusedSquareRoot())
    # What is measured with its slope, the update, and the projection.
    assert lowered(step, *args).count("mosaic_gpu_v2") == 3


def test_few_robots_need_no_kernel():
    found, args = fleet(FusedSquareRoot(), robots=3)
    wanted, _ = fleet(SquareRoot(), robots=3)
    assert_same(found(*args), wanted(*args), 1e-6)


@pytest.mark.parametrize("iterations", [1, 3])
@pytest.mark.parametrize("outliers", [False, True])
def test_rows_that_hang_on_nothing_count_in_nis_alone(iterations: int, outliers: bool):
    p, h, z = (x[0] for x in problems(1, 4, 9))
    h = jnp.asarray(np.where(np.isin(np.arange(9), ROWS)[:, None], h, 0.0))
    noise = IndependentNoise(jnp.linspace(0.1, 2.0, 9))
    belief = Belief(jnp.zeros(4), jnp.asarray(p))
    given = Measurement(jnp.asarray(z), lambda x: h @ x, None, jnp.asarray(np.arange(9) != 2))
    how = {"iterations": iterations, "outliers": FixedGate(2.0) if outliers else None}
    found = update_by(belief, lambda: given, noise, rows=ROWS, form=SquareRoot(), **how)
    wanted = update(belief, given.z, given.model, noise, mask=given.mask, form=Standard(), **how)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-8)


@pytest.mark.slow
def test_correlated_noise_ties_all_rows(cases):
    """A filter with the same noise as a full matrix is the same filter."""
    robot = cases("floating_tree").robot
    variance = jnp.linspace(0.5, 1.0, robot.nv)
    states = [jnp.asarray(x)[0] for x in cases("floating_tree").states(1)]
    motion = Motion(
        time=jnp.zeros(()), q=states[0], v=states[1], tau=jnp.ones(robot.nv),
        valid=jnp.ones(robot.nv, bool),
    )  # fmt: skip
    out = []
    for noise in (IndependentNoise(variance), CorrelatedNoise(jnp.diag(variance))):
        filter_ = make_estimator(robot, [1], sigma_tau=1.0, noise=noise)
        out.append(filter_.step(filter_.initial(), Observation(motion, states[2]), 0.01))
    for a, b in zip(*map(jax.tree.leaves, out), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-9)


def test_moved_rows_are_those_of_the_regressor(cases):
    case = cases("floating_tree")
    bodies = (case.robot.body_index("shank"), case.robot.body_index("trunk"))
    every = np.asarray(case.core(case.robot, *case.states(8))["regressor"])[:, :, list(bodies)]
    rows = np.flatnonzero(np.abs(every).max(axis=(0, 2, 3)) > 0)
    assert moved_rows(case.robot, bodies) == tuple(rows)


@pytest.mark.parametrize("rows", [(), (0,), (2,), (1, 2), (0, 2, 3), (0, 1, 2, 3)])
def test_rows_spread_and_taken_back(rows: tuple[int, ...]):
    x = jnp.arange(1.0, 2.0 * len(rows) + 1.0).reshape(len(rows), 2)
    spread = spread_rows(x, rows, 4)
    wanted = np.zeros((4, 2))
    wanted[list(rows)] = x
    np.testing.assert_array_equal(spread, wanted)
    np.testing.assert_array_equal(take_rows(spread, rows), x)
