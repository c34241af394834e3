"""Thousands of mutated files through every reader and `load_model`, each kind in a process of its own.

    python benchmarks/fuzz.py --mutate 2800 --seed 1 --store benchmarks/results/fuzz.json

Counts, for each reader: tracebacks (whatever is raised and is no error of the package with one printable line that
names the file), hangs (more than 10 s of one core, a minute of waiting, or a crash), inputs that took more than 1 GB
over the size they may declare, and lines or files that appear beside the answer. What is wrong is kept in --out.
"""

import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
CPU_SECONDS, WALL_SECONDS = 10.0, 60.0
DECLARED, OVER = 16 << 20, 1 << 30
ROOM = 4 << 30
FAULTS = ("traceback", "hang", "memory", "stray")
SUFFIX = {
    "csv": ".csv", "csv in chunks": ".csv", "npz": ".npz", "parquet": ".parquet", "parquet in chunks": ".parquet",
    "LeRobot dataset": "", "ROS 1 bag": ".bag", "db3": ".db3", "mcap": ".mcap", "filter state": ".npz",
    "stream state": ".npz", "MJCF": ".xml", "URDF": ".urdf", "URDF, afloat": ".urdf", "URDF, written": ".urdf",
}  # fmt: skip
KINDS = tuple(SUFFIX)


def campaign(count: int, seed: int, out: Path, store: Path | None) -> int:
    """Run all kinds, print a row for each, and store the counts; 1 where anything was found."""
    out.mkdir(parents=True, exist_ok=True)
    each, began, rows = -(-count // len(KINDS)), time.monotonic(), {}
    print("| reader | inputs | read | refused | " + " | ".join(FAULTS) + " | most MB | most s |")
    print("|---|" + "---|" * (len(FAULTS) + 5), flush=True)
    for kind in KINDS:
        found = _one_kind(kind, each, seed, out)
        outcomes = Counter(x["outcome"] for x in found)
        row = {"inputs": len(found), "read": outcomes["read"], "refused": outcomes["refused"]}
        row |= {fault: sum(fault in x["faults"] for x in found) for fault in FAULTS}
        row |= {"most_mb": max(x["mb"] for x in found), "most_s": max(x["s"] for x in found)}
        rows[kind] = row
        print(f"| {kind} | " + " | ".join(str(x) for x in row.values()) + " |", flush=True)
        for x in found:
            for fault in x["faults"]:
                print(f"    {kind} {x['k']}: {fault}: {x['said']}", flush=True)
    total = {name: sum(row[name] for row in rows.values()) for name in ("inputs", *FAULTS)}
    print("total:", total, f"{time.monotonic() - began:.0f} s")
    if store is not None:
        commit = subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False
        )
        head = {
            "commit": commit.stdout.strip(),
            "seed": seed,
            "seconds": round(time.monotonic() - began),
        }
        limits = {
            "cpu_s": CPU_SECONDS,
            "wall_s": WALL_SECONDS,
            "declared_bytes": DECLARED,
            "over_bytes": OVER,
        }
        text = json.dumps({**head, "limits": limits, "total": total, "readers": rows}, indent=1)
        store.write_text(text + "\n")
    return int(any(total[fault] for fault in FAULTS))


def _one_kind(kind: str, count: int, seed: int, out: Path) -> list[dict[str, Any]]:
    """What became of each input; a process that ends before its time is begun anew behind the input that ended it."""
    found: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name:
        results = Path(name) / "results"
        while len(found) < count:
            results.write_text("")
            job = [kind, str(seed), str(len(found)), str(count), str(results), str(out.resolve())]
            environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
            done = subprocess.run(
                [sys.executable, __file__, *job],
                capture_output=True,
                text=True,
                errors="replace",
                env=environment,
                check=False,
            )
            found += [json.loads(line) for line in results.read_text().splitlines()]
            if len(found) < count:
                said = f"ended by {done.returncode}: {done.stderr.strip()[-300:]}"
                if done.returncode > 0:
                    raise SystemExit(f"{kind}: the harness itself failed: {done.stderr[-2000:]}")
                lost = {"k": len(found), "outcome": "lost", "faults": ["hang"], "said": said}
                found.append({**lost, "mb": 0, "s": 0.0})
    return found


# --- the process of one kind -------------------------------------------------------------------------------------


