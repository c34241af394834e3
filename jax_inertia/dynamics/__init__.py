"""Rigid-body dynamics in JAX: kinematics, inverse dynamics, torque regressor, mass matrix."""
