"""What one step of the estimator costs: humanoid, torso and forearm (20 states, 29 rows), one core.

    python benchmarks/filter_step.py [--float32]

Prints a markdown table: compile and run apart, after a warm-up, medians. The paper's budget is 3 ms (333 Hz).
Torques come from MuJoCo C.
"""

import os

os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import platform
import time

import jax
import mujoco
import numpy as np

from jax_inertia import load_model
from jax_inertia.charts import LogCholeskyUUt
from jax_inertia.differences import Observation
from jax_inertia.estimate import Estimator, make_estimator
from jax_inertia.kalman import ChiSquaredGate
from jax_inertia.motion import Motion
from jax_inertia.priors import Load
from jax_inertia.robots import humanoid_mjcf

BODIES = ("torso_link", "left_elbow_pitch_link")
RATE, SECONDS = 333.0, 60.0


def observations(model: mujoco.MjModel, samples: int, dtype) -> Observation:
    """Random smooth states with MuJoCo's own torques, a 5 kg load on the torso unknown to the estimator."""
    rng = np.random.default_rng(0)
    time_ = np.arange(samples) / RATE
    phase = (
        2 * np.pi * (rng.uniform(0.2, 1.5, model.nv) * time_[:, None] + rng.uniform(size=model.nv))
    )
    v, a = np.cos(phase), -np.sin(phase) * 5
    q = np.zeros((samples, model.nq))
    q[:, 3] = 1.0
    q[:, 7:] = 0.3 * np.sin(phase[:, 6:])
    torso = model.body("torso_link").id
    model.body_mass[torso] += 5.0
    data = mujoco.MjData(model)
    full = np.zeros((model.nv, model.nv))
    tau = np.zeros((samples, model.nv))
    for k in range(samples):
        data.qpos[:], data.qvel[:] = q[k], v[k]
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        tau[k] = full @ a[k] + data.qfrc_bias - data.qfrc_passive
    tau += rng.standard_normal(tau.shape)
    motion = Motion(
        time_.astype(dtype),
        q.astype(dtype),
        v.astype(dtype),
        tau.astype(dtype),
        np.ones((samples, model.nv), bool),
    )
    return Observation(motion, a.astype(dtype))


def timed(function, *args, repeats: int) -> np.ndarray:
    jax.block_until_ready(function(*args))
    out = np.empty(repeats)
    for k in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(function(*args))
        out[k] = time.perf_counter() - start
    return out


def compiled(function, *args):
    start = time.perf_counter()
    program = jax.jit(function).lower(*args).compile()
    return program, time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--float32", action="store_true")
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", not args.float32)
    dtype = np.float32 if args.float32 else np.float64
    model = mujoco.MjModel.from_xml_string(humanoid_mjcf())
    robot = load_model(model)
    samples = round(RATE * SECONDS)
    data = observations(model, samples, dtype)
    print(
        f"\n{platform.processor() or platform.machine()}, jax {jax.__version__}, {np.dtype(dtype)}\n"
    )
    print(
        "| | compile s | in a scan µs/step | 60 s log s | one call: median µs | 99th percentile µs |"
    )
    print("|---|---|---|---|---|---|")
    for iterations in (1, 5):
        estimator = make_estimator(
            robot,
            BODIES,
            sigma_tau=1.0,
            prior=Load(5.0, 0.2),
            # A load that may change by 0.1 kg in a second. More, and what iterates climb to is the peak of a
            # distribution so wide in log coordinates that it lies 0.5 kg below the mean.
            drift=Load(0.1, 0.004),
            gate=ChiSquaredGate(0.999, robot.nv),
            reopen_after=0.2,
            iterations=iterations,
            chart=LogCholeskyUUt(),
        )
        state = estimator.initial()
        run, compile_run = compiled(Estimator.run, estimator, state, data)
        scan = timed(run, estimator, state, data, repeats=5)
        one = jax.tree.map(lambda x: x[0], data)
        step, compile_step = compiled(Estimator.step, estimator, state, one, 1 / RATE)
        calls = timed(step, estimator, state, one, 1 / RATE, repeats=3000)
        _, trace = run(estimator, state, data)
        half = slice(samples // 2, None)
        nominal = float(robot.pi[robot.body_index(BODIES[0]), 0])
        error = float(np.mean(trace.estimate.pi[half, 0, 0])) - nominal - 5
        sigma = float(np.mean(trace.estimate.sigma_pi[half, 0, 0]))
        print(
            f"| {iterations} iteration(s) | {compile_run:.1f} / {compile_step:.1f} "
            f"| {np.median(scan) / samples * 1e6:.1f} | {np.median(scan):.2f} "
            f"| {np.median(calls) * 1e6:.0f} | {np.percentile(calls, 99) * 1e6:.0f} |"
            f"  <!-- load found to {error:+.3f} ± {sigma:.3f} kg -->"
        )


if __name__ == "__main__":
    main()
