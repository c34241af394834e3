"""Diagnoses every log of a sealed set with the public command, in processes that know nothing of the examination.

    python -m benchmarks.blind.solve LOGS OUT --jobs 2 [--timeout 300] [--exclude FAMILY ...] [--fresh] [--only FILE]

Each log is copied under a neutral name into a private folder, where a process that can import the package (a copy of
it) and its libraries alone, and open no other file, runs `jax-inertia diagnose`, with the log's validation run where it
has one. The run that judges is not among what it gets. Several processes have a core each, and longest logs come first.
The process stays for many logs, so that what JAX compiled is kept (`--fresh`: one process a log).
OUT/results/NAME appears whole or not at all: report.json, corrected.xml and run.json; a second call goes on with what
is missing. Needs the package's own dependencies alone.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import queue
import shutil
import subprocess
import sys
import threading
import time
import zipfile
from dataclasses import dataclass
from importlib import metadata, util
from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn
from rich.progress import TimeRemainingColumn as Remaining

from benchmarks.blind import checkout

GIVEN = ("log.npz", "nominal.xml", "validation.npz")
KEPT = ("report.json", "corrected.xml")
PER_PROCESS = 60
TIMEOUT = 1800.0


class Diagnoser:
    """One isolated process, started again when it has done its share, hangs or dies."""

    def __init__(
        self,
        home: Path,
        cache: Path | None,
        per_process: int,
        timeout: float,
        package=None,
        core: int | None = None,
    ):
        """`package(folder)` puts the package to be examined into an empty folder; `core`: the one it runs on."""
        self.core = core
        self.home, self.cache, self.package = home, cache, package or copy_package
        self.per_process, self.timeout = per_process, timeout
        self.process: subprocess.Popen | None = None
        self.done = 0
        self.stopped = threading.Event()

    def _start(self) -> subprocess.Popen:
        shutil.rmtree(self.home, ignore_errors=True)
        for folder in ("package", "job", "tmp"):
            (self.home / folder).mkdir(parents=True)
        self.package(self.home / "package")
        environment = {
            **{k: os.environ[k] for k in ("PATH", "LD_LIBRARY_PATH", "LANG") if k in os.environ},
            **{k: v for k, v in os.environ.items() if k.startswith(("XLA_", "JAX_PLATFORM"))},
            "HOME": str(self.home),
            "TMPDIR": str(self.home / "tmp"),
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }
        readable = []
        if self.cache is not None:
            environment |= {
                "JAX_COMPILATION_CACHE_DIR": str(self.cache),
                "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
            }
            readable.append(str(self.cache))
        libraries = [str(Path(p).resolve()) for p in sys.path[1:] if p and Path(p).is_dir()]
        code = (Path(__file__).parent / "worker.py").read_text()
        process = subprocess.Popen(
            [sys.executable, "-I", "-c", code, str(self.home / "package"), str(self.home),
             os.pathsep.join(libraries), *readable],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment,
            stderr=(self.home.parent / f"{self.home.name}.log").open("a"), cwd=self.home / "job",
            # Ctrl-C is for the examination to act on: a command that it ended would pass for one that failed.
            start_new_session=True,
        )  # fmt: skip
        if self.core is not None:
            os.sched_setaffinity(process.pid, {self.core})
        return process

    def ask(self, arguments: list[str]) -> dict:
        """Run the command once; {"exit", "seconds", "error"?}. KeyboardInterrupt when stopped meanwhile."""
        if self.process is None or self.done >= self.per_process:
            self.close()
            self.process, self.done = self._start(), 0
        self.done += 1
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        hurry = threading.Timer(self.timeout, self.process.kill)
        hurry.start()
        try:
            if self.stopped.is_set():
                raise KeyboardInterrupt
            self.process.stdin.write(json.dumps({"arguments": arguments}) + "\n")
            self.process.stdin.flush()
            line = self.process.stdout.readline()
        except BrokenPipeError:
            line = ""
        finally:
            hurry.cancel()
        if self.stopped.is_set():
            raise KeyboardInterrupt
        if line:
            return json.loads(line)
        code = self.process.wait()
        self.process = None
        return {"exit": 1, "error": f"the process ended with status {code}", "seconds": None}

    def diagnose(self, log: Path, out: Path, exclude: list[str]) -> None:
        """One log; OUT/results/NAME appears when all is written."""
        job = self.home / "job"
        if self.process is None or self.done >= self.per_process:
            self.close()
            self.process, self.done = self._start(), 0
        for old in job.iterdir():
            shutil.rmtree(old) if old.is_dir() else old.unlink()
        for name in GIVEN:
            if (log / name).exists():
                shutil.copyfile(log / name, job / name)
        arguments = ["diagnose", "log.npz", "--model", "nominal.xml"]
        if (job / "validation.npz").exists():
            arguments += ["--validation-log", "validation.npz"]
        if exclude:
            arguments += ["--exclude", *exclude]
        answer = self.ask([*arguments, "--out", "found"])
        part = out / "parts" / log.name
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        for name in KEPT:
            if (job / "found" / name).exists():
                shutil.copyfile(job / "found" / name, part / name)
        (part / "run.json").write_text(json.dumps(answer | {"exclude": exclude}))
        (out / "results").mkdir(exist_ok=True)
        part.rename(out / "results" / log.name)

    def stop(self) -> None:
        """End the command that runs, whose log then has no result."""
        self.stopped.set()
        if (process := self.process) is not None:
            process.kill()

    def close(self) -> None:
        if self.process is not None:
            assert self.process.stdin is not None
            self.process.stdin.close()
            self.process.wait()
            self.process = None


def copy_package(target: Path) -> None:
    """The package's own files, and the note of its version that the command looks up."""
    spec = util.find_spec("jax_inertia")
    if spec is None or not spec.submodule_search_locations:
        raise SystemExit("jax_inertia cannot be imported: install it, or put it on PYTHONPATH")
    source = Path(spec.submodule_search_locations[0])
    shutil.copytree(
        source, target / "jax_inertia", ignore=shutil.ignore_patterns("__pycache__", "*.pyc")
    )
    note = target / "jax_inertia-0.dist-info"
    note.mkdir()
    (note / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: jax-inertia\nVersion: {version()}\n"
    )


