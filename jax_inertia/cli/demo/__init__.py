"""A demonstration on built-in data; `jax-inertia demo` runs it."""
