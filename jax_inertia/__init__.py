"""Physically consistent inertial estimation and sim-to-real gap diagnosis in JAX."""
