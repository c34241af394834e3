"""Rerun the paper's experiments and write down what came out.

    python -m benchmarks.paper [--seeds N] [--jobs J] [--processes P] [--only NAME ...] [--resume]

Writes `benchmarks/paper/RESULTS.md`, `benchmarks/results/paper.json` and `benchmarks/figures/paper_*.png`, after every
experiment. With `--only` the other experiments keep the numbers of the last run; `--resume` leaves out what has run
with these seeds and this commit, so that a run that was cut off goes on where it was. Experiments that run at a time
share the processes by their cost.
"""

import argparse
import json
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

RESULTS = Path(__file__).parents[1] / "results" / "paper.json"
COST = {"pelvis": 18, "elbow": 11, "curl_causes": 9, "curl": 8, "blind": 6, "gating": 5, "torso": 5}
"""Shares of the processes, the most first: by seconds, and more where one process goes on alone after all tasks."""
NAMES = tuple(COST)
WITH_SWEEP = ("pelvis", "elbow", "curl")


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, write; 0 when all that was asked for ran."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.paper", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="seeds of each experiment (20)")
    parser.add_argument("--sweep-seeds", type=int, default=4, help="seeds of each sweep (4)")
    parser.add_argument("--first-seed", type=int, default=0, help="tuning used 1000 and on (0)")
    parser.add_argument("--jobs", type=int, default=1, help="experiments at a time (1)")
    parser.add_argument("--processes", type=int, default=1, help="of all experiments at a time (1)")
    parser.add_argument("--only", nargs="*", choices=NAMES, default=list(NAMES))
    parser.add_argument("--resume", action="store_true", help="keep what has run with these seeds")
    parser.add_argument("--no-film", action="store_true", help="leave the animated figure out")
    options = parser.parse_args(arguments)
    if min(options.seeds, options.sweep_seeds, options.jobs, options.processes) < 1:
        parser.error("--seeds, --sweep-seeds, --jobs and --processes must be at least 1")
    # One thread each: several experiments at once would fight over the cores.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    found = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    settings = {
        "seeds": options.seeds,
        "sweep_seeds": options.sweep_seeds,
        "first_seed": options.first_seed,
    }
    kept = {name for name in NAMES if options.resume and _has_run(found.get(name, {}), settings)}
    asked = [name for name in NAMES if name in options.only and name not in kept]
    jobs = max(min(options.jobs, len(asked)), 1)
    together = sum(COST[name] for name in asked) if jobs > 1 else 0
    work = [
        (
            name,
            *settings.values(),
            max(options.processes * COST[name] // (together or COST[name]), 1),
        )
        for name in asked
    ]
    # Workers of `multiprocessing.Pool` may have no processes of their own (`shared_out`).
    with ProcessPoolExecutor(jobs, get_context("spawn"), max_tasks_per_child=1) as pool:
        for job in as_completed([pool.submit(_experiment, one) for one in work]):
            name, seconds, result = job.result()
            print(f"{name}: {seconds:.0f} s", file=sys.stderr, flush=True)
            found[name] = {**result, "wall_s": round(seconds), "run": settings}
            _write(found)
    if not options.no_film:
        from benchmarks.paper import film

        film.make()
    return 0


def _has_run(result: dict, settings: dict) -> bool:
    from benchmarks.harness.results import commit

    return result.get("run") == settings and result.get("about", {}).get("commit") == commit()


def _experiment(work: tuple[str, int, int, int, int]) -> tuple[str, float, dict]:
    """One experiment in its own process, which shares its seeds out over some more."""
    name, seeds, sweep, first, processes = work
    os.environ["PAPER_PROCESSES"] = str(processes)
    import jax

    jax.config.update("jax_enable_x64", True)
    import importlib

    import numpy as np

    from benchmarks.harness.results import circumstances

    about = circumstances()
    module = importlib.import_module(f"benchmarks.paper.{name}")
    every, few = first + np.arange(seeds), first + np.arange(min(sweep, seeds))
    started = time.monotonic()
    result = module.results(every, few) if name in WITH_SWEEP else module.results(every)
    return name, time.monotonic() - started, {**result, "about": about}


def _write(found: dict) -> None:
    from benchmarks.paper.report import report

    found = {**found, "unphysical": unphysical(found)}
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(found, indent=1, sort_keys=True, allow_nan=False) + "\n")
    (Path(__file__).parent / "RESULTS.md").write_text(report(found))


def unphysical(found: dict) -> dict[str, int]:
    """Estimates that no body has: of the Kalman filter (Fig. 2), and of every extended filter that ran."""
    kf = found.get("torso", {}).get("kf", {}).get("unphysical", 0)
    ekf = found.get("torso", {}).get("ekf", {}).get("unphysical", 0)
    others = sum(
        found.get(name, {}).get("unphysical", 0) for name in (*WITH_SWEEP, "curl_causes", "blind")
    )
    return {"kf": kf, "ekf": ekf + others}


if __name__ == "__main__":
    sys.exit(main())
