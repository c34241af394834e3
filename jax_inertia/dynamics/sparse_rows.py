"""Rows of the torque that a few bodies can move: all others of their regressor are zero."""

from collections.abc import Sequence

import numpy as np

from jax_inertia.model.robot import Robot


def moved_rows(robot: Robot, bodies: Sequence[int]) -> tuple[int, ...]:
    """Rows of the torque that any of the bodies (by index) can move: those of the joints that carry it."""
    return tuple(int(i) for i in np.flatnonzero(robot.topology.body_dof[list(bodies)].any(axis=0)))
