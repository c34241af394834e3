"""The filter's step in C++ and as a program of StableHLO: the numbers of the step itself, on MuJoCo C's torques."""

import os
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from arm_log import ARM, TORQUE
from jax import export

import jax_inertia as ji
from benchmarks.controller.build import build, compilers, run
from jax_inertia.estimation.joint_terms import JointTerms
from jax_inertia.estimation.online.exported_step import Sample, export_step, write_c_step

LOAD, RATE, COUNT = 0.8, 50.0, 150


def samples() -> Sample:
    """Three seconds in which the arm carries 0.8 kg, a row without a torque and one without any among them."""
    spec = mujoco.MjSpec.from_string(ARM)
    ball = spec.body("lower").add_body(name="ball", pos=[0.0, 0.0, -0.3])
    ball.explicitinertial, ball.mass, ball.inertia = True, LOAD, np.full(3, 1e-4)
    ball.ipos = np.zeros(3)
    model = spec.compile()
    data, time = mujoco.MjData(model), np.arange(COUNT) / RATE
    phase = 2 * np.pi * np.array([0.7, 1.1]) * time[:, None]
    rate, size = 2 * np.pi * np.array([0.7, 1.1]), np.array([0.8, 0.6])
    q, v, a = size * np.sin(phase), size * rate * np.cos(phase), -size * rate**2 * np.sin(phase)
    tau = np.zeros_like(q)
    for k in range(COUNT):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        tau[k] = data.qfrc_inverse
    tau += TORQUE * np.random.default_rng(0).normal(size=tau.shape)
    valid = np.ones(q.shape, bool)
    tau[20, 0] = np.nan
    valid[30] = False
    motion = ji.Motion(time=time, q=q, v=v, tau=tau, valid=valid)
    sample = Sample(ji.Observation(motion, a), jnp.full(COUNT, 1 / RATE))
    return jax.tree.map(jnp.asarray, sample)


@pytest.fixture(scope="module")
def given() -> Sample:
    return samples()


def first_of(given: Sample) -> ji.Observation:
    return jax.tree.map(lambda x: x[0], given.observation)


def make(dtype: str = "float64", **more) -> ji.Estimator:
    robot = ji.load_model(mujoco.MjModel.from_xml_string(ARM)).astype(dtype)
    return ji.make_estimator(robot, ["lower"], sigma_tau=jnp.asarray(TORQUE, dtype), **more)


def stepped(estimator: ji.Estimator, given: Sample):
    """State after all samples, and what each step found."""

    def one(state, sample):
        after, step = estimator.step(state, sample.observation, sample.dt)
        return after, (estimator.estimate(step.belief), step.innovation)

    return eqx.filter_jit(jax.lax.scan)(one, estimator.initial(), given)


@pytest.mark.skipif(
    compilers() is None and "JAX_INERTIA_CI" not in os.environ, reason="no compiler of C++"
)
@pytest.mark.parametrize("joints", [None, JointTerms(jnp.full((2, 3), 0.3))])
def test_the_step_in_a_loop_of_cpp(tmp_path, given, joints):
    """Compiled without optimisation: that takes a fifth of the time."""
    estimator = make(joints=joints)
    _, (estimate, innovation) = stepped(estimator, given)
    program = build(tmp_path, estimator, first_of(given), level="-O0")
    like = jax.eval_shape(
        export_step(estimator, first_of(given)).call,
        estimator.initial(),
        jax.tree.map(lambda x: x[0], given),
    )[1]
    out = run(program, given, like, period_us=0.0, steps=COUNT)
    np.testing.assert_array_equal(out.found.innovation.accepted, innovation.accepted)
    np.testing.assert_array_equal(out.found.innovation.tested, innovation.tested)
    for ours, right in (
        (out.found.estimate.pi, estimate.pi),
        (out.found.estimate.sigma_pi, estimate.sigma_pi),
    ):
        scale = np.abs(right).max(axis=0)
        np.testing.assert_allclose(ours / scale, right / scale, rtol=0, atol=1e-6)
    # Of the mass itself two joints feel little; along the link, m c is 1.2 · (−0.15) + 0.8 · (−0.3) kg m.
    assert abs(out.found.estimate.pi[-1, 0, 3] + 0.42) < 0.01
    assert (out.found.joints is None) == (joints is None)
    assert not out.found.innovation.tested[30]
    assert 0 < out.core_us[0] < 1000


def test_names_that_c_has_not(tmp_path, given):
    for name in ("filter.cpp", "7.c"):
        with pytest.raises(ValueError, match="such as hand_filter"):
            write_c_step(tmp_path / name, make(), first_of(given))


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_the_step_as_a_program_that_calls_no_library(given, dtype):
    estimator = make(dtype)
    given = jax.tree.map(lambda x: x.astype(dtype) if x.dtype != bool else x, given)
    program = export_step(estimator, first_of(given))
    assert "custom_call" not in program.mlir_module()
    pytest.importorskip("flatbuffers")
    again = export.deserialize(program.serialize())
    assert again.in_tree == program.in_tree
    assert again.out_tree == program.out_tree

    def one(state, sample):
        after, found = again.call(state, sample)
        return after, found

    state, found = jax.jit(lambda s: jax.lax.scan(one, s, given))(estimator.initial())
    double = jax.tree.map(lambda x: x.astype(float) if x.dtype != bool else x, given)
    right, (estimate, _) = stepped(make(), double)
    # Of a σ, against double precision: what roundings of 150 steps add up to (0.14 seen; LAPACK's own: 0.06).
    tight = 1e-6 if dtype == "float64" else 0.3
    sigma = np.sqrt(np.diag(right.belief.covariance))
    assert np.abs((state.belief.mean - right.belief.mean) / sigma).max() < tight
    np.testing.assert_allclose(
        found.estimate.pi[-1, 0, 3], estimate.pi[-1, 0, 3], rtol=min(tight, 0.02)
    )


SHARDED = """
import jax, jax.numpy as jnp, numpy as np
from jax.sharding import Mesh, PartitionSpec as P
from test_exported_step import first_of, make, samples
assert len(jax.devices()) == 2
estimator, sample = make(), samples()
sample = jax.tree.map(lambda x: jnp.stack([x[0], x[7], x[33], x[90]]), sample)
state = jax.tree.map(lambda x: jnp.repeat(jnp.asarray(x)[None], 4, 0), estimator.initial())
step = jax.vmap(lambda state, sample: estimator.step(state, sample.observation, sample.dt)[0])
specs = {"in_specs": P("robots"), "out_specs": P("robots"), "check_vma": False}
split = jax.shard_map(step, mesh=Mesh(jax.devices(), ("robots",)), **specs)
ours, right = jax.jit(split)(state, sample), jax.jit(step)(state, sample)
assert len(ours.belief.mean.sharding.device_set) == 2
np.testing.assert_allclose(ours.belief.mean, right.belief.mean, rtol=1e-9, atol=1e-9)
np.testing.assert_allclose(ours.belief.covariance, right.belief.covariance, rtol=1e-7, atol=1e-12)
"""


@pytest.mark.slow
def test_a_fleet_over_two_devices():
    """In a process of its own, whose CPU counts as two devices."""
    folder = Path(__file__).parent
    paths = [str(folder), str(folder.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {
        "XLA_FLAGS": "--xla_force_host_platform_device_count=2",
        "JAX_PLATFORMS": "cpu",
        "JAX_ENABLE_X64": "1",
        "PYTHONPATH": os.pathsep.join(paths),
    }
    run = subprocess.run([sys.executable, "-c", SHARDED], env=environment, check=False)
    assert run.returncode == 0
