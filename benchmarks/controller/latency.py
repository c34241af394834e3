"""How long one step takes in a control loop: of the library, of its export in C++, and of Pinocchio's regressor.

    python -m benchmarks.controller.latency       # results/controller.json, and the table of docs/live.md; five minutes

Sixty thousand steps each, the loop of C++ at 1 kHz, one after the other on one core. By the clock a step waits for
whatever else the machine does; what the core spent on it is what an idle core takes.
"""

from benchmarks.harness.core import in_this_thread, one_core

if __name__ == "__main__":
    one_core()

import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

import jax_inertia as ji
from benchmarks.controller.build import build, run
from benchmarks.harness import fleet, peers, results
from benchmarks.harness.states import humanoid, states
from jax_inertia.estimation.inertial_filter import Estimator
from jax_inertia.estimation.online.exported_step import Sample, export_step
from jax_inertia.robots.arm import HAND, arm_mjcf

STEPS, PERIOD_US = 60_000, 1000.0
OTHERS = 200
"""Different samples, over and over."""
RESULTS, PAGE = results.RESULTS / "controller.json", results.HERE.parent / "docs/live.md"


def timed(call: Callable[[int], object], steps: int) -> dict[str, list[float]]:
    """Median, 99th percentile and maximum [µs], by the clock and by the core."""
    clock, core = np.zeros(steps), np.zeros(steps)
    for k in range(steps):
        begin, spent = time.perf_counter_ns(), time.process_time_ns()
        call(k)
        core[k] = time.process_time_ns() - spent
        clock[k] = time.perf_counter_ns() - begin
    both = {"clock_us": clock, "core_us": core}
    return {name: [*np.quantile(x / 1e3, [0.5, 0.99, 1.0]).tolist()] for name, x in both.items()}


def arm() -> tuple[Estimator, mujoco.MjModel, Sample]:
    """Seven joints, the hand's ten numbers, all settings as they are by default."""
    model = mujoco.MjModel.from_xml_string(arm_mjcf())
    robot = ji.load_model(model)
    q, v, a = (jnp.asarray(x) for x in states(model, OTHERS, "float64"))
    tau = jax.vmap(lambda *x: ji.inverse_dynamics(robot, *x))(q, v, a)
    tau += 0.1 * jnp.asarray(np.random.default_rng(0).normal(size=tau.shape))
    motion = ji.Motion(jnp.arange(float(OTHERS)), q, v, tau, jnp.ones(tau.shape, bool))
    estimator = ji.make_estimator(robot, [HAND], sigma_tau=0.1)
    return estimator, model, Sample(ji.Observation(motion, a), jnp.full(OTHERS, 1e-3))


def walker() -> tuple[Estimator, mujoco.MjModel, Sample]:
    """A humanoid of 29 rows, the twenty numbers of torso and forearm, one iteration (`harness/fleet.py`)."""
    robot = fleet.humanoid_robot("float64")
    seen = jax.tree.map(jnp.asarray, fleet.observations(robot, OTHERS))
    return fleet.estimator(robot), humanoid(), Sample(seen, jnp.full(OTHERS, 1e-3))


def rows(name: str, made: tuple[Estimator, mujoco.MjModel, Sample], steps: int) -> list[dict]:
    """One for each that is timed."""
    estimator, model, samples = made
    each = [jax.tree.map(lambda x, k=k: x[k], samples) for k in range(OTHERS)]
    state = estimator.initial()
    program = export_step(estimator, each[0].observation)
    like = jax.eval_shape(program.call, state, each[0])[1]
    step = jax.jit(lambda state, sample: estimator.step(state, sample.observation, sample.dt))
    current = [step(state, each[0])[0]]

    def once(k: int) -> None:
        current[0], _ = jax.block_until_ready(step(current[0], each[k % OTHERS]))

    out = [{"robot": name, "what": "`estimator.step` in Python, `jax.jit`", **timed(once, steps)}]
    with tempfile.TemporaryDirectory() as folder:
        loop = build(Path(folder), estimator, each[0].observation)
        found = run(loop, samples, like, period_us=PERIOD_US, steps=steps)
        size = (Path(folder) / "load_filter.o").stat().st_size
    what = "`ji.write_c_step` in C++ at 1 kHz"
    times = {"clock_us": list(found.clock_us), "core_us": list(found.core_us)}
    out.append({"robot": name, "what": what, **times, "object_kb": size / 1e3})
    motion = samples.observation.motion
    q, v, a = (np.asarray(x[:1]) for x in (motion.q, motion.v, samples.observation.a))
    for other, call in peers.pinocchio_runs(model, (q, v, a)).items():
        if "regressor" in other:
            what = f"{other}, all bodies, in Python"
            out.append({"robot": name, "what": what, **timed(lambda _, f=call: f(), steps)})
    return out


def table(found: list[dict]) -> str:
    """For the page."""
    lines = [
        "| robot | step | p50 | p99 | max | p50, core | p99, core | max, core |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for x in found:
        numbers = (f"{v:.3g}" for v in (*x["clock_us"], *x["core_us"]))
        lines.append(f"| {x['robot']} | {x['what']} | {' | '.join(numbers)} |")
    return "\n".join(lines) + "\n"


def main(steps: int = STEPS) -> None:
    """Measure all, and write results and page."""
    in_this_thread()
    jax.config.update("jax_enable_x64", True)
    found = rows("arm, 7 joints", arm(), steps) + rows("humanoid, 29 rows", walker(), steps)
    about = results.circumstances()
    RESULTS.write_text(json.dumps({"about": about, "steps": steps, "rows": found}, indent=1) + "\n")
    results.write_part("controller/latency", table(found), PAGE)
    print(table(found), about)


if __name__ == "__main__":
    main()
