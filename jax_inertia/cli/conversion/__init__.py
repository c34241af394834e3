"""`jax-inertia convert`: a log of any kind into the package's own form."""
