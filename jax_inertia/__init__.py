"""Physically consistent inertial estimation and sim-to-real gap diagnosis in JAX."""

from jax_inertia.dynamics.rigid_body import (
    body_jacobian,
    body_poses,
    condensed_dynamics,
    contact_torque,
    inverse_dynamics,
    mass_matrix,
    passive_torque,
    torque_regressor,
)
from jax_inertia.logs.log import Log, LogError, read_log, write_log
from jax_inertia.maths.inertial_parameters import from_log_cholesky, is_physical, to_log_cholesky
from jax_inertia.model.load import ModelError, ModelWarning, load_model
from jax_inertia.model.robot import Robot

__all__ = [
    "Log",
    "LogError",
    "ModelError",
    "ModelWarning",
    "Robot",
    "body_jacobian",
    "body_poses",
    "condensed_dynamics",
    "contact_torque",
    "from_log_cholesky",
    "inverse_dynamics",
    "is_physical",
    "load_model",
    "mass_matrix",
    "passive_torque",
    "read_log",
    "to_log_cholesky",
    "torque_regressor",
    "write_log",
]
