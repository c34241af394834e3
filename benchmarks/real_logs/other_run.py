"""Real robots: torque error of a run that nothing saw, of the model as given, least squares, published fits, diagnosis.

    python -m benchmarks.real_logs.other_run OUT [--only NAME ...] [--python PYTHON]

Each robot is fitted on one run (or the first part of its only one) and judged on another (or the rest), then the other
way round, by the measure of `benchmarks/exam/torque_error.py`: rows in which a joint moves, 10 Hz. `jax-inertia
diagnose LOG --model MODEL` runs with its defaults in a fresh process; the judged run is never given to it. What it
hands over is report.json and corrected.xml, computed again by `report_torque.py`, which imports nothing of the package;
what it states is its error on held-out rows of its own log. Currents and voltages become torques by published gains; in
runs named `_raw` they stay what they are, and least squares gets a gain a joint. OUT/NAME.json is written as each row
is done, and a row that is there is not made again. The logs are looked for in ../shared/data beside the repository, or
in $JAX_INERTIA_DATA; what is absent is skipped.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import resource
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.exam.least_squares import fit
from benchmarks.exam.report_torque import ReportTorque
from benchmarks.exam.torque_error import Predictor, needed, read, torque_error
from benchmarks.real_logs import cases
from benchmarks.real_logs.logs import SHARED

CASES = {case.name: case for case in cases.CASES}
UR10E, DFKI, LWR4 = "ur10e_dynamic_calibration", "dfki_double_pendulum", "kuka_lwr4_flobaroid"


@dataclass(frozen=True)
class Part:
    """Rows of a run: a file of the robot's folder and the share of its time, from 0 to 1."""

    file: str
    begin: float = 0.0
    end: float = 1.0

    @property
    def label(self) -> str:
        """For a reader: the file, or which part of it."""
        if (self.begin, self.end) == (0.0, 1.0):
            return self.file.removeprefix("dev_")
        share = f"{100 * (self.end - self.begin):.0f} %"
        return f"last {share}" if self.begin else f"first {share}"


@dataclass(frozen=True)
class Run:
    """One robot: its nominal model, the run that is fitted and the run that is judged."""

    name: str
    robot: str
    folder: str
    case: str
    """The case whose model this is, and whose logs where it makes them itself."""
    seen: Part
    judged: Part
    gains: np.ndarray | None = None
    """Published N m for each unit logged, of robots whose log is no torque."""
    kind: str = ""
    """Where the torque comes from; empty leaves what the log says."""
    raw: bool = False
    """The tool and least squares get the logged unit as it is."""

    @property
    def present(self) -> bool:
        return (SHARED / self.folder).is_dir()

    @property
    def back(self) -> "Run":
        """The other way round."""
        return replace(self, name=f"{self.name}_back", seen=self.judged, judged=self.seen)

    @property
    def diagnosis(self) -> str:
        """One name for all rows that are of one diagnosis."""
        part = f"{self.seen.file}_{self.seen.begin:g}_{self.seen.end:g}"
        return f"{self.case}_{part}" + "_raw" * self.raw

    @property
    def title(self) -> str:
        return f"{self.robot}, {self.seen.label} → {self.judged.label}"

    def log(self, part: Part, files: cases.Files) -> dict[str, np.ndarray]:
        """A part as the tool gets it."""
        own = [p for p in (files.log, files.test) if p is not None and p.stem == part.file]
        log = read(own[0] if own else SHARED / self.folder / f"{part.file}.npz")
        share = log["time"] / log["time"][-1]
        rows = (share >= part.begin) & (share < part.end) if part.end < 1 else share >= part.begin
        keep = ("time", "joint_names", "qpos", "qvel", "tau", "tau_unit", "tau_kind")
        log = {
            k: x[rows] if x.ndim and len(x) == len(rows) else x for k, x in log.items() if k in keep
        }
        if self.gains is not None and not self.raw:
            log["tau"], log["tau_unit"] = log["tau"] * self.gains, np.array("N m")
        if self.kind:
            log["tau_kind"] = np.array(self.kind)
        return log


_GAINS = CASES["ur10e"].gains
_FREE = Part("dev_free_1"), Part("dev_free_2")
_XL330 = Part("train_07_sin_time_square_kp200"), Part("test_08_sin_sin_kp400")
_AMPERES = {"gains": _GAINS, "kind": "current"}


def _split(file: str, at: float) -> tuple[Part, Part]:
    return Part(file, 0.0, at), Part(file, at, 1.0)


_SENSOR = {"kind": "sensor"}
_TEST = Part("test_3")
FORTH = (
    Run("panda", "Panda", "panda_gaz2019", "panda", Part("train"), Part("test"), **_SENSOR),
    Run("ur10e", "UR10e", UR10E, "ur10e", *_FREE, **_AMPERES),
    Run("ur10e_payload", "UR10e with 2.8 kg", UR10E, "ur10e", *_split("dev_pair_payload", 0.6), **_AMPERES),
    Run("ur10e_no_load", "UR10e without it", UR10E, "ur10e", *_split("dev_pair_free", 0.6), **_AMPERES),
    Run("double_pendulum", "double pendulum", DFKI, "double_pendulum", Part("C1_train_00"), Part("C1_test_08")),
    Run("xl330", "XL330", "bam_xl330", "xl330", *_XL330, gains=CASES["xl330"].gains),
    Run("lwr4", "LWR4+", LWR4, "lwr4", Part("train_1"), _TEST, **_SENSOR),
    Run("lwr4_repeat", "LWR4+", LWR4, "lwr4", Part("train_2_repeat"), _TEST, **_SENSOR),
    Run("ur10e_raw", "UR10e", UR10E, "ur10e", *_FREE, **_AMPERES, raw=True),
    Run("xl330_raw", "XL330", "bam_xl330", "xl330", *_XL330, gains=CASES["xl330"].gains, raw=True),
)  # fmt: skip
RUNS = tuple(way for run in FORTH for way in (run, run.back))


