"""The check on a robot of your own: hidden effects on your model, diagnosed and scored, in ten minutes.

    python -m benchmarks.blind --model my_robot.xml [--n 12] [--seed 1] [--jobs 2] [--out FOLDER] [--fix-base]

Makes logs of robots like the model (`worlds/strata.py`: sound ones, one effect on a good model, robots as they are
bought with and without an odd effect, effects that no library has, logs that mean something else, robots that are told
positions), diagnoses each by the public command in a process that can open nothing else, and writes OUT/RESULTS.md,
rows.json and summary.json; settings.json holds what makes the same logs again. Without --model: the generator's own
robots, quadrupeds and bipeds on their feet among them. A third of the logs with torques are made by Pinocchio where
that is installed. A second call goes on where the first was stopped.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import hashlib
import json
import shutil
from concurrent.futures import ProcessPoolExecutor, as_completed
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown
from rich.progress import track

from benchmarks.blind import adapters, checkout, solve
from benchmarks.exam import marks, page
from benchmarks.worlds import setting, strata
from benchmarks.worlds.own_robot import Unsuitable, own_robot
from benchmarks.worlds.targets import position


def generate(tasks: list[strata.Task], logs: Path, jobs: int) -> list[Path]:
    """The folders of all logs that could be made."""
    logs.mkdir(parents=True, exist_ok=True)
    folders = [logs / f"{k:04d}" for k in range(len(tasks))]
    skipped = []
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        running = {
            pool.submit(strata.write, t, f): (t, f) for t, f in zip(tasks, folders, strict=True)
        }
        for done in track(as_completed(running), "making logs", len(running)):
            task, folder = running[done]
            try:
                done.result()
            except RuntimeError as error:
                skipped.append(f"{folder.name} ({task.stratum} {task.kind}): {error}")
    for line in skipped:
        print(f"left out: {line}")
    return [f for f in folders if (f / "truth.json").exists()]


def pace_like(folders: list[Path], out: Path, jobs: int) -> list[dict]:
    """Rows of the PACE-like fit on the logs of positions without torque."""
    told = [f for f in folders if json.loads((f / "truth.json").read_text())["stratum"] == PACED]
    if not told:
        return []
    adapters.answer_all(told, out / "pace_like", "pace_like", jobs)
    return marks.mark_all(told, out / "pace_like", jobs)


PACED = position.STRATA[0]


def examine(folders: list[Path], out: Path, jobs: int) -> list[dict]:
    """Diagnoses what has no answer yet, and marks all."""
    solve.solve([solve.Task(f, out) for f in folders], out / "work", jobs)
    shutil.rmtree(out / "work", ignore_errors=True)
    return marks.mark_all(folders, out, jobs)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.blind",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--model", type=Path, nargs="+", default=[], help="MJCF or URDF files")
    parser.add_argument("--n", type=int, default=12, help="number of logs")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, default=Path("blind_check"))
    parser.add_argument("--fix-base", action="store_true", help="hold a floating base")
    args = parser.parse_args()
    if args.n < 1 or args.jobs < 1:
        parser.error("--n and --jobs: expected 1 or more")
    for path in args.model:
        try:
            own_robot(path, args.fix_base)
        except Unsuitable as error:
            parser.error(str(error))
    engines = setting.ENGINES if find_spec("pinocchio") else (setting.MUJOCO,)
    settings = {
        "models": {
            str(p.resolve()): hashlib.sha256(p.read_bytes()).hexdigest() for p in args.model
        },
        "fix_base": args.fix_base,
        "seed": args.seed,
        "n": args.n,
        "engines": list(engines),
        "commit": checkout.commit(),
    }
    kept = args.out / "settings.json"
    if kept.exists() and json.loads(kept.read_text()) != settings:
        parser.error(f"{args.out} holds another check ({kept.name}); choose another --out")
    args.out.mkdir(parents=True, exist_ok=True)
    kept.write_text(json.dumps(settings, indent=1))
    tasks = strata.plan(args.seed, args.n, tuple(map(str, args.model)), args.fix_base, engines)
    folders = generate(tasks, args.out / "logs", args.jobs)
    rows = examine(folders, args.out, args.jobs)
    pace = pace_like(folders, args.out, args.jobs)
    (args.out / "rows.json").write_text(json.dumps(rows, indent=1))
    (args.out / "summary.json").write_text(json.dumps(page.summary(rows, pace), indent=1))
    names = ", ".join(p.name for p in args.model) or "the generator's robots"
    about = {"set": f"of your own ({names})", "head": [f"Seed {args.seed}."]}
    text = page.page(about, {"diagnose": rows} | ({page.PACE: pace} if pace else {}))
    (args.out / "RESULTS.md").write_text(text)
    Console().print(Markdown(text))


if __name__ == "__main__":
    main()
