"""The command `jax-inertia`: what it parses, prints, draws and writes."""
