"""One core for everybody: import this before jax, numpy or Pinocchio, or threads are started that ratios forget."""

import os
import sys

FLAGS = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"


def one_core() -> None:
    """Keep this process, XLA's and BLAS's threads included, on one core where the system allows it."""
    if "jax" in sys.modules or "numpy" in sys.modules:
        raise RuntimeError("one_core() comes before jax and numpy are imported")
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {FLAGS}".strip()
    os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def in_this_thread() -> None:
    """Run XLA's computations in the thread that asks for them, before the first one: a control loop's setting.

    Otherwise all but the smallest calls wait until another thread has woken up, on one core for longer than they take.
    """
    import jax

    jax.config.update("jax_cpu_enable_async_dispatch", False)


def quiet_blas() -> None:
    """One BLAS thread: for small matrices LAPACK's threads only spin, on a busy machine for seconds."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
