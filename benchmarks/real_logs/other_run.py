"""Real robots: the torque error of another run, of the model as given, of plain least squares and of a diagnosis.

    python benchmarks/real_logs/other_run.py OUT [--only NAME ...] [--tool] [--prototype PATH] [--python PYTHON]

Each robot is fitted on one run (or the first part of its only one) and judged on another (or the rest), by the measure
of `benchmarks/gap/torque_error.py`: rows in which a joint moves, 10 Hz. `--tool` runs `jax-inertia diagnose` with its
defaults in a fresh process and computes its report again (`report_torque.py`); what the report itself states of the
other run stands beside it. `--prototype` runs a script MODEL LOG OTHER that prints its own errors as `a -> b -> c N m`.
Currents and voltages become torques by published gains; in the cases named `_raw` they stay what they are, and least
squares gets a gain a joint. Writes OTHER_RUN.md and other_run.json into OUT. The logs are looked for in
../shared/data beside the repository, or in $JAX_INERTIA_DATA; what is absent is skipped.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import re
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "gap"))

import cases
from baseline_least_squares import fit
from logs import SHARED
from report_torque import ReportTorque
from torque_error import Predictor, needed, read, torque_error

CASES = {case.name: case for case in cases.CASES}
UR10E, DFKI = "ur10e_dynamic_calibration", "dfki_double_pendulum"


@dataclass(frozen=True)
class Run:
    """One robot: its nominal model, the run that is fitted and the run that is judged."""

    name: str
    title: str
    folder: str
    case: str
    """The case whose model this is."""
    log: str = ""
    other: str = ""
    """Runs of the folder; where empty, the case's own."""
    split: float = 0.0
    """Share of `log` that is fitted, the rest being judged."""
    gains: np.ndarray | None = None
    """N m for each unit logged; None leaves the log as it is."""
    kind: str = ""
    """Where the torque comes from; empty leaves what the log says."""
    raw: bool = False
    held: bool = False
    """Torques are commands that hold until the next row."""

    @property
    def present(self) -> bool:
        return (SHARED / self.folder).is_dir()

    def prepare(self, out: Path) -> tuple[Path, Path, Path]:
        """model.xml, log.npz and other.npz in `out`."""
        files = CASES[self.case].prepare(out)
        assert files.test is not None
        paths = [files.log, files.test]
        if self.log:
            paths = [SHARED / self.folder / f"{x}.npz" for x in (self.log, self.other or self.log)]
        logs = [read(p) for p in paths]
        if self.split:
            cut = np.searchsorted(logs[0]["time"], self.split * logs[0]["time"][-1])
            logs = [_rows(logs[0], slice(0, cut)), _rows(logs[0], slice(cut, None))]
        for log, name in zip(logs, ("log", "other"), strict=True):
            keep = ("time", "joint_names", "qpos", "qvel", "tau", "tau_unit", "tau_kind")
            log = {k: x for k, x in log.items() if k in keep}
            if self.gains is not None:
                log["tau"], log["tau_unit"] = log["tau"] * self.gains, np.array("N m")
            if self.kind:
                log["tau_kind"] = np.array(self.kind)
            np.savez(out / f"{name}.npz", allow_pickle=False, **log)
        return files.model, out / "log.npz", out / "other.npz"


def _rows(log: dict[str, np.ndarray], rows: slice) -> dict[str, np.ndarray]:
    count = len(log["time"])
    return {k: x[rows] if x.ndim and len(x) == count else x for k, x in log.items()}


_GAINS = CASES["ur10e"].gains
RUNS = (
    Run("panda", "Panda, last 30 % of its run", "panda_gaz2019", "panda"),
    Run("lwr4", "LWR4+, train_1 → test_3", "kuka_lwr4_flobaroid", "lwr4"),
    Run("lwr4_repeat", "LWR4+, train_2 → test_3", "kuka_lwr4_flobaroid", "lwr4_repeat"),
    Run(
        "ur10e",
        "UR10e, free_1 → free_2, published gains",
        UR10E,
        "ur10e",
        gains=_GAINS,
        kind="current",
    ),
    Run("ur10e_raw", "UR10e, free_1 → free_2, amperes", UR10E, "ur10e", raw=True),
    Run(
        "ur10e_payload",
        "UR10e with 2.8 kg, first 60 % → rest",
        UR10E,
        "ur10e",
        "dev_pair_payload",
        split=0.6,
        gains=_GAINS,
        kind="current",
    ),
    Run(
        "ur10e_no_load",
        "the same motion without it",
        UR10E,
        "ur10e",
        "dev_pair_free",
        split=0.6,
        gains=_GAINS,
        kind="current",
    ),
    Run("double_pendulum", "double pendulum C1, train_00 → test_08", DFKI, "double_pendulum"),
    Run(
        "xl330",
        "XL330, sin_time_square → sin_sin, published k/R",
        "bam_xl330",
        "xl330",
        gains=CASES["xl330"].gains,
    ),
    Run("xl330_raw", "XL330, the same in volts", "bam_xl330", "xl330", raw=True),
)


