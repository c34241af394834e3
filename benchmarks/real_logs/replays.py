"""Real robots that are told positions: nominal model, PACE-like fit and the diagnosis, on motions that neither saw.

    python -m benchmarks.real_logs.replays SHARED_DATA OUT.json [so101|go2|xl330 ...]

The diagnosis chooses by stretches of what it is given and never sees a motion of the tables; "ours" is the file that it
hands over, by `exam/replayed.py`.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import json
import resource
import sys
from pathlib import Path

import mujoco
import numpy as np

import jax_inertia as ji
from benchmarks.exam.pace_like import PaceLike, errors
from benchmarks.exam.replayed import replayed
from jax_inertia.replay import pipeline
from jax_inertia.replay.loop import position_loop
from jax_inertia.replay.output import report
from jax_inertia.replay.record import record_of
from jax_inertia.replay.simulation.spec_edits import with_loop

# Of the XL330 (data sheet: P / 128 counts of PWM a count of error, 885 counts are all of the supply; published: kt, R).
_COUNTS, _DUTY, _KT, _R = 4096 / (2 * np.pi), 885.0, 0.3867, 4.017


def main() -> None:
    """Of the command line."""
    data, out = Path(sys.argv[1]), Path(sys.argv[2])
    robots = {"so101": so101, "go2": go2, "xl330": xl330}
    result = {}
    for name in sys.argv[3:] or robots:
        result[name] = compared(*robots[name](data))
        out.write_text(json.dumps(result, indent=1))
        print(name, *table(result[name]), sep="\n", flush=True)


def so101(data: Path):
    """A hobby arm: three motions fitted, nine others."""
    folder = data / "so101_sage"
    fitted = ("multisine", "random_waypoints", "pick_place")
    logs = {p.stem: ji.read_log(p) for p in sorted(folder.glob("*.npz"))}
    tests = {k: v for k, v in logs.items() if k not in fitted}
    return folder / "model_nominal.xml", [logs[k] for k in fitted], tests, 20.0, 0.08


def go2(data: Path):
    """A quadruped in the air: the first 8 s fitted, the rest."""
    folder = data / "go2_suspended"
    log = ji.read_log(folder / "train.npz")
    start = float(log.time[0])
    parts = log.between(start, start + 8.0), log.between(start + 8.0, float(log.time[-1]))
    return folder / "model_nominal.xml", [parts[0]], {"rest": parts[1]}, 8.0, 1.0


def xl330(data: Path):
    """A servo on a pendulum: P gains 100, 200, 800 fitted, 400 not."""
    folder = data / "bam_xl330"
    motions = ("sin_sin", "up_and_down", "sin_time_square")
    logs = {
        p.stem: servo(p) for p in sorted(folder.glob("*.npz")) if any(m in p.stem for m in motions)
    }
    fitted = [v for k, v in logs.items() if "kp400" not in k]
    return (
        folder / "model_nominal.xml",
        fitted,
        {k[8:]: v for k, v in logs.items() if "kp400" in k},
        8.0,
        1.0,
    )


def servo(path: Path) -> ji.Log:
    """The log of one run with kp in N m/rad."""
    z = np.load(path)
    volts = float(np.median(z["input_volts"]))
    p = float(np.ravel(z["kp"])[0])
    kp = p / 128 * _COUNTS / _DUTY * volts * _KT / _R
    joints = tuple(str(x) for x in z["joint_names"])
    return ji.Log(
        time=z["time"], joint_names=joints, qpos=z["qpos"], qpos_target=np.reshape(z["q_goal"], (-1, 1)),
        kp=np.array([kp]), kd=np.array([_KT**2 / _R]),
    )  # fmt: skip


def compared(model: Path, logs, tests, seconds: float, start_kp: float) -> dict:
    """Errors of each test motion and joint, and what was found."""

    def spec():
        return mujoco.MjSpec.from_file(str(model))

    cpu = _cpu()
    found = pipeline.diagnose(
        logs, spec, progress=lambda text: print(round(_cpu() - cpu), text, flush=True)
    )
    spent = _cpu() - cpu
    names, loop = found.names, found.loop
    # Both models as files, replayed by a program of its own.
    given = spec()
    if loop.source != "model":
        with_loop(given, names, loop)
    given.compile()
    files = {"nominal": given.to_xml(), "ours": found.text}
    runs = {k: record_of(v, position_loop(v, spec().compile())) for k, v in tests.items()}
    cpu = _cpu()
    fits = [record_of(v, loop) for v in logs]
    fits = [r.between(0, int(np.searchsorted(r.time, seconds))) for r in fits]
    pace = PaceLike(spec(), names, loop.kp, loop.kd, start_kp=start_kp, limit=loop.limit)
    ratios = [position_loop(v, spec().compile()).kp / loop.kp for v in logs]
    numbers = pace.fit([(r.time, r.q, r.target) for r in fits], ratios)
    out = {"cpu": spent, "pace_cpu": _cpu() - cpu, "joints": list(names), "motions": {}}
    for name, r in runs.items():
        run = r.time, r.q, r.target
        ratio = r.loop.kp / loop.kp
        paths = {k: replayed(text, names, *run, ratio) for k, text in files.items()}
        paths["pace"] = pace.replay(numbers, run, ratio)
        out["motions"][name] = {k: errors(path, run).tolist() for k, path in paths.items()}
    keep = report.to_report(found)
    out |= {k: keep[k] for k in ("verdict", "headline", "effects", "notes", "joints", "all_joints", "doubts")} | {
        "gate": keep["shrink"]["replay"], "joints": list(names), "numbers": keep["joints"],
    }  # fmt: skip
    return report.clean(out)


def table(x: dict) -> list[str]:
    """Rows of mrad, joints side by side."""
    cells = []
    for name, r in x["motions"].items():
        rows = [" / ".join(f"{1e3 * v:.1f}" for v in r[k]) for k in ("nominal", "pace", "ours")]
        cells.append(f"| {name} | " + " | ".join(rows) + " |")
    ours, pace = (np.array([r[k] for r in x["motions"].values()]) for k in ("ours", "pace"))
    cells.append(
        f"ours ≤ PACE-like: {(ours <= 1.005 * pace).sum()} of {ours.size}; CPU {x['cpu']:.0f} s"
    )
    for e in x["effects"]:
        sizes = ", ".join(
            f"{k} {v['value']:.4g} [{v['ci95'][0]:.3g}, {v['ci95'][1]:.3g}]"
            for k, v in e["parameters"].items()
        )
        cells.append(f"{e['family']} {e['location']['name']}: {sizes}, share {e['share']:.3f}")
    return cells


def _cpu() -> float:
    use = resource.getrusage(resource.RUSAGE_SELF)
    return use.ru_utime + use.ru_stime


if __name__ == "__main__":
    main()
