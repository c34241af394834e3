"""The update as one kernel is the update: interpreted here, and lowered for the GPU that it is for."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_inertia.dynamics.sparse_rows import moved_rows, spread_rows, take_rows
from jax_inertia.estimation import fused_update
from jax_inertia.estimation.fused_update import FusedSquareRoot
from jax_inertia.estimation.inertial_filter import make_estimator
from jax_inertia.maths.kalman import Belief, Standard, update
from jax_inertia.maths.noise import IndependentNoise

ROWS = (0, 1, 2, 5, 8)


def problems(robots: int, n: int, m: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Covariances with scales far apart, rows of unit noise, innovations."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(robots, n, n)) * np.logspace(-2, 1, n)[:, None]
    p = root @ np.swapaxes(root, 1, 2)
    return p, rng.normal(size=(robots, m, n)), rng.normal(size=(robots, m))


@pytest.mark.parametrize("n", [1, 7])
def test_kernel_is_the_textbook_update(n: int):
    # 33 filters: one more than a program has lanes.
    args = [jnp.asarray(x) for x in problems(33, n, 3)]
    found = fused_update.kernel(*args, interpret=True)
    wanted = jax.vmap(Standard().correct)(*args)
    names = ("step", "covariance", "nis", "log_det")
    for name, one in zip(names, found, strict=True):
        right = np.asarray(getattr(wanted, name))
        np.testing.assert_allclose(one, right, rtol=0, atol=1e-9 * np.abs(right).max())
    assert np.array_equal(found[1], np.swapaxes(found[1], 1, 2))


def one_h100() -> jax.sharding.AbstractMesh:
    """A GPU that need not be there: since jax 0.12 a kernel is lowered for a named one."""
    device = jax.sharding.AbstractDevice
    given = {"device_kind": "NVIDIA H100 80GB HBM3", "num_cores": 132, "platform": "gpu"}
    known = [field.name for field in dataclasses.fields(device)]  # jax 0.9 has no platform
    one = device(**{name: given[name] for name in known})
    return jax.sharding.AbstractMesh((), (), abstract_device=one)


def test_kernel_lowers_for_a_gpu():
    args = [jax.ShapeDtypeStruct(x.shape, jnp.float32) for x in problems(64, 20, 3)]
    each = jax.jit(jax.vmap(lambda *x: FusedSquareRoot().correct(*x).step))
    name = "__gpu$xla.gpu.triton"
    checks = [jax.export.DisabledSafetyCheck.custom_call(x) for x in (name, "triton_kernel_call")]
    with jax.sharding.use_abstract_mesh(one_h100()):
        lowered = jax.export.export(each, platforms=["cuda"], disabled_checks=checks)(*args)
    assert "triton" in lowered.mlir_module()


@pytest.mark.parametrize("batched", [False, True])
def test_rows_left_out_count_in_nis_alone(batched: bool):
    p, h, z = (x[0] for x in problems(1, 4, 9))
    h = np.where(np.isin(np.arange(9), ROWS)[:, None], h, 0.0)
    noise = IndependentNoise(jnp.linspace(0.1, 2.0, 9))
    mask = jnp.asarray(np.arange(9) != 2)

    def run(form, z):
        belief = Belief(jnp.zeros(4), jnp.asarray(p))
        return update(belief, z, lambda x: jnp.asarray(h) @ x, noise, mask=mask, form=form)

    def both(z):
        return run(FusedSquareRoot(ROWS), z), run(Standard(), z)

    found, wanted = jax.vmap(both)(jnp.asarray(z)[None]) if batched else both(jnp.asarray(z))
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-9)


def test_rows_are_not_left_out_of_correlated_noise(cases):
    robot = cases("floating_tree").robot
    form = FusedSquareRoot(moved_rows(robot, (1,)))
    make_estimator(robot, [1], sigma_tau=1.0, form=form)
    with pytest.raises(ValueError, match="leaves rows out"):
        make_estimator(robot, [1], sigma_tau=1.0, form=form, sigma_a=0.1)


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