def published(case: str) -> Predictor | None:
    """The published fit beside the nominal bodies."""
    law = CASES[case].law
    if law is None:
        return None
    return lambda model, s: needed(model, s) + law(s.v, s.a)


def tool(python: str, model: Path, log: Path, other: Path, out: Path) -> dict:
    """The command in a fresh process: seconds, verdict, what it states, and the measure of its report."""
    command = [python, "-m", "jax_inertia", "diagnose", str(log), "--model", str(model)]
    command += ["--test-log", str(other), "--out", str(out)]
    begun = time.perf_counter()
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    result: dict = {"seconds": time.perf_counter() - begun}
    if run.returncode or not (out / "report.json").exists():
        return result | {"failed": (run.stderr.strip().splitlines() or ["no report"])[-1]}
    report = json.loads((out / "report.json").read_text())
    result["verdict"] = report["verdict"]
    result["stated"] = (report.get("shrink") or {}).get("test_log")
    result["effects"] = [f"{e['family']} at {e['location']['name']}" for e in report["effects"]]
    return result


def measured(model: Path, out: Path, other: dict, held: bool) -> dict:
    """The measure of a report, computed again from its files."""
    report = json.loads((out / "report.json").read_text())
    try:
        told = ReportTorque(model, report, out / "corrected.xml")
        error = told.error(other, held)
    except (KeyError, ValueError) as reason:
        return {"measured": None, "why": str(reason)}
    if told.left_out:
        return {"measured": None, "why": f"not computed here: {', '.join(sorted(told.left_out))}"}
    return {"measured": error}


def prototype(python: str, script: Path, model: Path, log: Path, other: Path) -> dict:
    """What a script prints as `before -> ordinary -> after N m`, in its own measure."""
    command = [python, str(script), str(model), str(log), str(other)]
    begun = time.perf_counter()
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    found = re.search(r"([\d.]+) -> ([\d.]+) \(ordinary\) -> ([\d.]+) N m", run.stdout)
    if not found:
        return {"failed": (run.stderr.strip().splitlines() or ["no numbers"])[-1]}
    numbers = dict(zip(("before", "ordinary", "after"), map(float, found.groups()), strict=True))
    return numbers | {"seconds": time.perf_counter() - begun}


def judge(run: Run, out: Path, args: argparse.Namespace) -> dict:
    out.mkdir(parents=True, exist_ok=True)
    path, log, other = run.prepare(out)
    model = mujoco.MjModel.from_xml_path(str(path))
    rows, test = read(log), read(other)
    row: dict = {"name": run.name, "title": run.title, "unit": "raw" if run.raw else "N m"}
    fitted = fit(model, rows, run.held, run.raw)
    predictors: dict[str, Callable | None] = {
        "nominal": None if run.raw else needed,
        "least_squares": fitted,
        "published": None if run.raw else published(run.case),
    }
    for name, predict in predictors.items():
        row[name] = torque_error(model, predict, test, run.held) if predict else None
    if args.prototype and not run.raw:
        row["prototype"] = prototype(args.python, args.prototype, path, log, other)
    if args.tool:
        row["tool"] = tool(args.python, path, log, other, out / "tool")
        if "failed" not in row["tool"] and not run.raw:
            row["tool"] |= measured(path, out / "tool", test, run.held)
    return row


def table(rows: list[dict]) -> str:
    """Markdown; N m over all joints' moving rows of the other run."""
    heads = ["run", "as given", "least squares", "published", "tool, computed again"]
    heads += ["tool, as stated", "prototype, as stated", "verdict", "s"]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for r in rows:
        told, proto = r.get("tool", {}), r.get("prototype", {})
        stated, again = told.get("stated") or {}, told.get("measured")
        cells = [
            r["title"] + (" (raw unit)" if r["unit"] == "raw" else ""),
            *(_number(r[k] and r[k]["rms"]) for k in ("nominal", "least_squares", "published")),
            _number(again and again["rms"]),
            _arrow(stated, ("before", "after")),
            _arrow(proto, ("before", "ordinary", "after")),
            told.get("verdict") or told.get("failed", "–")[:80],
            _number(told.get("seconds")),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _number(x: float | None) -> str:
    return "–" if x is None else f"{x:.3g}"


def _arrow(numbers: dict, names: tuple[str, ...]) -> str:
    found = [numbers.get(n) for n in names]
    return " → ".join(map(_number, found)) if any(x is not None for x in found) else "–"


def main() -> None:
    """Judge what is asked for and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [run.name for run in RUNS]
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="NAME")
    parser.add_argument("--tool", action="store_true")
    parser.add_argument("--prototype", type=Path)
    parser.add_argument("--python", default=sys.executable)
    args = parser.parse_args()
    rows = []
    for run in RUNS:
        if run.name not in args.only:
            continue
        if not run.present:
            print(f"{run.name}: skipped, no {SHARED / run.folder}", flush=True)
            continue
        rows.append(judge(run, args.out / run.name, args))
        print(table(rows[-1:]).splitlines()[-1], flush=True)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "other_run.json").write_text(json.dumps(rows, indent=1) + "\n")
    (args.out / "OTHER_RUN.md").write_text(table(rows))
    print("\n" + table(rows))


if __name__ == "__main__":
    main()