def work(kind: str, seed: int, first: int, last: int, results: Path, out: Path) -> None:
    """Inputs first to last of one kind, a line of JSON for each."""
    sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "benchmarks")]
    folder = Path(tempfile.mkdtemp(prefix="fuzz-", dir=results.parent))
    os.chdir(folder)
    bases, mutate = _material(kind)
    (folder / "file").mkdir()
    path = folder / "file" / f"robot{SUFFIX[kind]}"
    read, errors = _reader(kind, path)
    rng = np.random.default_rng([seed, KINDS.index(kind), 10**9])
    for content in bases:
        _put(kind, path, content)
        # The first reading loads libraries and fills caches; sound files are read.
        read()
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + ROOM, size + ROOM))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    beside = _listing(folder)
    own = os.dup(2)
    said = open(folder / "said", "w+b")  # noqa: SIM115
    for stream in (1, 2):
        os.dup2(said.fileno(), stream)
    beside = {*beside, "said"}
    with open(results, "a") as lines:
        for k in range(first, last):
            rng = np.random.default_rng([seed, KINDS.index(kind), k])
            try:
                # What NumPy says of absurd values that are made here is none of the readers' doing.
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    content = mutate(rng, bases[k % len(bases)])
            except Exception as error:
                os.write(own, f"input {k}: {error!r}".encode())
                raise
            _put(kind, path, content)
            row = _try(read, errors, path)
            printed = (folder / "said").read_bytes()
            os.ftruncate(1, 0)
            os.lseek(1, 0, os.SEEK_SET)
            if printed or _listing(folder) - beside:
                row["faults"].append("stray")
                row["said"] += f" printed {printed[:300]!r}, files {_listing(folder) - beside}"
            if row["faults"]:
                (out / f"{kind.replace(', ', '-')}-{k}{SUFFIX[kind]}").write_bytes(content)
            lines.write(json.dumps({"k": k, **row}) + "\n")
            lines.flush()


def _listing(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.name != "out.urdf"}


def _put(kind: str, path: Path, content: bytes) -> None:
    if kind != "LeRobot dataset":
        path.write_bytes(content)
        return
    (path / "meta").mkdir(parents=True, exist_ok=True)
    (path / "data" / "chunk-000").mkdir(parents=True, exist_ok=True)
    info, _, table = content.partition(b"\0table\0")
    (path / "meta" / "info.json").write_bytes(info)
    (path / "data" / "chunk-000" / "file-000.parquet").write_bytes(table)


def _try(read: Callable[[], None], errors: tuple[type, ...], path: Path) -> dict[str, Any]:
    """Outcome, faults, memory [MB] and time [s] of one reading."""
    Path("/proc/self/clear_refs").write_text("5")
    before, faults, said = _peak(), [], ""
    signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)
    signal.setitimer(signal.ITIMER_REAL, WALL_SECONDS)
    start = time.process_time()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            read()
            outcome = "read"
        except errors as error:
            outcome, said = "refused", str(error)
            if not said.isprintable() or path.name not in said or len(said) > 3000:
                faults.append("traceback")
                said = f"not one line with the file's name: {said[:300]!r}"
        except BaseException as error:
            outcome, said = "raised", f"{type(error).__name__}: {error}"[:300]
            faults.append("traceback")
    seconds = time.process_time() - start
    signal.setitimer(signal.ITIMER_PROF, 0)
    signal.setitimer(signal.ITIMER_REAL, 0)
    more = _peak() - before
    from jax_inertia.model.load import ModelWarning

    if raw := [w for w in told if not issubclass(w.category, ModelWarning)]:
        faults.append("stray")
        said += f" warned: {raw[0].category.__name__}: {raw[0].message} {raw[0].filename}:{raw[0].lineno}"
    if more > DECLARED + OVER:
        faults.append("memory")
    return {
        "outcome": outcome,
        "faults": faults,
        "said": said[:400],
        "mb": more >> 20,
        "s": round(seconds, 2),
    }


def _peak() -> int:
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) << 10


