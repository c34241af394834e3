"""The page and the figure of speed.py."""

import json
from pathlib import Path

from benchmarks.harness import accuracy, results

GOALS = {
    "regressor of 2 and τ_nom, float32": ("≥ 6", "Pinocchio's regressor and RNEA"),
    "full regressor, float32": ("≥ 1", "Pinocchio's regressor"),
}


def page(found: dict) -> str:
    """The page's part."""
    cpu, gpu = found["cpu"], found["gpu"]
    parts = [
        "## Speed",
        "`python benchmarks/speed.py`: one run, one core, medians, everybody taking turns. Results are stored, "
        "over those of the call before: Pinocchio's stay in its own memory, too.",
    ]
    parts += [_throughput(cpu["throughput"]), _latency(cpu["latency"]), _steps(cpu["filter_step"])]
    parts += [_growth(cpu["growth"]), _mjx(cpu["mjx_step"]), results.sentence(cpu["about"])]
    now, commits = cpu["about"]["commit"], cpu.get("commits", {})
    if before := [f"{name}: {commit}" for name, commit in commits.items() if commit != now]:
        parts += [f"Measured before, at another commit: {', '.join(before)}."]
    parts += [_gpu(gpu), "![Time per sample](figures/speed.png)"]
    if "accuracy" in cpu:
        parts += [
            "## Accuracy of regressors",
            "|Y π + armature · a − (M a + c)| over |M a + c|, root mean squares over joints and 20 random states; "
            "M and c are MuJoCo C's. mujoco-sysid 0.2.1 as its own tests use it. `mujoco.sysid`, which comes with "
            "MuJoCo, is another library and has no regressor: it takes finite differences of whole rollouts.",
            accuracy.page(cpu["accuracy"]),
        ]
    return "\n\n".join(parts)


def _throughput(part: dict) -> str:
    rows = []
    for name, us in part["us_per_sample"].items():
        ratio, compile_s = part["ratios"].get(name), part["compile_s"].get(name)
        goal, against = GOALS.get(name, ("", ""))
        rows.append(
            [
                name,
                f"{us:.2f}",
                "" if compile_s is None else f"{compile_s:.1f}",
                "" if ratio is None else f"{ratio:.2f}",
                goal,
                against,
            ]
        )
    head = [f"humanoid, batch {part['batch']}", "µs a sample", "compile s", "times faster", "goal"]
    return results.table([*head, "than"], rows)


def _latency(part: dict) -> str:
    rows = []
    for name, us in part["us"].items():
        ratio = part["times_pinocchio"].get(name)
        goal = "≤ 2" if name == "regressor of 2, float64" else ""
        rows.append([name, f"{us:.1f}", "" if ratio is None else f"{ratio:.2f}", goal])
    head = ["one call, one sample", "µs", "times Pinocchio's", "goal"]
    return (
        results.table(head, rows)
        + "\n\nWith `jax_cpu_enable_async_dispatch` off, as a control loop should have it: otherwise every call waits "
        "for another thread to wake up, 17 µs on an idle core and some 30 on a busy one."
    )


def _steps(part: dict) -> str:
    rows = []
    for dtype, kinds in part.items():
        for name, row in kinds.items():
            if not isinstance(row, dict):
                continue
            ratio = f"{kinds['autodiff_over_analytic']:.2f}" if "autodiff" in name else ""
            call = f"{row['call_us']:.0f}" if "call_us" in row else ""
            rows.append(
                [
                    f"{name}, {dtype}",
                    f"{row['in_scan_us']:.1f}",
                    call,
                    f"{row['compile_s']:.1f}",
                    ratio,
                ]
            )
    head = ["filter step, 20 states, 29 rows", "µs in a scan", "µs, one call", "compile s"]
    return results.table([*head, "autodiff over analytic (goal ≤ 1.2)"], rows)


def _growth(part: dict) -> str:
    rows = [
        [
            f"chain of {n} bodies",
            f"{row['us_per_sample']:.1f}",
            f"{row['compile_s']:.1f}",
            *(f"{row[k]:.1f}" for k in row if k.startswith("Pinocchio")),
        ]
        for n, row in part["bodies"].items()
    ]
    rows += [[f"humanoid, batch {n}", f"{us:.1f}"] for n, us in part["batch"].items()]
    wide = max(len(r) for r in rows)
    rows = [r + [""] * (wide - len(r)) for r in rows]
    head = ["regressor of 2 and τ_nom, float32", "µs a sample", "compile s"]
    head += ["Pinocchio regressor µs", "Pinocchio RNEA µs"][: wide - 3]
    return (
        results.table(head, rows)
        + f"\n\nExponent of growth: {part['exponent_bodies']:.2f} in bodies (25 to 200), "
        f"{part['exponent_batch']:.2f} in the batch; 1 is linear."
    )


def _mjx(part: dict) -> str:
    return (
        f"One simulation step of the standing humanoid: MJX {part['us_per_step']:.0f} µs (batch {part['batch']}, "
        f"compile {part['compile_s']:.0f} s), MuJoCo C {part['mujoco_c_us_per_step']:.0f} µs."
    )


