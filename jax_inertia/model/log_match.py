"""The model that a log is of, once both were read."""

import warnings
from pathlib import Path

import numpy as np

from jax_inertia.logs.findings import Finding, Severity
from jax_inertia.logs.log import Log
from jax_inertia.model.load import ModelWarning, is_urdf, load_model, model_path
from jax_inertia.model.robot import Robot

# A base that moves by more than this is not fixed [m, rad]; what tracks a fixed one may be noisy.
_MOVED, _TURNED = 5e-3, 1e-2


def afloat(robot: Robot, model: Path, log: Log) -> tuple[Robot, tuple[Finding, ...]]:
    """The robot with its base afloat where only its log can say that it is, and what is to be said of that.

    A URDF hangs its root link in the world. Where a log has that link's pose, and it moves or the robot touches
    something, the link floats.
    """
    if robot.has_free_base or not _moves(log) or not is_urdf(model_path(model)):
        return robot, ()
    with warnings.catch_warnings():
        # Said when the model was read first.
        warnings.simplefilter("ignore", ModelWarning)
        free = load_model(model, floating_base=True)
    if not free.has_free_base:
        return robot, ()
    message = (
        f"the log has the pose of a base: {free.body_names[0]!r}, the URDF's root link, floats"
    )
    return free, (Finding(Severity.NOTE, "base", message),)


def _moves(log: Log) -> bool:
    """Whether a log shows a base that is not fixed."""
    if log.base_pos is None or log.base_quat is None:
        return False
    if log.contact_bodies:
        return True
    position, quat = np.asarray(log.base_pos), np.asarray(log.base_quat)
    far = np.nanmax(position, axis=0) - np.nanmin(position, axis=0)
    # Twice the half-angle's sine, about.
    turned = np.nanmax(quat, axis=0) - np.nanmin(quat, axis=0)
    return bool(far.max() > _MOVED or 2.0 * turned.max() > _TURNED)
