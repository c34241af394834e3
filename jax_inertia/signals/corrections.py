"""A log as its model means it, once somebody said how they differ: gravity added, torques shifted, a base mounted."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_inertia.dynamics import rigid_body
from jax_inertia.logs.log import Log, LogError, TorqueUnit
from jax_inertia.maths.spatial import quat_to_matrix
from jax_inertia.model.robot import Robot
from jax_inertia.signals.base_motion import unmoved
from jax_inertia.signals.generalised_motion import generalised

_MOST_SHIFT = 1.0


def with_model_gravity(log: Log, robot: Robot) -> Log:
    """The log with the model's gravity torque added to tau, which a controller had taken out [N m].

    Raises LogError for torques that are in no N m.
    """
    if log.tau_unit is not TorqueUnit.NEWTON_METRE:
        raise LogError(
            f"tau is in {log.tau_unit_text[:60]!r}, and the model's gravity is in N m; give gains first"
        )
    q = generalised(unmoved(log), robot).q
    rows = [robot.joint_dofadr[robot.joint_index(name)] for name in log.joint_names]
    torque = np.asarray(_gravity(robot, jnp.asarray(q)))[:, rows]
    return dataclasses.replace(
        log,
        tau=np.asarray(log.tau) + torque,
        notes=(*log.notes, "the model's gravity torque was added to tau"),
    )


@eqx.filter_jit
def _gravity(robot: Robot, q: Float[jax.Array, "T nq"]) -> Float[jax.Array, "T nv"]:
    still, none = jnp.zeros(robot.nv), jnp.zeros(robot.nv)
    robot = dataclasses.replace(robot, stiffness=none, damping=none, frictionloss=none)

    def one(q: jax.Array) -> jax.Array:
        needed = rigid_body.inverse_dynamics(robot, q, still, still)
        return needed - rigid_body.passive_torque(robot, q, still)

    # In pieces, for memory that does not grow with the log.
    return jax.lax.map(one, q, batch_size=256)


def with_later_torque(log: Log, seconds: float) -> Log:
    """The log with tau put later by some seconds (earlier if negative), and the ends without a torque cut off.

    Raises LogError for a shift beyond a second, or beyond the log.
    """
    time = np.asarray(log.time)
    if not abs(seconds) <= min(_MOST_SHIFT, 0.4 * (time[-1] - time[0])):
        raise LogError(
            f"torques are to be shifted by {seconds:g} s; at most {_MOST_SHIFT:g} s, and less than half of the log"
        )
    tau = np.asarray(log.tau, float)
    moved = np.stack([np.interp(time, time + seconds, column) for column in tau.T], axis=1)
    note = f"tau was put {abs(seconds):g} s {'later' if seconds > 0 else 'earlier'}"
    log = dataclasses.replace(log, tau=moved, notes=(*log.notes, note))
    return log.between(float(time[0] + max(seconds, 0.0)), float(time[-1] + min(seconds, 0.0)))


def mounted(robot: Robot, rotation: Sequence[float]) -> Robot:
    """The robot on a base that is turned: gravity turns the other way in the model's axes.

    `rotation` are angles about x, y and, last, z, which may be left out, about fixed axes in this order [degrees]; or a
    quaternion wxyz. Raises ValueError for what is neither.
    """
    given = np.asarray(rotation, float)
    if given.shape not in ((2,), (3,), (4,)) or not np.isfinite(given).all():
        raise ValueError(
            f"a mount is {list(rotation)}; expected RX,RY or RX,RY,RZ in degrees, or a quaternion W,X,Y,Z"
        )
    if given.size == 4:
        if not 0.9 < np.linalg.norm(given) < 1.1:
            raise ValueError(f"the mount's quaternion {list(rotation)} has not the length 1")
        quat = given / np.linalg.norm(given)
        turned = np.asarray(quat_to_matrix(jnp.asarray(quat)))
    else:
        x, y, z = np.radians([*given, 0.0][:3])
        turned = _about(2, z) @ _about(1, y) @ _about(0, x)
    return dataclasses.replace(robot, gravity=jnp.asarray(turned.T @ np.asarray(robot.gravity)))


def _about(axis: int, angle: float) -> Float[np.ndarray, "3 3"]:
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[i, i] = out[j, j] = np.cos(angle)
    out[j, i], out[i, j] = np.sin(angle), -np.sin(angle)
    return out
