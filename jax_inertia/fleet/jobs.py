"""Diagnoses of many logs, each in a process of its own, on this machine or on a Dask cluster.

A process that dies takes its own log with it and no other: that log is tried again. What is done is not done again: a
folder holds report.json and, written after it, a key of log, model, options and version.
"""

import concurrent.futures
import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from jax_inertia.logs.atomic_files import whole_file

ATTEMPTS = 3
"""Of a log whose process dies: memory may be short for a moment, a machine may be taken away."""
PATIENCE = 2.0
"""Seconds between looks at a folder in which another process writes."""
BAD_INPUT = 2
_KEY = "fleet_key.json"
_BUSY = "another run is writing there"


class Task(NamedTuple):
    """One log to be diagnosed."""

    log: Path
    model: Path
    out: Path
    options: tuple[str, ...]
    version: str
    program: tuple[str, ...] = ()
    """Words before the log; empty: `jax-inertia diagnose` of the Python that runs the task."""
    test_log: Path | None = None
    """Another motion of the same robot, used only to validate."""


class Outcome(NamedTuple):
    """What became of a task."""

    task: Task
    status: str
    """done, before (a run before this one did it), refused, lost (its process died each time)."""
    message: str = ""


def run_here(
    tasks: Sequence[Task], jobs: int, on_end: Callable[[Outcome, int], None]
) -> list[Outcome]:
    """All tasks by so many processes at a time; `on_end` is called with each as it ends and how many have ended."""
    with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
        waiting = [pool.submit(diagnose, task) for task in tasks]
        try:
            ended = _in_time((f.result() for f in concurrent.futures.as_completed(waiting)), on_end)
        except BaseException:
            # Ctrl-C: what is done stays done, the rest is not begun.
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return _in_order(tasks, ended)


def run_on_dask(
    tasks: Sequence[Task], address: str, on_end: Callable[[Outcome, int], None]
) -> list[Outcome]:
    """All tasks on a Dask cluster whose workers see the same files; a task whose worker dies goes to another one.

    Raises ValueError where Dask is not installed or nobody answers at the address.
    """
    try:
        import distributed  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ValueError("--dask needs Dask: pip install 'jax-inertia[dask]'") from None
    try:
        client = distributed.Client(address, timeout="20s", set_as_default=False)
    except (OSError, ValueError) as error:
        raise ValueError(f"--dask {address}: no scheduler answers there ({error})") from None
    with client, client.as_current():
        futures = [client.submit(diagnose, task, pure=False, retries=ATTEMPTS) for task in tasks]
        of = dict(zip((f.key for f in futures), tasks, strict=True))
        results = (_result(f, of[f.key]) for f in distributed.as_completed(futures))
        ended = _in_time(results, on_end)
    return _in_order(tasks, ended)


def _result(future, task: Task) -> Outcome:
    """A future's outcome; Dask gives up a task after it has seen several workers die."""
    try:
        return future.result()
    except Exception as error:  # Of whatever kind the worker's was.
        return Outcome(task, "lost", f"{type(error).__name__}: {error}")


def _in_time(results: Iterator[Outcome], on_end: Callable[[Outcome, int], None]) -> list[Outcome]:
    ended = []
    for outcome in results:
        ended.append(outcome)
        on_end(outcome, len(ended))
    return ended


def _in_order(tasks: Sequence[Task], ended: Sequence[Outcome]) -> list[Outcome]:
    by_folder = {outcome.task.out: outcome for outcome in ended}
    return [by_folder[task.out] for task in tasks]


def diagnose(task: Task) -> Outcome:
    """`jax-inertia diagnose` of one log in a process of its own, unless that was done before."""
    key = _key(task)
    if _done(task, key):
        return Outcome(task, "before")
    program = task.program or (sys.executable, "-m", "jax_inertia", "diagnose")
    command = [*program, str(task.log), "--model", str(task.model), "--out", str(task.out)]
    if task.test_log is not None:
        command += ["--test-log", str(task.test_log)]
    status, message, deaths = None, "", 0
    while deaths < ATTEMPTS:
        done = subprocess.run(
            [*command, *task.options],
            env=_environment(task),
            capture_output=True,
            text=True,
            check=False,
        )
        status, message = done.returncode, _last_line(done.stderr)
        if status == 0:
            _write_key(task, key)
            return Outcome(task, "done")
        if status == BAD_INPUT and _BUSY in message:
            # The process of a worker that died goes on to its end, and its report counts.
            time.sleep(PATIENCE)
        elif status == BAD_INPUT:
            return Outcome(task, "refused", message.removeprefix(f"{task.log}: "))
        else:
            deaths += 1
    return Outcome(
        task, "lost", f"its process ended {ATTEMPTS} times with status {status}: {message}"
    )


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].removeprefix("jax-inertia: error: ") if lines else ""


def _environment(task: Task) -> dict[str, str]:
    """Of one core each, since logs are what runs side by side; compiled code is shared."""
    defaults = {
        "OMP_NUM_THREADS": "1",
        "JAX_COMPILATION_CACHE_DIR": str(task.out.parent.parent / ".compiled"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
    }
    return {**defaults, **os.environ}


def _key(task: Task) -> str:
    """Digest of all that the report hangs on."""
    digest = hashlib.sha256()
    for path in (task.log, task.model, task.test_log):
        if path is not None:
            digest.update(_content(path))
    digest.update(json.dumps([task.options, task.version]).encode())
    return digest.hexdigest()


def _content(path: Path) -> bytes:
    """Digest of a file, or of a folder by its files' names, sizes and times; of what is not there, nothing."""
    if path.is_dir():
        files = sorted(p for p in path.rglob("*") if p.is_file())
        seen = [(str(p.relative_to(path)), p.stat().st_size, p.stat().st_mtime_ns) for p in files]
        return json.dumps(seen).encode()
    if not path.is_file():
        return b""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


def _done(task: Task, key: str) -> bool:
    try:
        written = json.loads((task.out / _KEY).read_text())
    except (OSError, ValueError):
        return False
    return written == {"key": key} and (task.out / "report.json").is_file()


def _write_key(task: Task, key: str) -> None:
    with whole_file(task.out / _KEY) as file:
        file.write(json.dumps({"key": key}).encode() + b"\n")
