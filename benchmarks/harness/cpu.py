"""What is timed on one core. Every part is a function of `quick` and returns plain numbers."""

import time
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from benchmarks.harness import fleet, peers
from benchmarks.harness.clock import Overwriting, compiled, race, seconds, times_faster
from benchmarks.harness.states import BODIES, humanoid, states
from jax_inertia import condensed_dynamics, inverse_dynamics, load_model, torque_regressor
from jax_inertia.estimation.inertial_filter import Estimator
from jax_inertia.model.robot import Robot

BATCH, PEERS = 4096, 512  # samples of ours in one call; of the others in one pass
DTYPES = ("float32", "float64")
TWO, ALL = "regressor of 2 and τ_nom", "full regressor"


def functions(robot: Robot) -> dict[str, Callable]:
    """What one sample asks for."""
    return {
        TWO: lambda q, v, a: condensed_dynamics(robot, q, v, a, BODIES),
        ALL: partial(torque_regressor, robot),
        "RNEA": partial(inverse_dynamics, robot),
    }


def throughput(quick: bool) -> dict:
    """Batch of 4096 on one core, µs a sample, against everybody."""
    batch, rounds = (512, 3) if quick else (BATCH, 15)
    model = humanoid()
    few = tuple(np.asarray(x, float) for x in states(model, min(PEERS, batch)))
    runners: dict[str, Callable] = {}
    count: dict[str, int] = {}
    compile_s: dict[str, float] = {}
    chunks = {TWO: 32, ALL: 8, "RNEA": 64}
    for dtype in DTYPES:
        x = states(model, batch, dtype)
        for name, one in functions(load_model(model).astype(dtype)).items():
            label = f"{name}, {dtype}"
            runners[label] = run = Overwriting(jax.vmap(one), chunks[name], *x)
            compile_s[label] = run.compile_s
            count[label] = batch
    others = peers.pinocchio_runs(model, few)
    others["MuJoCo C mj_inverse"] = peers.mujoco_run(peers.without_contacts(model), few)
    count |= dict.fromkeys(others, len(few[0]))
    sysid = peers.sysid_run(peers.without_contacts(model), tuple(x[:16] for x in few))
    if sysid:
        others["mujoco-sysid regressor"] = sysid
        count["mujoco-sysid regressor"] = 16
    found = race({**runners, **others}, rounds)
    per = {name: times / count[name] for name, times in found.items()}
    ratios = {}
    if "Pinocchio RNEA" in per:
        both = ("Pinocchio regressor", "Pinocchio RNEA")
        for label in runners:
            theirs = {TWO: both, ALL: both[:1], "RNEA": both[1:]}[label.partition(",")[0]]
            ratios[label] = times_faster(per, label, *theirs)
    return {
        "batch": batch,
        "us_per_sample": {name: 1e6 * float(np.median(t)) for name, t in per.items()},
        "compile_s": compile_s,
        "ratios": ratios,
    }


def latency(quick: bool) -> dict:
    """One call for one sample, as a control loop makes it: µs, and how many times Pinocchio's."""
    rounds = 200 if quick else 3000
    model = humanoid()
    sample = tuple(np.asarray(x, float) for x in states(model, 1))
    runners: dict[str, Callable] = {}
    for dtype in DTYPES:
        x = tuple(y[0] for y in states(model, 1, dtype))
        robot = load_model(model).astype(dtype)
        two = lambda q, v, a, r=robot: torque_regressor(r, q, v, a, BODIES)  # noqa: E731
        for name, one in {"regressor of 2": two, TWO: functions(robot)[TWO]}.items():
            runners[f"{name}, {dtype}"] = partial(jax.jit(one), *x)
    others = peers.pinocchio_runs(model, sample)
    found = race({**runners, **others}, rounds)
    slower = {}
    if others:
        for label in runners:
            theirs = list(others) if label.startswith(TWO) else list(others)[:1]
            slower[label] = 1.0 / times_faster(found, label, *theirs)
    medians = {name: 1e6 * float(np.median(t)) for name, t in found.items()}
    return {"us": medians, "times_pinocchio": slower}


