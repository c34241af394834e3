"""The hidden world of the sealed check: robots, motions, mechanics, two engines, sensors. No `jax_inertia` in here."""
