"""Standing and walking for the experiments: the robot's own figures, grounds, and what the brain follows."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from benchmarks.paper.brain import Inputs
from benchmarks.paper.plant import TICK
from jax_inertia.control.terms import Terms
from jax_inertia.control.walking import Ground, Plan, Walk, begin, walking
from jax_inertia.control.whole_body import Reference
from jax_inertia.robots.nadia_figures import SOLE_DEPTH, SOLE_HALF_WIDTH, SOLE_X

CELL = 0.4  # m, side of a box of rough ground


def flat() -> Ground:
    """Level ground."""
    return Ground(jnp.zeros((1, 1)), jnp.zeros(2), jnp.asarray(1.0))


def boxes(seed: int, amplitude: float, length: float = 30.0) -> Ground:
    """Boxes of ± `amplitude` [m], level for the first metre, where the robot starts."""
    rng = np.random.default_rng([seed, 11])
    corner = np.array([-1.0, -1.2])
    height = rng.uniform(-amplitude, amplitude, (int((length + 1.0) / CELL), 6))
    height[: int(1.6 / CELL)] = 0.0
    return Ground(jnp.asarray(height), jnp.asarray(corner), jnp.asarray(CELL))


def walk_figures(
    model: mujoco.MjModel,
    ground: Ground,
    *,
    step: float = 0.25,
    start: float = 1.0,
    knows_ground: bool = True,
    landing_speed: float = 0.2,
    crouch: float = 0.05,
    force_noise: float = 2.0,
) -> Walk:
    """The humanoid's walk; `crouch` [m] lowers the pelvis from the home pose, for steps down.

    `force_noise` [N] is the standard deviation of a foot's measured vertical force: one that is taken for a touchdown
    in mid-swing makes the robot fall.
    """
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    numbers = {
        "start": start,
        "step": step,
        "knows_ground": float(knows_ground),
        "half_width": data.body("left_foot_link").xpos[1],
        "pelvis_height": data.qpos[2] - crouch,
        "sole_centre": sum(SOLE_X) / 2,
        "sole_depth": SOLE_DEPTH,
        "single": 0.6,
        "double": 0.2,
        "apex": 0.08,
        "landing_speed": landing_speed,
        "feedback": 3.0,
        "height_rate": 8.0,
        "touchdown_force": max(20.0, 8.0 * force_noise),
        "level_share": 0.25,
    }
    half = np.array([(SOLE_X[1] - SOLE_X[0]) / 2 - 0.015, SOLE_HALF_WIDTH - 0.01])
    return Walk(
        ground=ground,
        posture=jnp.asarray(data.qpos[7:]),
        sole_half=jnp.asarray(half),
        **{name: jnp.asarray(float(value)) for name, value in numbers.items()},
    )


def strolling(plan: tuple[Walk, Plan], now: Terms, x: Inputs, time):
    """The brain's reference: its plan is the pair of how to walk and where in it the robot is."""
    walk, state = plan
    force = x.force.reshape(2, 4, 3)[..., 2].sum(axis=1)
    state, reference = walking(walk, state, now, force, time, TICK)
    record = jnp.concatenate(
        [reference.height, state.single[None], state.steps[None], state.target]
    )
    return (walk, state), reference, record


def begin_at_home(walk: Walk, model: mujoco.MjModel) -> tuple[Walk, Plan]:
    """A plan that starts in the home pose."""
    return walk, begin(walk, float(model.key_qpos[0][2]))


class Still(eqx.Module):
    """Joint angles that do not change."""

    angles: Float[Array, "nu"]

    def __call__(self, time: Float[Array, ""]) -> Float[Array, "3 nu"]:
        return jnp.stack([self.angles, 0.0 * self.angles, 0.0 * self.angles])


class Standing(eqx.Module):
    """Stand in the home pose; `posture(time)` gives joint positions, velocities and accelerations."""

    height: Float[Array, ""]
    com: Float[Array, "3"]
    posture: Callable[[Float[Array, ""]], Float[Array, "3 nu"]]

    def __call__(self, plan: Any, now: Terms, x: Inputs, time: Float[Array, ""]):
        want = self.posture(time)
        push = 25.0 * (self.com[:2] - now.com[:2]) - 10.0 * now.com_velocity[:2]
        reference = Reference(
            com_acceleration=push,
            height=jnp.stack([self.height, 0.0 * time, 0.0 * time]),
            heading=jnp.zeros(()),
            foot=jnp.zeros((2, 3, 3)),
            foot_heading=jnp.zeros(2),
            contact=jnp.ones(8),
            stance=jnp.ones(2),
            posture=want,
        )
        return plan, reference, want[0]


def standing(
    model: mujoco.MjModel, posture: Callable[[Float[Array, ""]], Float[Array, "3 nu"]] | None = None
) -> Standing:
    """Stand where the model's home pose stands."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    home = jnp.asarray(data.qpos.copy())
    com = jnp.asarray(data.subtree_com[1].copy())
    return Standing(home[2], com, Still(home[7:]) if posture is None else posture)
