"""Contact wrenches from a sensor's own axes into the world's, as the log contract has them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from jax_inertia.dynamics.rigid_body import body_poses
from jax_inertia.logs.log import Log
from jax_inertia.model.robot import Robot
from jax_inertia.signals.base_motion import unmoved
from jax_inertia.signals.generalised_motion import generalised


def wrenches_in_world(log: Log, robot: Robot) -> Log:
    """Turn every contact wrench from its body's axes into the world's: f_world = R(q) f_body, moments alike.

    Raises ValueError where a body is not one of the robot's, or the log lacks joints (or the base) that its pose
    needs.
    """
    if log.contact_wrench is None:
        return log
    bodies = np.array([robot.body_index(name) for name in log.contact_bodies])
    # Where the bodies are does not hang on torques, which the log may lack.
    placed = log if log.tau is not None else dataclasses.replace(log, tau=np.zeros(log.qpos.shape))
    q = jnp.asarray(generalised(unmoved(placed), robot).q)
    turns = jax.jit(jax.vmap(lambda robot, q: body_poses(robot, q)[0][bodies], (None, 0)))
    halves = np.asarray(log.contact_wrench).reshape(len(q), len(bodies), 2, 3)
    world = np.einsum("tbij,tbhj->tbhi", np.asarray(turns(robot, q)), halves)
    note = "contact wrenches were turned from the axes of their bodies into the world's"
    return dataclasses.replace(
        log, contact_wrench=world.reshape(len(q), len(bodies), 6), notes=(*log.notes, note)
    )