def version() -> str:
    try:
        return metadata.version("jax-inertia")
    except metadata.PackageNotFoundError:
        return "0+checkout"


def turn(log: Path) -> tuple:
    """Logs of targets and of feet come first: they take longest. The rest by their names, which are random."""
    with zipfile.ZipFile(log / "log.npz") as archive:
        names = archive.namelist()
    return not {"qpos_target.npy", "base_quat.npy"} & {*names}, log.name


@dataclass(frozen=True)
class Task:
    """A log, where its result goes, and which families the library is to lack."""

    log: Path
    out: Path
    exclude: tuple[str, ...] = ()

    @property
    def done(self) -> bool:
        return (self.out / "results" / self.log.name).exists()


def solve(
    tasks: list[Task],
    work: Path,
    jobs: int = 1,
    fresh: bool = False,
    timeout: float = TIMEOUT,
) -> None:
    """Diagnose what has no result yet, all from one queue; `work` holds the processes' homes and their cache."""
    work = work.resolve()
    for out in {t.out for t in tasks}:
        (out / "results").mkdir(parents=True, exist_ok=True)
    for out, exclude in sorted({(t.out, t.exclude) for t in tasks}):
        _note_run(out, jobs, list(exclude))
    waiting: queue.Queue[Task] = queue.Queue()
    todo = sorted((t for t in tasks if not t.done), key=lambda t: turn(t.log))
    for task in todo:
        waiting.put(task)
    cache = work / "cache"
    cache.mkdir(parents=True, exist_ok=True)
    columns = ("diagnosing", BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), Remaining())
    failures: list[BaseException] = []
    with Progress(*columns) as progress:
        bar = progress.add_task("", total=len(tasks), completed=len(tasks) - len(todo))

        count = min(jobs, len(todo))
        share = 1 if fresh else PER_PROCESS
        cores = sorted(os.sched_getaffinity(0)) if count > 1 else [None]
        diagnosers = [
            Diagnoser(work / f"{k:02d}", cache, share, timeout, core=cores[k % len(cores)])
            for k in range(count)
        ]

        def worker(diagnoser: Diagnoser) -> None:
            try:
                while not failures:
                    task = waiting.get_nowait()
                    diagnoser.diagnose(task.log.resolve(), task.out.resolve(), list(task.exclude))
                    progress.advance(bar)
            except queue.Empty:
                pass
            except BaseException as error:
                failures.append(error)
            finally:
                diagnoser.close()

        threads = [threading.Thread(target=worker, args=(d,)) for d in diagnosers]
        for thread in threads:
            thread.start()
        try:
            for thread in threads:
                thread.join()
        except KeyboardInterrupt as stop:
            failures.append(stop)
            for diagnoser in diagnosers:
                diagnoser.stop()
            for thread in threads:
                thread.join()
    if failures:
        raise failures[0]
    for out in {t.out for t in tasks}:
        shutil.rmtree(out / "parts", ignore_errors=True)


def _note_run(out: Path, jobs: int, exclude: list[str]) -> None:
    """What ran, where: appended to runs.json, one entry per call."""
    file = out / "runs.json"
    runs = json.loads(file.read_text()) if file.exists() else []
    versions = {}
    for name in ("jax", "jaxlib", "mujoco", "numpy", "scipy", "equinox", "optimistix"):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = None
    runs.append(
        {
            "began": time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime()),
            "command": " ".join([Path(sys.argv[0]).name, *sys.argv[1:]]),
            "commit": checkout.commit(),
            "package": version(),
            "python": platform.python_version(),
            "machine": f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores",
            "jobs": jobs,
            "exclude": exclude,
            "versions": versions,
        }
    )
    part = file.with_suffix(".part")
    part.write_text(json.dumps(runs, indent=1))
    part.rename(file)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--exclude", nargs="+", default=[], metavar="FAMILY")
    parser.add_argument("--fresh", action="store_true", help="a new process for every log")
    parser.add_argument("--only", type=Path, help="file with names of logs, one a line")
    parser.add_argument("--timeout", type=float, default=TIMEOUT, help="seconds a log may take")
    args = parser.parse_args()
    logs = sorted(p for p in args.logs.iterdir() if (p / "log.npz").exists())
    if args.only:
        wanted = set(args.only.read_text().split())
        logs = [p for p in logs if p.name in wanted]
    tasks = [Task(p, args.out, tuple(args.exclude)) for p in logs]
    solve(tasks, args.out / "work", args.jobs, args.fresh, args.timeout)


if __name__ == "__main__":
    main()