def filter_step(quick: bool) -> dict:
    """One step of the estimator inside a scan over a log, and as one call; analytic Jacobian against autodiff."""
    samples, rounds, calls = (333, 3, 50) if quick else (4 * 333, 31, 2000)
    out: dict = {}
    for dtype in DTYPES:
        robot = fleet.humanoid_robot(dtype)
        seen = fleet.observations(robot, samples)
        one = jax.tree.map(lambda x: x[0], seen)
        kinds = {
            "1 iteration": fleet.estimator(robot),
            "1 iteration, autodiff": fleet.estimator(robot, analytic=False),
        }
        if dtype == "float64":  # in float32 several iterations can diverge
            kinds["5 iterations"] = fleet.estimator(robot, iterations=5)
        runners, made = {}, {}
        for name, filter_ in kinds.items():
            begin = filter_.initial()
            program, compile_s = compiled(Estimator.run, filter_, begin, seen)
            runners[name] = partial(program, filter_, begin, seen)
            end = jax.tree.map(lambda x: x[None], runners[name]()[0])
            made[name] = {"compile_s": compile_s, "load_error_kg": fleet.load_error(filter_, end)}
            if name in ("1 iteration", "5 iterations"):
                step, _ = compiled(Estimator.step, filter_, begin, one, 1 / fleet.RATE)
                call = partial(step, filter_, begin, one, 1 / fleet.RATE)
                made[name]["call_us"] = 1e6 * seconds(call, most=calls)
        found = race(runners, rounds)
        for name, times in found.items():
            made[name]["in_scan_us"] = 1e6 * float(np.median(times)) / samples
        out[dtype] = {
            **made,
            "autodiff_over_analytic": times_faster(found, "1 iteration", "1 iteration, autodiff"),
        }
    return out


def chain(bodies: int) -> str:
    """A hanging chain of so many hinged bodies: the deepest tree there is."""
    text = "".join(
        f'<body pos="0 0 -0.1"><inertial pos="0.01 0.02 -0.05" mass="0.5" '
        f'diaginertia="0.002 0.002 0.001"/><joint axis="{i % 2} {(i + 1) % 2} 0.2"/>'
        for i in range(bodies)
    )
    return f"<mujoco><worldbody>{text}{'</body>' * bodies}</worldbody></mujoco>"


def growth(quick: bool) -> dict:
    """µs a sample over bodies (a chain) and over batch (the humanoid), and the exponents of both."""
    sizes = (10, 20) if quick else (25, 50, 100, 200)
    out: dict = {"bodies": {}, "batch": {}}
    for n in sizes:
        model = mujoco.MjModel.from_xml_string(chain(n))
        robot = load_model(model).astype("float32")
        x = states(model, 512, "float32")
        one = partial(condensed_dynamics, robot, bodies=(n // 2, n - 1))
        run = Overwriting(jax.vmap(one), 8, *x)  # as many as a core's cache holds of 200 bodies
        out["bodies"][n] = {
            "us_per_sample": 1e6 * seconds(run, budget=0.5) / 512,
            "compile_s": run.compile_s,
        }
        others = peers.pinocchio_runs(model, tuple(np.asarray(y[:64], float) for y in x))
        for name, theirs in others.items():
            out["bodies"][n][f"{name} us"] = 1e6 * seconds(theirs, budget=0.3) / 64
    model = humanoid()
    one = functions(load_model(model).astype("float32"))[TWO]
    for batch in (64, 512) if quick else (64, 512, 4096, 32768):
        x = states(model, batch, "float32")
        run = Overwriting(jax.vmap(one), 64, *x)
        out["batch"][batch] = 1e6 * seconds(run, budget=0.5) / batch
    times = [v["us_per_sample"] for v in out["bodies"].values()]
    out["exponent_bodies"] = _exponent(list(out["bodies"]), times)
    totals = [b * t for b, t in out["batch"].items()]
    out["exponent_batch"] = _exponent(list(out["batch"]), totals)
    return out


def _exponent(size: list[int], total: list[float]) -> float:
    return float(np.polyfit(np.log(size), np.log(total), 1)[0])


def mjx_step(quick: bool) -> dict:
    """One step of MJX for a batch of humanoids standing on their feet, and one of MuJoCo C."""
    batch = 4 if quick else 64
    model = humanoid()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    ported, one = mjx.put_model(model), mjx.put_data(model, data)
    many = jax.tree.map(lambda x: jnp.repeat(jnp.asarray(x)[None], batch, 0), one)
    program, compile_s = compiled(jax.vmap(lambda d: mjx.step(ported, d)), many)
    begin = time.perf_counter()
    for _ in range(200):
        mujoco.mj_step(model, data)
    in_c = (time.perf_counter() - begin) / 200
    run_s = seconds(partial(program, many), budget=1.0)
    return {
        "batch": batch,
        "us_per_step": 1e6 * run_s / batch,
        "compile_s": compile_s,
        "mujoco_c_us_per_step": 1e6 * in_c,
    }


PARTS = {
    "throughput": throughput,
    "latency": latency,
    "filter_step": filter_step,
    "growth": growth,
    "mjx_step": mjx_step,
}
