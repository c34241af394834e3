"""The same closed loop wholly in JAX: plant in MJX, so that robots by the thousand run on one accelerator.

No noise: this is for comparing the two simulators, and for what a robot costs.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from mujoco import mjx

from benchmarks.paper.brain import ORACLE, Brain, Inputs, Memory
from jax_inertia.robots import CORNERS

PER_TICK = 2  # steps of 1.5 ms


class Loop(eqx.Module):
    """A brain and the robot that it drives, `per_tick` steps of the model to a tick."""

    brain: Brain
    model: mjx.Model
    force_at: tuple[int, ...] = eqx.field(static=True)
    per_tick: int = eqx.field(static=True)

    def tick(
        self, memory: Memory, data: mjx.Data, truth: Float[Array, "n 10"]
    ) -> tuple[Memory, mjx.Data]:
        """Sense, decide, and let the plant go on under constant torques."""
        contact = data.sensordata[np.array(self.force_at)[:, None] + np.arange(3)]
        # The sensor gives the contact's axes: z, y, −x of the world.
        force = jnp.stack([-contact[:, 2], contact[:, 1], contact[:, 0]], axis=-1)
        tau = jnp.concatenate([jnp.zeros(6, data.qpos.dtype), data.ctrl])
        x = Inputs(
            data.qpos,
            data.qvel,
            data.qpos,
            data.qvel,
            data.qacc,
            tau,
            force,
            jnp.asarray(ORACLE),
            truth,
            jnp.ones((), data.qpos.dtype),
        )
        memory, out = self.brain.tick(memory, x)
        data = data.replace(ctrl=out.torque)
        data = jax.lax.fori_loop(0, self.per_tick, lambda _, d: mjx.step(self.model, d), data)
        return memory, data

    def run(
        self, memory: Memory, data: mjx.Data, truth: Float[Array, "n 10"], ticks: int
    ) -> tuple[Memory, mjx.Data, Float[Array, "ticks nq"]]:
        """So many ticks of one robot, and its positions after each."""

        def one(carry, _):
            memory, data = carry
            memory, data = self.tick(memory, data, truth)
            return (memory, data), data.qpos

        (memory, data), path = jax.lax.scan(one, (memory, data), None, length=ticks)
        return memory, data, path


def make_loop(model: mujoco.MjModel, brain: Brain, per_tick: int) -> Loop:
    """Loop of a compiled model with corner force sensors."""
    at = tuple(int(model.sensor(f"{c.name}_force").adr[0]) for c in CORNERS)
    return Loop(brain, mjx.put_model(model), at, per_tick)


def at_home(model: mujoco.MjModel, loop: Loop) -> mjx.Data:
    """The home pose, sensors read."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    return mjx.forward(loop.model, mjx.put_data(model, data))
