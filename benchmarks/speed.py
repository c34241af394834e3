"""Speed in one table: ours against Pinocchio, mujoco-sysid, MuJoCo C and MJX; compile and run apart.

    python benchmarks/speed.py                     # one core of this machine: results/speed.json, README.md, figure
    python benchmarks/speed.py --gpu --out DIR     # an accelerator's rows, in float32: DIR/speed_gpu.json
    python benchmarks/speed.py --parts latency ... # these parts alone, the others as in results/speed.json
    python benchmarks/speed.py --page              # the page again, from results/speed.json and results/speed_gpu.json

Whoever is compared takes turns, and a ratio is the median over the rounds: what slows the machine down slows all.
Pinocchio is taken from its wheel (`pip install ".[test]"`); mujoco-sysid is a peer, not a dependency
(`pip install --no-deps --target scratch mujoco-sysid==0.2.1`, then PYTHONPATH=scratch). What is absent is "not run".
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.harness.core import in_this_thread, one_core

GPU = "--gpu" in sys.argv
if not GPU:
    one_core()

import argparse  # noqa: E402
import json  # noqa: E402
import os  # noqa: E402

import jax  # noqa: E402

from benchmarks.harness import results  # noqa: E402

GPU_FILE = "speed_gpu.json"


def on_one_core(quick: bool, parts: list[str], saved: Path) -> dict:
    """The measurements on the CPU; those not among `parts` as they were saved, with the commit that they are of."""
    from benchmarks.harness import accuracy, cpu

    in_this_thread()
    jax.config.update("jax_enable_x64", True)
    every = {**cpu.PARTS, "accuracy": lambda _: accuracy.errors()}
    if unknown := set(parts) - set(every):
        raise SystemExit(f"no part {sorted(unknown)}; there are: {', '.join(every)}")
    earlier = json.loads(saved.read_text())["cpu"] if parts and saved.exists() else {}
    now = results.circumstances()
    commits = {
        **earlier.get("commits", dict.fromkeys(every, earlier.get("about", {}).get("commit")))
    }
    found: dict = {**earlier, "about": now, "commits": commits}
    for name, part in every.items():
        if name in (parts or every) and not (quick and name == "accuracy"):
            found[name], commits[name] = part(quick), now["commit"]
            print(name, json.dumps(found[name], indent=1), flush=True)
    return found


def on_accelerator(out: Path, robots: int, loops: int, limit: float) -> None:
    """All measurements on the accelerator, written as they come."""
    from benchmarks.harness import gpu

    found: dict = {"about": results.circumstances(), "rows": {}}

    def tell(name: str, row: dict) -> None:
        found["rows"][name] = row
        print(json.dumps({name: row}), flush=True)
        results.save_json(out / GPU_FILE, found)

    gpu.measure(gpu.rows(robots, loops), limit=limit, tell=tell)


def keys(cpu: dict, gpu: dict) -> dict:
    """The figures that are looked up by name, null where not run, and everything else below them."""
    rows = gpu.get("rows", {})
    steps = {n: r for n, r in rows.items() if n.startswith("filter step, ") and "per_s" in r}
    # What has lost the load is no filter, however fast.
    steps = {n: r for n, r in steps.items() if abs(r["load_error_kg"]) < 0.3}
    best = max(steps.values(), key=lambda r: r["per_s"], default={})
    ratios = cpu["throughput"]["ratios"]
    return {
        "regressor2_vs_pinocchio": ratios.get("regressor of 2 and τ_nom, float32"),
        "regressor_full_vs_pinocchio": ratios.get("full regressor, float32"),
        "gpu_filter_steps_per_s": best.get("per_s"),
        "gpu_closed_loop_ticks_per_s": rows.get("closed loop tick", {}).get("per_s"),
        "gpu_roofline_share": best.get("roofline_share"),
        "cpu": cpu,
        "gpu": gpu or None,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gpu", action="store_true", help="time the accelerator, not one core")
    parser.add_argument("--page", action="store_true", help="measure nothing, write the page again")
    parser.add_argument("--quick", action="store_true", help="small sizes, to see that it runs")
    parser.add_argument("--parts", nargs="+", default=[], help="measure these parts alone")
    parser.add_argument("--out", type=Path, default=results.RESULTS)
    parser.add_argument("--robots", type=int, default=65536, help="filters on the accelerator")
    parser.add_argument("--loops", type=int, default=4096, help="closed loops on the accelerator")
    parser.add_argument("--limit", type=float, default=130.0, help="seconds for the accelerator")
    args = parser.parse_args()
    if args.gpu:
        on_accelerator(args.out, args.robots, args.loops, args.limit)
        sys.stdout.flush()
        os._exit(0)  # compilers that are still at work in their threads would hold the process
    saved = args.out / "speed.json"
    cpu = (
        json.loads(saved.read_text())["cpu"]
        if args.page
        else on_one_core(args.quick, args.parts, saved)
    )
    from_gpu = args.out / GPU_FILE
    gpu = json.loads(from_gpu.read_text()) if from_gpu.exists() else {}
    everything = keys(cpu, gpu)
    results.save_json(saved, everything)
    if args.quick:
        return
    from benchmarks.harness import speed_page

    speed_page.draw(everything, results.FIGURES / "speed.png")
    results.write_part("speed", speed_page.page(everything))


if __name__ == "__main__":
    main()
