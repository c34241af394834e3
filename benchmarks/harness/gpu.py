"""The accelerator's rows: compiled side by side in threads, then timed one by one, each on its own if it fails."""

import concurrent.futures as futures
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from benchmarks.harness import fleet
from benchmarks.harness.states import BODIES, states
from jax_inertia import condensed_dynamics, torque_regressor
from jax_inertia.maths.fused_update import FusedSquareRoot
from jax_inertia.maths.kalman import Form, Information, SquareRoot
from jax_inertia.robots import HumanoidOptions, humanoid_mjcf

# Memory bandwidth [B/s] and float32 rate [1/s] of the SXM boards, from the maker's data sheets.
BOARDS = {"H100": (3.35e12, 66.9e12), "H200": (4.8e12, 66.9e12)}
TICK_STEPS = 2  # MJX steps to a control tick


@dataclass(frozen=True)
class Ready:
    """A compiled program that maps its first argument to its successor, and what one call counts for."""

    program: Callable
    state: Any
    rest: tuple
    count: int
    """Steps (of single robots) that one call makes."""
    repeats: int
    compile_s: float
    judge: Callable[[Any], dict]
    """What to say of the state after the last call."""


Build = Callable[[], Ready]


def _ready(
    step: Callable,
    state: Any,
    *rest: Any,
    count: int,
    repeats: int = 20,
    judge: Callable = lambda _: {},
) -> Ready:
    start = time.perf_counter()
    program = jax.jit(step).lower(state, *rest).compile()
    return Ready(program, state, rest, count, repeats, time.perf_counter() - start, judge)


def filter_step(robots: int, form: Callable[[Any], Form]) -> Build:
    """One step of so many filters."""

    def build() -> Ready:
        robot = fleet.humanoid_robot("float32")
        filter_ = fleet.estimator(robot, form=form(robot))
        seen = fleet.observations(robot, min(robots, 4096))
        seen = jax.tree.map(lambda x: jnp.resize(x, (robots, *x.shape[1:])), seen)
        begin = jax.tree.map(lambda x: jnp.repeat(x[None], robots, 0), filter_.initial())
        return _ready(
            jax.vmap(lambda s, x: filter_.step(s, x, 1 / fleet.RATE)[0]),
            begin,
            seen,
            count=robots,
            judge=lambda s: {
                "finite": float(jnp.mean(jnp.isfinite(s.belief.mean).all(axis=-1))),
                "load_error_kg": fleet.load_error(filter_, s),
            },
        )

    return build


def regressors(robots: int, which: str) -> Build:
    """Regressor of two bodies and τ_nom, or of all bodies; kept from being dropped by a product with π."""

    def build() -> Ready:
        robot = fleet.humanoid_robot("float32")
        chosen = tuple(robot.body_index(b) for b in BODIES)
        pi = robot.pi[np.array(chosen)]

        def one(carry, x):
            if which == "two":
                y, rest = condensed_dynamics(robot, *x, chosen)
                return carry + 0.0 * (jnp.einsum("vbp,bp->v", y, pi) + rest)
            return carry + 0.0 * jnp.einsum("vbp,bp->v", torque_regressor(robot, *x), robot.pi)

        x = states(_model(), robots, np.float32)
        return _ready(jax.vmap(one), jnp.zeros((robots, robot.nv)), x, count=robots)

    return build


def _model(**options: Any) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(humanoid_mjcf(HumanoidOptions(visual=False, **options)))


def mjx_ticks(robots: int, ticks: int = 10) -> Build:
    """The plant alone: ticks of two MJX steps under no torque."""

    def build() -> Ready:
        model = _model(corner_forces=True)
        ported = mjx.put_model(model)
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_forward(model, data)
        begin = mjx.put_data(model, data)
        many = jax.tree.map(lambda x: jnp.repeat(jnp.asarray(x)[None], robots, 0), begin)

        def one(d):
            return jax.lax.fori_loop(0, TICK_STEPS * ticks, lambda _, d: mjx.step(ported, d), d)

        return _ready(jax.vmap(one), many, count=robots * ticks, repeats=5)

    return build


