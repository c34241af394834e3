"""Hostile input for every reader and `load_model`: mutated files, or by coverage (atheris, libFuzzer):

    python benchmarks/fuzz.py --mutate 2800 --store benchmarks/results/fuzz.json
    pip install atheris && python benchmarks/fuzz.py --seconds 60

Each kind of file runs in a process of its own, from sound files of the tests as seeds, guided by branches of the
package and of the pure-Python libraries under it. A finding is any exception but `LogError`, `ModelError`, `StateError`
with one printable line; more than ten seconds; more memory than the limit; a crash of the process. Prints a row for
each kind, and ends with status 1 where something was found; the input is then kept in --out.
"""

import argparse
import importlib
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
LOGS = ("csv", "npz", "parquet", "bag", "db3", "mcap")
KINDS = (*LOGS, "state", "mjcf", "urdf")
GUIDES = ("jax_inertia", "rosbags", "mcap")
SECONDS_MOST, MEGABYTES_MOST = 10, 4000


def main() -> int:
    parser = argparse.ArgumentParser(description="Coverage-guided fuzzing of every reader")
    parser.add_argument("--seconds", type=int, default=60, metavar="S", help="for each kind")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), metavar="DIR")
    parser.add_argument("--one", choices=KINDS, help=argparse.SUPPRESS)
    parser.add_argument("--mutate", type=int, metavar="N", help="mutated files, all kinds together")
    parser.add_argument("--seed", type=int, default=1, help="of the mutations")
    parser.add_argument("--store", type=Path, metavar="JSON", help="where their counts go")
    args = parser.parse_args()
    if args.mutate:
        return importlib.import_module("fuzz_mutations").campaign(
            args.mutate, args.seed, args.out, args.store
        )
    if args.one:
        fuzz(args.one, args.seconds, args.out)
    args.out.mkdir(parents=True, exist_ok=True)
    print("| kind | inputs | branches seen | outcome |\n|---|---|---|---|", flush=True)
    worst = 0
    for kind in args.kinds:
        one = ["--one", kind, "--seconds", str(args.seconds), "--out", str(args.out)]
        done = subprocess.run(
            [sys.executable, __file__, *one], capture_output=True, text=True, errors="replace"
        )
        said = done.stdout + done.stderr
        runs = re.findall(r"number_of_executed_units:\s*(\d+)", said) or re.findall(
            r"#(\d+)\s", said
        )
        seen = re.findall(r" cov: (\d+)", said)
        outcome = "nothing" if done.returncode == 0 else _finding(said)
        print(f"| {kind} | {(runs or '?')[-1]} | {(seen or '?')[-1]} | {outcome} |", flush=True)
        worst = max(worst, int(done.returncode != 0))
    return worst


def _finding(said: str) -> str:
    """The last line that names what went wrong."""
    lines = [
        x for x in said.splitlines() if re.search(r"Error|Exception|timeout|out-of-mem|SUMM", x)
    ]
    return (lines or said.splitlines() or ["died in silence"])[-1][:200].replace("|", "/")


def fuzz(kind: str, seconds: int, out: Path) -> None:
    """Run libFuzzer on one kind; does not return."""
    atheris: Any = importlib.import_module("atheris")

    sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
    with atheris.instrument_imports(include=list(GUIDES)):
        import jax_inertia.estimation.checkpoint
        import jax_inertia.logs.log_files
        import jax_inertia.logs.readers
        import jax_inertia.model.load
    corpus = Path(tempfile.mkdtemp(prefix=f"fuzz-{kind}-"))
    for k, content in enumerate(seeds(kind, jax_inertia)):
        (corpus / f"seed_{k}").write_bytes(content)
    read = reader(kind, corpus.with_name(corpus.name + f"-file.{kind}"), jax_inertia)
    out.mkdir(parents=True, exist_ok=True)
    options = [
        f"-max_total_time={seconds}",
        f"-timeout={SECONDS_MOST}",
        f"-rss_limit_mb={MEGABYTES_MOST}",
        "-max_len=65536",
        "-print_final_stats=1",
        f"-artifact_prefix={out}/{kind}-",
    ]
    atheris.Setup([sys.argv[0], str(corpus), *options], read)
    atheris.Fuzz()


def seeds(kind: str, package) -> list[bytes]:
    """Sound files of one kind."""
    if kind in ("csv", "parquet", "bag", "db3", "mcap"):
        return [importlib.import_module("test_hostile").valid(kind)]
    if kind == "urdf":
        return [importlib.import_module("test_model_files").URDF.encode()]
    if kind == "mjcf":
        return [text.encode() for text in importlib.import_module("models").MODELS.values()]
    from jax_inertia.robots.pendulum import swing

    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "file.npz"
        if kind == "npz":
            package.logs.log_files.write_log(swing(seconds=0.2), path)
        else:
            package.estimation.checkpoint.save_state(path, _estimator(), _estimator().initial())
        return [path.read_bytes()]


def _estimator():
    from jax_inertia import load_model
    from jax_inertia.estimation.inertial_filter import make_estimator
    from jax_inertia.robots.pendulum import double_pendulum

    return make_estimator(load_model(double_pendulum()), ["lower"], sigma_tau=0.1)


def reader(kind: str, path: Path, package) -> Callable[[bytes], None]:
    """One input: written, read, and either sound or refused in a printable line."""
    import warnings

    warnings.simplefilter("ignore")
    errors = (
        package.logs.npz.LogError,
        package.model.load.ModelError,
        package.estimation.checkpoint.StateError,
    )
    bag = package.logs.readers.Options(topic_base="/odom", topic_wrenches={"foot": "/ft"})
    options = bag if kind in ("bag", "db3", "mcap") else package.logs.readers.Options()
    if kind in LOGS:
        path = path.with_suffix(f".{kind}")

        def read():
            return package.logs.log_files.read_log(path, options=options, max_bytes=1 << 24)
    elif kind == "state":
        path, estimator = path.with_suffix(".npz"), _estimator()

        def read():
            return package.estimation.checkpoint.load_state(path, estimator)
    else:

        def read():
            return package.model.load.load_model(path)

    def one(data: bytes) -> None:
        path.write_bytes(data)
        try:
            read()
        except errors as error:
            if not str(error).isprintable():
                raise AssertionError(f"not one printable line: {str(error)!r}") from None

    return one


if __name__ == "__main__":
    sys.exit(main())
