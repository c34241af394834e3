"""The analytic Jacobian of the measurement against autodiff: ∂g/∂θ alone, and ∂h/∂θ with h through inverse dynamics.

    python benchmarks/jacobian.py [--most 65536] [--budget 0.5] [--gpu]

g is the paper's π = g(θ) (Foster et al., eq. log-cholesky); h(θ) the torque of the humanoid whose torso and forearm
have the parameters g(θ), so that ∂h/∂θ = Y^est G. Autodiff differentiates that torque itself, forwards (20 tangents)
and backwards (29 cotangents). Writes results/jacobian.json, figures/jacobian.png and a part of README.md; with --gpu
jacobian_gpu.json and jacobian_gpu.png, which the same part of the page shows below.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.harness.core import in_this_thread, one_core

GPU = "--gpu" in sys.argv
if not GPU:
    one_core()

import argparse  # noqa: E402
import itertools  # noqa: E402
import json  # noqa: E402
import os  # noqa: E402
from collections.abc import Callable  # noqa: E402
from concurrent.futures import ThreadPoolExecutor, wait  # noqa: E402

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from benchmarks.harness import results  # noqa: E402
from benchmarks.harness.clock import compiled, seconds  # noqa: E402
from benchmarks.harness.states import BODIES, humanoid, states  # noqa: E402
from jax_inertia import inverse_dynamics, load_model, torque_regressor  # noqa: E402
from jax_inertia.maths import inertial_parameters  # noqa: E402
from jax_inertia.model.robot import Robot  # noqa: E402

BATCHES = (1, 16, 256, 4096, 65536)
FILES = {"cpu": "jacobian", "gpu": "jacobian_gpu"}
SAMPLES = 256  # for the agreement
HOW = ("analytic", "jacfwd", "jacrev")
DTYPES = ("float64", "float32")
Ways = dict[str, Callable]


def of_g() -> Ways:
    """∂g/∂θ of one body (10 × 10)."""
    g = inertial_parameters.from_log_cholesky
    return {
        "analytic": lambda x: inertial_parameters.log_cholesky_jacobian(x[0]),
        "jacfwd": lambda x: jax.jacfwd(g)(x[0]),
        "jacrev": lambda x: jax.jacrev(g)(x[0]),
    }


def of_h(robot: Robot) -> Ways:
    """∂h/∂θ of two bodies (29 × 20)."""
    chosen = tuple(robot.body_index(name) for name in BODIES)

    def h(theta, q, v, a):
        pi = inertial_parameters.from_log_cholesky(theta.reshape(-1, 10))
        return inverse_dynamics(robot.with_pi(chosen, pi), q, v, a)

    def analytic(x):
        theta, q, v, a = x
        y = torque_regressor(robot, q, v, a, chosen)
        slope = inertial_parameters.log_cholesky_jacobian(theta.reshape(-1, 10))
        full = jax.lax.Precision.HIGHEST  # as in the filter
        rows = jnp.einsum("vbp,bpj->vbj", y, slope, precision=full)
        return rows.reshape(robot.nv, -1)

    return {
        "analytic": analytic,
        "jacfwd": lambda x: jax.jacfwd(h)(*x),
        "jacrev": lambda x: jax.jacrev(h)(*x),
    }


def batched(one: Callable, chunk: int) -> Callable:
    """`one` over a batch, in chunks whose intermediate results stay in the cache (or in a GPU's memory)."""
    return lambda *x: jax.lax.map(one, x, batch_size=min(chunk, len(x[0])))


def agreement(
    ways: dict[str, Ways], inputs: dict[str, tuple], pool: ThreadPoolExecutor
) -> dict[str, dict[str, float]]:
    """Largest |J − J*| over largest |J*|, J* the analytic one in float64."""

    def every(dtype: str, how: str) -> np.ndarray:
        one = ways[dtype][how]
        return np.asarray(jax.jit(jax.vmap(lambda *x: one(x)))(*inputs[dtype]), float)

    jobs = {(d, how): pool.submit(every, d, how) for d in DTYPES for how in HOW}
    found = {key: job.result() for key, job in jobs.items()}
    truth = found["float64", "analytic"]
    scale = np.abs(truth).max()
    return {
        d: {how: float(np.abs(found[d, how] - truth).max() / scale) for how in HOW} for d in DTYPES
    }


def measure(most: int, budget: float) -> dict:
    """Agreement and times of everything."""
    in_this_thread()
    jax.config.update("jax_enable_x64", True)
    model = humanoid()
    robot = load_model(model)
    rng = np.random.default_rng(1)
    nominal = inertial_parameters.to_log_cholesky(
        robot.pi[np.array([robot.body_index(b) for b in BODIES])]
    )
    count = max(most, SAMPLES)
    theta = np.asarray(nominal).ravel() + 0.1 * rng.normal(size=(count, 20))
    chunk = 8192 if GPU else 64
    out: dict = {"about": results.circumstances(), "chunk": chunk, "agreement": {}, "runs": []}
    subjects = {
        "g": ({d: of_g() for d in DTYPES}, lambda d: (jnp.asarray(theta[:, :10], d),)),
        "h": (
            {d: of_h(robot.astype(d)) for d in DTYPES},
            lambda d: (jnp.asarray(theta, d), *states(model, count, d)),
        ),
    }
    # A GPU waits for the host's compilers, which share nothing; on the one core that is timed they would share that.
    pool = ThreadPoolExecutor(os.cpu_count() if GPU else 1)
    for subject, (ways, make) in subjects.items():
        inputs = {d: make(d) for d in DTYPES}
        few = {d: tuple(x[:SAMPLES] for x in inputs[d]) for d in DTYPES}
        out["agreement"][subject] = agreement(ways, few, pool)
        batches = [b for b in BATCHES if b <= most]
        jobs = {}
        for dtype, how, batch in itertools.product(DTYPES, HOW, batches):
            args = tuple(x[:batch] for x in inputs[dtype])
            job = pool.submit(compiled, batched(ways[dtype][how], chunk), *args)
            jobs[dtype, how, batch] = job, args
        wait([job for job, _ in jobs.values()])
        for (dtype, how, batch), (job, args) in jobs.items():
            program, compile_s = job.result()
            run_s = seconds(lambda p=program, a=args: p(*a), budget=budget)
            row = {"of": subject, "dtype": dtype, "how": how, "batch": batch}
            out["runs"].append({**row, "compile_s": compile_s, "run_s": run_s})
            print(row, f"compile {compile_s:.2f} s, {run_s / batch * 1e6:.3f} µs", flush=True)
    return out


def page(found: dict, figure: str) -> str:
    """One machine's table; `figure` is the name of its picture."""
    at = {(r["of"], r["dtype"], r["how"], r["batch"]): r for r in found["runs"]}
    batches = sorted({r["batch"] for r in found["runs"]})
    rows = []
    for subject in ("g", "h"):
        for dtype in DTYPES:
            for how in HOW:
                runs = [at.get((subject, dtype, how, b)) for b in batches]
                done = [r for r in runs if r]
                if not done:
                    continue
                cells = [f"{r['run_s'] / r['batch'] * 1e6:.3g}" if r else "–" for r in runs]
                compile_s = np.median([r["compile_s"] for r in done])
                error = found["agreement"].get(subject, {}).get(dtype, {}).get(how)
                told = "–" if error is None else f"{error:.0e}"
                rows.append([f"∂{subject}/∂θ", dtype, how, told, f"{compile_s:.2f}", *cells])
    head = ["", "", "", "error", "compile s", *(f"µs, batch {b}" for b in batches)]
    return "\n\n".join(
        [
            "## Jacobian: analytic against autodiff"
            + (" on a GPU" if figure == FILES["gpu"] else ""),
            "g: one body, 10 × 10. h: torque of the humanoid by two bodies, 29 × 20, autodiff through inverse "
            "dynamics. Error: largest difference from the analytic Jacobian in float64 over its largest entry. "
            "Times per sample, median, one core unless a GPU is named, chunks of "
            f"{found['chunk']}. `python benchmarks/jacobian.py`",
            results.table(head, rows),
            *(["–: not measured, the run was cut off."] if any("–" in r for r in rows) else []),
            results.sentence(found["about"]),
            f"![Time per Jacobian over batch](figures/{figure}.png)",
        ]
    )


def draw(found: dict, path: Path) -> None:
    """Time per sample over batch, and compile time."""
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(
        1, 3, figsize=(11, 3.6), width_ratios=(2, 2, 1.4), layout="constrained"
    )
    colours = dict(zip(HOW, ("#1b6ca8", "#d1701a", "#7a4fa3"), strict=True))
    for ax, subject in zip(axes, ("g", "h"), strict=False):
        for how in HOW:
            for dtype, style in zip(DTYPES, ("-o", "--s"), strict=True):
                runs = [
                    r
                    for r in found["runs"]
                    if (r["of"], r["how"], r["dtype"]) == (subject, how, dtype)
                ]
                ax.loglog(
                    [r["batch"] for r in runs],
                    [r["run_s"] / r["batch"] * 1e6 for r in runs],
                    style,
                    color=colours[how],
                    ms=4,
                    label=f"{how}, {dtype}",
                )
        ax.set_title(f"∂{subject}/∂θ")
        ax.set_xlabel("batch")
        ax.set_ylabel("time per sample [µs]")
        ax.grid(alpha=0.3)
    axes[1].legend(fontsize=7)
    width = 0.25
    for k, how in enumerate(HOW):
        heights = [
            np.median([r["compile_s"] for r in found["runs"] if (r["of"], r["how"]) == (s, how)])
            for s in ("g", "h")
        ]
        axes[2].bar(np.arange(2) + (k - 1) * width, heights, width, color=colours[how], label=how)
    axes[2].set_xticks([0, 1], ["∂g/∂θ", "∂h/∂θ"])
    axes[2].set_ylabel("trace and compile [s]")
    axes[2].legend(fontsize=7)
    path.parent.mkdir(exist_ok=True)
    fig.savefig(path, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--most", type=int, default=BATCHES[-1], help="largest batch")
    parser.add_argument("--budget", type=float, default=0.5, help="seconds for each measurement")
    parser.add_argument("--gpu", action="store_true", help="time the accelerator, not one core")
    args = parser.parse_args()
    found = measure(args.most, args.budget)
    results.save_json(results.RESULTS / f"{FILES['gpu' if GPU else 'cpu']}.json", found)
    publish()


def publish() -> None:
    """Pictures and page of every machine that was measured."""
    parts = []
    for name in FILES.values():
        if (file := results.RESULTS / f"{name}.json").exists():
            found = json.loads(file.read_text())
            draw(found, results.FIGURES / f"{name}.png")
            parts.append(page(found, name))
    results.write_part("jacobian", "\n\n".join(parts))


if __name__ == "__main__":
    main()
