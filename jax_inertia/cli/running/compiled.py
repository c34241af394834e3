"""JAX's compiled programs, kept between commands: compiling is half of what a first `estimate` takes."""

import contextlib
import os
import sys
from pathlib import Path

OFF = "JAX_INERTIA_CACHE"
"""Environment variable: `off`, or the folder to use."""
MOST_BYTES = 512 * 2**20
"""The folder holds no more; what was not used for longest goes first."""
LEAST_SECONDS = 0.2
"""What compiles faster [s] is not kept: a decision, as reading it back costs about as long."""


def cache_folder() -> Path:
    """The user's folder for caches, as the system has it, and in it this program's."""
    home = Path.home()
    if sys.platform == "darwin":
        base = home / "Library" / "Caches"
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    return base / "jax_inertia" / "compiled"


def keep_compiled() -> None:
    """Let JAX keep what it compiles, unless the environment forbids it or JAX was given a folder already.

    JAX's own key holds its version, the processor's features and the compiler's options. Where the folder cannot be
    written, commands do without.
    """
    import jax

    wanted = os.environ.get(OFF, "")
    given = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if given or wanted.lower() in ("off", "0", "no"):
        return
    with contextlib.suppress(OSError, RuntimeError):
        folder = Path(wanted) if wanted else cache_folder()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            return
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_compilation_cache_max_size", MOST_BYTES)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", LEAST_SECONDS)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