def published(case: str, gains: np.ndarray | None = None) -> Predictor | None:
    """The published fit beside the nominal bodies; with `gains`, in the logged unit."""
    law = CASES[case].law
    if law is None:
        return None
    by = 1.0 if gains is None else gains
    return lambda model, s: (needed(model, s) + law(s.v, s.a)) / by


def diagnosed(python: str, model: Path, log: Path, out: Path) -> dict:
    """The command in a fresh process, unless its report is there: seconds of CPU, verdict, what it states and lists."""
    place = out / "run.json"
    if place.exists():
        return json.loads(place.read_text())
    command = [python, "-m", "jax_inertia", "diagnose", str(log), "--model", str(model)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    run = subprocess.run([*command, "--out", str(out)], capture_output=True, text=True, check=False)
    seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    if run.returncode or not (out / "report.json").exists():
        return {"failed": (run.stderr.strip().splitlines() or ["no report"])[-1]}
    report = json.loads((out / "report.json").read_text())
    result = {
        "seconds": seconds,
        "verdict": report["verdict"],
        "stated": report["shrink"]["heldout"],
        "effects": [
            f"{e['family']} at {e['location']['name']}"
            for e in report["effects"]
            if not e["ordinary"]
        ],
    }
    place.write_text(json.dumps(result))
    return result


def handed_over(model: Path, out: Path, judged: dict, raw: bool) -> dict:
    """The measure of a report, computed again from its files, in the unit of the judged log."""
    report = json.loads((out / "report.json").read_text())
    told = ReportTorque(model, report, out / "corrected.xml")
    by = np.ones(len(told.joints))
    if raw:
        by = np.array([report["drive_gains"]["value"][name] for name in told.joints])
        logged = [by[told.joints.index(str(name))] for name in judged["joint_names"]]
        judged = judged | {"tau": judged["tau"] * logged}
    error = told.error(judged, held=False)
    if told.left_out:
        return {"handed_over": None, "why": f"not computed: {', '.join(sorted(told.left_out))}"}
    return {"handed_over": error | _in_unit(error, by)}


def _in_unit(error: dict, gains: np.ndarray) -> dict:
    """Rms per joint and of all, divided by what a unit of the log is in N m."""
    names, rows = list(error["per_joint"]), np.array(list(error["rows"].values()))
    each = np.array(list(error["per_joint"].values())) / gains
    whole = float(np.sqrt((each**2 * rows).sum() / max(rows.sum(), 1)))
    return {"rms": whole, "per_joint": dict(zip(names, each.tolist(), strict=True))}


def judge(run: Run, out: Path, python: str) -> dict:
    """A row: every error on the judged run."""
    place = out / run.diagnosis
    place.mkdir(parents=True, exist_ok=True)
    files = CASES[run.case].prepare(place)
    model = mujoco.MjModel.from_xml_path(str(files.model))
    log, judged = run.log(run.seen, files), run.log(run.judged, files)
    np.savez(place / "seen.npz", allow_pickle=False, **log)
    predictors = {
        "nominal": None if run.raw else needed,
        "least_squares": fit(model, log, held=False, free_gain=run.raw),
        "published": published(run.case, run.gains if run.raw else None),
    }
    unit = str(log["tau_unit"]).split()[0] if run.raw else "N m"
    row: dict = {"name": run.name, "title": run.title, "unit": unit}
    for name, predict in predictors.items():
        row[name] = torque_error(model, predict, judged, held=False) if predict else None
    row["tool"] = diagnosed(python, files.model, place / "seen.npz", place / "tool")
    if "failed" not in row["tool"]:
        row["tool"] |= handed_over(files.model, place / "tool", judged, run.raw)
    return row


def main() -> None:
    """Judge what is asked for, a file for each row."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [run.name for run in RUNS]
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="NAME")
    parser.add_argument("--python", default=sys.executable)
    args = parser.parse_args()
    for run in (r for r in RUNS if r.name in args.only):
        file = args.out / f"{run.name}.json"
        if file.exists():
            continue
        if not run.present:
            print(f"{run.name}: skipped, no {SHARED / run.folder}", flush=True)
            continue
        row = judge(run, args.out, args.python)
        file.write_text(json.dumps(row, indent=1) + "\n")
        errors = {k: row[k] and row[k]["rms"] for k in ("nominal", "least_squares", "published")}
        handed = row["tool"].get("handed_over")
        print(run.name, errors, handed and handed["rms"], row["tool"].get("failed", ""), flush=True)


if __name__ == "__main__":
    main()
