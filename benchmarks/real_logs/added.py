"""Effects added to real logs and withheld: are they named among all that a real robot has of its own?

    python benchmarks/real_logs/added.py --out DIR [--only NAME ...] [--seed N]

Each log of `diagnosis_cases.py` is left as it was recorded but for its torques: they get what one more effect, drawn
by --seed, would ask of the drives for the same motion (`added_effects.py`, MuJoCo C), on the other run as well. The
diagnosis sees model and logs alone. What the log as recorded is said to have already is not added again. DIR/NAME/K
gets logs, report.json and answer.json; a second call goes on where the first was stopped. Writes ADDED.md and its
figure beside itself from what DIR holds.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import dataclasses
import json
import time
import warnings
from pathlib import Path

import added_report as page
import jax
import numpy as np
from added_effects import BODY, JOINT, Effect, Recording, draw, sized
from diagnosis_cases import CASES, Case, Files
from logs import SHARED
from report import machine

from jax_inertia.cli import diagnose_run as pipeline
from jax_inertia.cli.console import stages
from jax_inertia.logs.log import Log, TorqueKind
from jax_inertia.logs.log_files import read_log, write_log

HERE = Path(__file__).parent
COUNT = {"ur10e_no_load": 9, "ur10e_payload": 9, "double_pendulum": 8, "panda": 4, "lwr4": 4}
"""Logs of each case. Those whose torques are volts or amperes would need the gain that is sought."""
# What an effect adds on the row where it is loudest, beside what the model misses there (both rms).
LEAST, MOST = 0.5, 3.0
# A case's own number of effects leaves no place for another.
MORE = 2
LOG, TEST, ANSWER = "log.npz", "test.npz", "answer.json"


def diagnosed(case: Case, files: Files, folder: Path) -> dict:
    """report.json of the public command, made once."""
    report = folder / "report.json"
    if not report.exists():
        start = time.perf_counter()
        with stages() as stage:
            stage(f"{folder.parent.name}/{folder.name}")
            inputs = pipeline.read(files.model, files.log, files.test, ())
            most = case.max_effects + MORE
            pipeline.write(folder, inputs, pipeline.diagnosis(inputs, (), most, stage))
        (folder / "seconds.json").write_text(json.dumps(time.perf_counter() - start))
    return json.loads(report.read_text())


def recording(model: Path, log: Log) -> Recording:
    return Recording(model, *(np.asarray(x, float) for x in (log.time, log.qpos, log.tau)))


def add(files: Files, untouched: dict, seed: tuple[int, ...], folder: Path) -> None:
    """Logs with one more effect in `folder`, and then the answer beside them."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    logs = [read_log(path) for path in (files.log, files.test) if path]
    recordings = [recording(files.model, log) for log in logs]
    effect = drawn(recordings[0], logs[0].tau_kind, untouched, rng)
    ratio = float(np.exp(rng.uniform(np.log(LEAST), np.log(MOST))))
    size = sized(effect, recordings[0], ratio)
    for log, r, name in zip(logs, recordings, (LOG, TEST), strict=False):
        write_log(dataclasses.replace(log, tau=r.tau + effect.torque(r, size)), folder / name)
    answer = {
        "family": effect.family,
        "place": effect.place,
        "number": effect.number,
        "value": effect.value(size),
        "ratio": ratio,
    }
    (folder / ANSWER).write_text(json.dumps(answer, indent=1) + "\n")


def drawn(r: Recording, kind: TorqueKind, untouched: dict, rng: np.random.Generator) -> Effect:
    """An effect that this log is not said to have already, nor to be unable to tell from one."""
    said = page.said(untouched)
    # A sensor behind the gear is not late.
    families = [f for f in (*JOINT, *BODY) if f != "time_delay" or kind is not TorqueKind.SENSOR]
    while True:
        effect = draw(str(rng.choice(families)), r, rng)
        if page.key(effect.family, effect.place) not in said:
            return effect


def run(case: Case, folder: Path, seed: int) -> None:
    """All logs of one case."""
    recorded = folder / "as_recorded"
    recorded.mkdir(parents=True, exist_ok=True)
    files = case.prepare(recorded)
    untouched = diagnosed(case, files, recorded)
    number = [c.name for c in CASES].index(case.name)
    for k in range(COUNT[case.name]):
        part = folder / f"{k:02d}"
        if not (part / ANSWER).exists():
            add(files, untouched, (seed, number, k), part)
        own = Files(files.model, part / LOG, files.test and part / TEST)
        report = diagnosed(case, own, part)
        print(page.line(page.Row.of(case.name, part, report, untouched)), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", nargs="+", choices=COUNT, default=list(COUNT), metavar="NAME")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore")
    for case in CASES:
        if case.name in args.only:
            if case.present:
                run(case, args.out / case.name, args.seed)
            else:
                print(f"{case.name}: skipped, no {SHARED / case.folder}", flush=True)
    if rows := page.collect(args.out):
        page.write(HERE, rows, args.seed, machine())
        print(f"wrote {HERE / page.PAGE}")


if __name__ == "__main__":
    main()
