"""The same controller drives the humanoid in MuJoCo C and in MJX, and the two stay together.

Compiling the loop in MJX takes minutes on two cores.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.paper.brain import ORACLE, Inputs, make_brain
from benchmarks.paper.mjx_loop import at_home, make_loop
from benchmarks.paper.pelvis import SETTINGS
from benchmarks.paper.plant import Sensors
from benchmarks.paper.strides import (
    begin_at_home,
    flat,
    strolling,
    walk_figures,
)
from jax_inertia.robots import CORNERS, HumanoidOptions, humanoid_mjcf

SECONDS, PER_TICK = 2.0, 2

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]


def test_walks_alike_in_mujoco_c_and_in_mjx():
    options = HumanoidOptions(corner_forces=True, visual=False)
    model = mujoco.MjModel.from_xml_string(humanoid_mjcf(options))
    brain = make_brain(model, SETTINGS, Sensors(), strolling)
    plan = begin_at_home(walk_figures(model, flat(), start=0.1), model)
    memory = brain.start(plan)
    truth = brain.robot.pi[np.array(brain.estimator.bodies)]
    ticks = round(SECONDS / (PER_TICK * model.opt.timestep))

    loop = make_loop(model, brain, PER_TICK)
    run = jax.jit(lambda m, d: loop.run(m, d, truth, ticks)[2])
    in_mjx = np.asarray(run(memory, at_home(model, loop)))

    tick = eqx.filter_jit(brain.tick)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    at = np.array([model.sensor(f"{c.name}_force").adr[0] for c in CORNERS])[:, None] + np.arange(3)
    in_c = []
    for _ in range(ticks):
        f = data.sensordata[at]
        force = np.stack([-f[:, 2], f[:, 1], f[:, 0]], axis=-1)
        q, v, a = (jnp.asarray(x.copy()) for x in (data.qpos, data.qvel, data.qacc))
        tau = jnp.concatenate([jnp.zeros(6), jnp.asarray(data.ctrl.copy())])
        x = Inputs(q, v, q, v, a, tau, jnp.asarray(force), jnp.asarray(ORACLE), truth, jnp.ones(()))
        memory, out = tick(memory, x)
        data.ctrl[:] = np.asarray(out.torque)
        for _ in range(PER_TICK):
            mujoco.mj_step(model, data)
        in_c.append(data.qpos.copy())
    apart = np.abs(np.array(in_c) - in_mjx)
    assert in_mjx[-1, 2] > 0.95  # up, and by now in its first step
    assert apart[:, :3].max() < 2e-3
    assert apart[:, 7:].max() < 2e-2