def _where(row: dict) -> str:
    """Where a row was measured, if not with the others."""
    own = [f"commit {row['commit']}"] if "commit" in row else []
    own += [row["device"]] if "device" in row else []
    return f" ({', '.join(own)})" if own else ""


def _gpu(gpu: dict | None) -> str:
    if not gpu:
        return "Accelerator: not run. Several GPUs: not run."
    rows = []
    for name, row in gpu["rows"].items():
        if "per_s" not in row:
            rows.append([name, row["not run"], *[""] * 5])
            continue
        share = row.get("roofline_share")
        rows.append(
            [
                name + _where(row),
                f"{row['per_s']:.3g}",
                f"{row['compile_s']:.0f}",
                f"{row['bytes_needed_per_step']:.0f}",
                f"{row['operations_per_step_by_xla']:.0f}",
                "" if share is None else f"{share:.1%}",
                f"{row['load_error_kg']:.2g}" if "load_error_kg" in row else "",
            ]
        )
    head = ["float32", "per s", "compile s", "bytes needed", "operations", "share of roofline"]
    head.append("load found, less the true one, kg")
    filter_ = gpu["rows"].get("filter step for the loop's robots", {}).get("per_s")
    tick = gpu["rows"].get("MJX tick alone", {}).get("per_s")
    cost = ""
    if filter_ and tick:
        cost = f"\n\nThe estimator's cost on top of an MJX rollout of the same robots: {tick / filter_:.1%}."
    about = gpu["about"]
    return (
        f"{about['device']}, commit {about['commit']}, jax {about['jax']}, MuJoCo {about['mujoco']}.\n\n"
        f"{results.table(head, rows)}\n\nOperations are XLA's count, which leaves out the kernels' own: some 14 000 "
        "scalar ones for the measurement and its slope, 25 000 for the update (Cholesky, 13 rows of 20 states, L Lᵀ)."
        f"{cost}{several()}"
    )


def several() -> str:
    """What `benchmarks.several_gpus` found; nothing where it has not run."""
    file = results.RESULTS / "several_gpus.json"
    if not file.exists():
        return ""
    found = json.loads(file.read_text())
    one = found["1"]["per_s"]
    told = [
        f"{n}: {row['per_s']:.3g} ({row['per_s'] / int(n) / one:.0%})"
        for n, row in found.items()
        if isinstance(row, dict)
    ]
    note = f" ({found['note']})" if "note" in found else ""
    return (
        f"\n\nFused filter steps per second, split over several {found['device']}, 65 536 robots on "
        f"each: {', '.join(told)}; goal 90 % of as many single ones{note}."
    )


def draw(found: dict, path: Path) -> None:
    """Time per sample against the others, growth in bodies and in batch."""
    import matplotlib.pyplot as plt

    cpu = found["cpu"]
    fig, axes = plt.subplots(
        1, 3, figsize=(12, 3.8), width_ratios=(1.5, 1, 1), layout="constrained"
    )
    times = {k: v for k, v in cpu["throughput"]["us_per_sample"].items() if "sysid" not in k}
    names = list(times)[::-1]
    ours = ["float" in n for n in names]
    colours = ["#1b6ca8" if own else "#9a9a9a" for own in ours]
    bars = axes[0].barh(names, [times[n] for n in names], color=colours)
    axes[0].bar_label(bars, fmt="%.1f", padding=2, fontsize=7)
    axes[0].set_xlabel(f"µs a sample, batch {cpu['throughput']['batch']}, one core")
    axes[0].tick_params(axis="y", labelsize=7)
    growth = cpu["growth"]
    bodies = [int(n) for n in growth["bodies"]]
    rows = list(growth["bodies"].values())
    lines = {
        "us_per_sample": "ours, regressor of 2 and τ_nom",
        "Pinocchio regressor us": "Pinocchio regressor",
    }
    for key, label in lines.items():
        if key in rows[0]:
            axes[1].loglog(bodies, [r[key] for r in rows], "-o", ms=4, label=label)
    first = rows[0]["us_per_sample"]
    axes[1].loglog(bodies, [first * n / bodies[0] for n in bodies], "k:", label="linear")
    axes[1].set_xticks(bodies, [str(n) for n in bodies])
    axes[1].minorticks_off()
    axes[1].set_xlabel("bodies in a chain")
    axes[1].set_ylabel("µs a sample")
    axes[1].legend(fontsize=7)
    batch = [int(n) for n in growth["batch"]]
    axes[2].loglog(
        batch,
        [n * t * 1e-6 for n, t in zip(batch, growth["batch"].values(), strict=True)],
        "-o",
        ms=4,
    )
    axes[2].set_xlabel("batch, humanoid")
    axes[2].set_ylabel("s a call")
    for ax in axes:
        ax.grid(alpha=0.3)
    fig.savefig(path, dpi=120)
    plt.close(fig)