def closed_loop(robots: int, ticks: int = 30) -> Build:
    """MJX, whole-body control and estimator: the walk of `benchmarks.paper.mjx_loop`."""

    def build() -> Ready:
        from benchmarks.paper.brain import make_brain, spread
        from benchmarks.paper.mjx_loop import PER_TICK, at_home, make_loop
        from benchmarks.paper.pelvis import SETTINGS
        from benchmarks.paper.plant import Sensors
        from benchmarks.paper.strides import begin_at_home, flat, strolling, walk_figures

        model = _model(corner_forces=True)
        brain = make_brain(model, SETTINGS, Sensors(), strolling)
        loop = make_loop(model, brain, PER_TICK)
        plan = begin_at_home(walk_figures(model, flat(), step=0.0, start=0.2), model)
        truth = brain.robot.pi[np.array(brain.estimator.bodies)]
        many = spread((brain.start(plan), at_home(model, loop)), robots)
        return _ready(
            jax.vmap(lambda x: loop.run(*x, truth, ticks)[:2]),
            many,
            count=robots * ticks,
            repeats=2,
            judge=lambda x: {"upright": float(jnp.mean(x[1].qpos[:, 2] > 0.9))},
        )

    return build


def rows(robots: int, loops: int) -> dict[str, Build]:
    """Everything that is timed, in the order of importance."""
    forms: dict[str, Callable[[Any], Form]] = {
        "fused": lambda _: FusedSquareRoot(),
        "information": lambda _: Information(),
        "square root, the default": lambda _: SquareRoot(),
    }
    out: dict[str, Build] = {
        f"filter step, {name}": filter_step(robots, form) for name, form in forms.items()
    }
    out["filter step for the loop's robots"] = filter_step(loops, forms["fused"])
    out["closed loop tick"] = closed_loop(loops)
    out["MJX tick alone"] = mjx_ticks(loops)
    out["regressor of two bodies and τ_nom"] = regressors(robots, "two")
    out["full regressor"] = regressors(robots, "all")
    for n in (1024, 8192):
        out[f"filter step, fused, {n} robots"] = filter_step(n, forms["fused"])
    return out


def roofline(ready: Ready, per_call: float) -> dict:
    """Bytes that must move (arguments and results, once), operations by XLA's count, share of the board's bound."""
    moved = sum(x.nbytes for x in jax.tree.leaves((ready.state, ready.rest)))
    moved += sum(x.nbytes for x in jax.tree.leaves(ready.state))
    cost = ready.program.cost_analysis() or {}
    operations = float(cost.get("flops", 0.0))
    out = {
        "bytes_needed_per_step": moved / ready.count,
        "bytes_accessed_per_step_by_xla": float(cost.get("bytes accessed", 0.0)) / ready.count,
        "operations_per_step_by_xla": operations / ready.count,
    }
    kind = jax.devices()[0].device_kind
    for name, (bandwidth, rate) in BOARDS.items():
        if name in kind:
            out["roofline_share"] = max(moved / bandwidth, operations / rate) / per_call
    return out


def timed(ready: Ready) -> dict:
    """Rate of a chain of calls, each fed with the result of the one before, after one that is not counted."""
    state = jax.block_until_ready(ready.program(ready.state, *ready.rest))
    times = []
    for _ in range(3):
        start = time.perf_counter()
        for _ in range(ready.repeats):
            state = ready.program(state, *ready.rest)
        jax.block_until_ready(state)
        times.append((time.perf_counter() - start) / ready.repeats)
    per_call = float(np.median(times))
    return {
        "per_s": ready.count / per_call,
        "call_ms": 1e3 * per_call,
        "compile_s": ready.compile_s,
        **roofline(ready, per_call),
        **ready.judge(state),
    }


def measure(builds: dict[str, Build], *, limit: float, tell: Callable[[str, dict], None]) -> None:
    """Compile all at once, then time what is ready; what is not within `limit` [s] is told as not run.

    Timing waits for compilers, whose autotuning would disturb it, for two thirds of the limit at most.
    """
    begin = time.monotonic()
    pool = futures.ThreadPoolExecutor(max_workers=6)
    jobs = {name: pool.submit(build) for name, build in builds.items()}
    futures.wait(jobs.values(), timeout=limit * 0.66)
    for name in sorted(jobs, key=lambda n: not jobs[n].done()):
        left = limit - (time.monotonic() - begin)
        try:
            tell(name, timed(jobs[name].result(timeout=max(left, 0.01))))
        except futures.TimeoutError:
            tell(name, {"not run": f"not compiled within {limit:.0f} s"})
        except Exception as error:  # one row's failure is that row's
            tell(name, {"not run": f"{type(error).__name__}: {str(error)[:200]}"})
    pool.shutdown(wait=False, cancel_futures=True)
