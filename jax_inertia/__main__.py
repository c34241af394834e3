"""`python -m jax_inertia`: the command `jax-inertia`."""

import sys

from jax_inertia.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