def _material(kind: str) -> tuple[list[bytes], Any]:
    """Sound files of one kind, and what mutates them."""
    import fuzz
    import log_files
    import mutations
    import test_hostile
    import test_model_files
    from models import MODELS

    package = importlib.import_module("jax_inertia")
    for name in ("logs.log_files", "logs.readers", "estimation.checkpoint", "model.load"):
        importlib.import_module(f"jax_inertia.{name}")
    if kind.startswith("csv"):
        return [test_hostile.valid("csv")], mutations.text(["time,qpos.a,tau.a\n", '"', ",,,,"])
    if kind.startswith("parquet"):
        return [test_hostile.valid("parquet")], mutations.parquet
    if kind in ("ROS 1 bag", "db3", "mcap"):
        suffix = "bag" if kind == "ROS 1 bag" else kind
        maker = log_files.Maker(suffix == "bag")

        def write(at: Path, sent: list) -> Path:
            made = log_files.write_bag(at if suffix == "bag" else at.with_name("bag"), sent, suffix)
            return made if suffix == "bag" else next(made.glob(f"*.{suffix}"))

        return [test_hostile.valid(suffix)], mutations.bag(write, maker, suffix)
    if kind == "LeRobot dataset":
        with tempfile.TemporaryDirectory() as name:
            made = log_files.write_dataset(Path(name) / "set", episodes=1)
            parts = (made / "meta" / "info.json", next(made.glob("data/*/*.parquet")))
            base = b"\0table\0".join(part.read_bytes() for part in parts)
        inner = mutations.text([])

        def dataset(rng: np.random.Generator, content: bytes) -> bytes:
            info, _, table = content.partition(b"\0table\0")
            if rng.random() < 0.5:
                info = inner(rng, info)
            else:
                table = mutations.parquet(rng, table)
            return info + b"\0table\0" + table

        return [base], dataset
    if kind == "npz":
        return fuzz.seeds("npz", package), mutations.npz
    if kind == "filter state":
        return fuzz.seeds("state", package), mutations.npz
    if kind == "stream state":
        return [_stream_state()], mutations.npz
    if kind == "MJCF":
        return [text.encode() for text in MODELS.values()], mutations.text(mutations.MJCF)
    return [test_model_files.URDF.encode()], mutations.text(mutations.URDF)


def _stream() -> Any:
    import fuzz

    from jax_inertia.estimation.stream import Stream

    return Stream(fuzz._estimator())


def _stream_state() -> bytes:
    from jax_inertia.estimation.checkpoint import save_stream
    from jax_inertia.robots.pendulum import swing

    stream = _stream()
    state, _ = stream.feed(stream.start(), swing(seconds=0.5))
    with tempfile.TemporaryDirectory() as name:
        save_stream(Path(name) / "state.npz", stream, state)
        return (Path(name) / "state.npz").read_bytes()


def _reader(kind: str, path: Path) -> tuple[Callable[[], None], tuple[type, ...]]:
    """What reads the file and looks at what came of it, and what it may raise."""
    import fuzz
    import jax

    from jax_inertia import load_model, read_log
    from jax_inertia.estimation.checkpoint import StateError, load_state, load_stream
    from jax_inertia.logs.chunks import read_chunks
    from jax_inertia.logs.log import Log, LogError
    from jax_inertia.logs.readers import Options
    from jax_inertia.model.load import ModelError, is_urdf, write_urdf

    ros = Options(topic_base="/odom", topic_wrenches={"foot": "/ft"})
    sound = Options() if kind not in ("ROS 1 bag", "db3", "mcap") else ros

    def check(log: Log) -> None:
        # A robot that is told positions has targets instead of torques.
        moved = log.qpos_target if log.tau is None else log.tau
        assert log.qpos.shape == moved.shape == (len(log.time), len(log.joint_names))
        assert np.all(np.diff(log.time) > 0)

    def one_log() -> None:
        try:
            check(read_log(path, options=sound, max_bytes=DECLARED))
        except LogError as error:
            # Without odometry and wrenches, what the mutated messages are is looked at too.
            if "no nav_msgs" not in str(error) and "no geometry_msgs" not in str(error):
                raise
            check(read_log(path, max_bytes=DECLARED))

    def chunks() -> None:
        for log in read_chunks(path, rows=5):
            check(log)

    def model() -> None:
        robot = load_model(path, floating_base=kind == "URDF, afloat")
        assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(robot))

    def written() -> None:
        if is_urdf(path):
            write_urdf(path, path.with_name("out.urdf"), {})
            assert path.with_name("out.urdf").read_bytes() == path.read_bytes()

    estimator, stream = (fuzz._estimator(), _stream()) if "state" in kind else (None, None)
    readers: dict[str, tuple[Callable[[], Any], tuple[type, ...]]] = {
        "filter state": (lambda: load_state(path, estimator), (StateError,)),
        "stream state": (lambda: load_stream(path, stream), (StateError,)),
        "URDF, written": (written, (ModelError,)),
    }
    if kind in readers:
        return readers[kind]
    if "chunks" in kind:
        return chunks, (LogError,)
    return (
        (model, (ModelError,))
        if kind in ("MJCF", "URDF", "URDF, afloat")
        else (one_log, (LogError,))
    )


if __name__ == "__main__":
    work(sys.argv[1], *map(int, sys.argv[2:5]), Path(sys.argv[5]), Path(sys.argv[6]))
