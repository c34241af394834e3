"""Diagnoses of many logs, each in a process of its own, on this machine or on a Dask cluster.

A process that dies takes its own log with it and no other: that log is tried again. What is done is not done again: a
folder holds report.json and, written after it, a key of log, model, options and version.
"""

import concurrent.futures
import hashlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from jax_inertia.fleet.report_file import read_report
from jax_inertia.fleet.running import Running
from jax_inertia.logs.atomic_files import whole_file
from jax_inertia.logs.plain_file import read_plain
from jax_inertia.model.file_safety import check_model, includes_below
from jax_inertia.model.spec import model_path

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
    include_root: Path | None = None
    """Folder below which the model may include files."""


class Outcome(NamedTuple):
    """What became of a task."""

    task: Task
    status: str
    """done, before (a run before this one did it), refused, lost (its process died each time)."""
    message: str = ""


def run_here(
    tasks: Sequence[Task], jobs: int, on_end: Callable[[Outcome, int], None]
) -> list[Outcome]:
    """All tasks by so many processes at a time; `on_end` is called with each as it ends and how many have ended.

    Where it is interrupted what is done stays done, and the processes that run are ended.
    """
    running = Running()
    with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
        waiting = [pool.submit(diagnose, task, running) for task in tasks]
        try:
            ended = _in_time((f.result() for f in concurrent.futures.as_completed(waiting)), on_end)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            running.end()
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
        raise ValueError("--dask needs Dask: pip install distributed") from None
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


def diagnose(task: Task, running: Running | None = None) -> Outcome:
    """`jax-inertia diagnose` of one log in a process of its own, unless that was done before."""
    running = running or Running()
    key = _key(task)
    if _done(task, key):
        return Outcome(task, "before")
    program = task.program or (sys.executable, "-m", "jax_inertia", "diagnose")
    command = [*program, str(task.log), "--model", str(task.model), "--out", str(task.out)]
    if task.test_log is not None:
        command += ["--test-log", str(task.test_log)]
    if task.include_root is not None:
        command += ["--include-root", str(task.include_root)]
    status, message, deaths = None, "", 0
    while deaths < ATTEMPTS and not running.ended:
        with running.one([*command, *task.options], _environment(task)) as process:
            said = "" if process.stderr is None else process.stderr.read()
            status, message = process.wait(), _last_line(said)
        if status == 0:
            _write_key(task, key)
            return Outcome(task, "done")
        if status == BAD_INPUT and _BUSY in message:
            # What another process writes there counts.
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
    """Digest of all that the report hangs on: files by their content, the model's with all that it consists of."""
    digest = hashlib.sha256()
    named = [Path(word) for option in task.options for word in (option, option.rpartition("=")[2])]
    for path in (task.log, task.test_log, *_parts(task), *named):
        if path is not None:
            digest.update(_content(path))
    digest.update(json.dumps([task.options, task.version]).encode())
    return digest.hexdigest()


def _parts(task: Task) -> Sequence[Path]:
    """The files of a model: includes, meshes, textures. One that is refused is its own file alone."""
    try:
        path = model_path(task.model)
        with includes_below(task.include_root):
            return check_model(path).files if path.is_file() else ()
    except ValueError:
        return (task.model,)


def _content(path: Path) -> bytes:
    """Digest of a file, or of a folder by its files' names, sizes and times; of what is not there, nothing."""
    try:
        is_dir, is_file = path.is_dir(), path.is_file()
    except (OSError, ValueError):
        return b""
    if is_dir:
        files = sorted(p for p in path.rglob("*") if p.is_file())
        seen = [(str(p.relative_to(path)), p.stat().st_size, p.stat().st_mtime_ns) for p in files]
        return json.dumps(seen).encode()
    if not is_file:
        return b""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


def _done(task: Task, key: str) -> bool:
    try:
        written = json.loads(read_plain(task.out / _KEY, 1 << 16))
        # One that is not sound was not written by this version: it is done once more.
        read_report(task.out)
    except (OSError, ValueError, RecursionError):
        return False
    return written == {"key": key}


def _write_key(task: Task, key: str) -> None:
    with whole_file(task.out / _KEY) as file:
        file.write(json.dumps({"key": key}).encode() + b"\n")
