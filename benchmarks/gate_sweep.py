"""Which innovation threshold γ, and does its χ² reading hold? Humanoids step in place in MJX; the torso is weighed.

    python benchmarks/gate_sweep.py [--rollouts 24] [--seed 0]     # more rollouts on a GPU

Loads, sensor noise, contact hardness and gait are drawn anew for every rollout (benchmarks/harness/stepping.py); at 5 s
the load changes by 3 to 12 kg. One filter (10 states, 29 rows, two iterations) then runs over every log with every γ
(from χ² probabilities, raw values, none), with and without reopening after 0.1 s of nothing but rejections, told
each robot's own noise or the nominal one: one compile, rollouts and thresholds by `vmap`. Writes
results/gate_sweep.json, figures/gate_sweep.png and a part of README.md.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.harness.core import quiet_blas

quiet_blas()

import argparse  # noqa: E402
import time  # noqa: E402

import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import scipy.stats  # noqa: E402
from jaxtyping import Float  # noqa: E402

from benchmarks.harness import gate_page, results, stepping  # noqa: E402
from benchmarks.paper.brain import FEET, foot_wrenches, measurement_noise, with_accelerations  # noqa: E402
from benchmarks.paper.plant import Sensors  # noqa: E402
from jax_inertia import load_model  # noqa: E402
from jax_inertia.estimation.inertial_filter import Estimator, make_estimator  # noqa: E402
from jax_inertia.estimation.priors import Load, Tolerance  # noqa: E402
from jax_inertia.maths.charts import LogCholeskyUUt  # noqa: E402
from jax_inertia.maths.gates import FixedGate  # noqa: E402
from jax_inertia.maths.noise import IndependentNoise  # noqa: E402
from jax_inertia.model.robot import Robot  # noqa: E402
from jax_inertia.signals.differences import Observation  # noqa: E402
from jax_inertia.signals.generalised_motion import Motion  # noqa: E402
from jax_inertia.signals.torque_residual import torque_residuals  # noqa: E402

ROWS = 29
# Probabilities of keeping a good measurement, then raw thresholds, then no gate.
PROBABILITIES = (0.9, 0.99, 0.999, 1 - 1e-6)
RAW = (10.0, 100.0, 300.0, 1000.0, np.inf)
GAMMAS = (*scipy.stats.chi2.ppf(PROBABILITIES, ROWS), *RAW)
NAMES = (*(f"χ² {p:.6g}" for p in PROBABILITIES), "10", "100", "300", "1000", "none")
REOPEN, TOLD = (np.inf, 0.1), ("own", "nominal")
SENSORS = Sensors(window=9, sampled_forces=True)
SCORED_FROM = 2.0  # s
Noisy = dict[str, np.ndarray]


def rollouts(count: int, seed: int) -> tuple[Noisy, stepping.Draw, float]:
    """Logs as the sensors have them, who they are of, and the tick [s]."""
    model = stepping.robot_model()
    plant = stepping.plant(model)
    data = stepping.home_data(model, plant)
    who = stepping.draw(count, seed)
    tick = stepping.STEPS * model.opt.timestep
    ticks = round(stepping.DURATION / tick)
    run = jax.jit(jax.vmap(lambda w: stepping.roll(plant, data, w, ticks, tick)))
    clean = run(who)
    rows = [
        sensed(jax.tree.map(lambda x, k=k: np.asarray(x[k], float), clean), tick, rng, scale)
        for k, scale in enumerate(np.asarray(who.noise, float))
        for rng in [np.random.default_rng([seed, k, 1])]
    ]
    return {name: np.stack([r[name] for r in rows]) for name in rows[0]}, who, tick


def sensed(one: stepping.Record, tick: float, rng: np.random.Generator, scale: float) -> Noisy:
    """One log with noise: means of nine samples, velocities differenced between two."""
    window, ticks = SENSORS.window, len(one.q)
    mean = scale / np.sqrt(window)
    q, v, tau = one.q.copy(), one.v.copy(), np.zeros_like(one.v)
    q[:, :3] += mean * SENSORS.base_position * rng.normal(size=(ticks, 3))
    q[:, 4:7] += 0.5 * mean * SENSORS.base_orientation * rng.normal(size=(ticks, 3))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    q[:, 7:] += mean * SENSORS.joint_position * rng.normal(size=q[:, 7:].shape)
    ends = one.v_end + scale * SENSORS.velocity() * rng.normal(size=v.shape)
    v += mean * SENSORS.velocity() * rng.normal(size=v.shape)
    tau[:, 6:] = one.tau + mean * SENSORS.torque * rng.normal(size=one.tau.shape)
    force = one.force + scale * SENSORS.corner_force * rng.normal(size=one.force.shape)
    a = np.diff(ends, axis=0) / tick
    out = {"q": q, "v": v, "tau": tau, "force": force, "harness": one.harness}
    return {"a": a, **{name: x[1:] for name, x in out.items()}}


def filter_of(robot: Robot) -> Estimator:
    """The filter of benchmarks/paper/gating.py; rows come whitened, so its noise is one."""
    return make_estimator(
        robot,
        (stepping.TORSO,),
        sigma_tau=1.0,
        prior=Load(8.0, 0.2),
        drift=Tolerance(mass=0.1, com=0.01, spread=0.02),
        chart=LogCholeskyUUt(),
        noise=IndependentNoise(jnp.ones(robot.nv)),
        iterations=2,
        paper=True,
    )


def sweep(robot: Robot, logs: Noisy, scale: np.ndarray, tick: float) -> Noisy:
    """Mass, NIS and acceptance of every rollout × noise told × reopening × γ × tick: one compile."""
    filter_ = filter_of(robot)
    q0 = np.asarray(logs["q"][0, 0])
    noise = measurement_noise(robot, q0, SENSORS, (0.0,) * 4)
    noise = with_accelerations(noise, robot, q0, SENSORS)
    root = jnp.linalg.inv(jnp.linalg.cholesky(noise.covariance))
    valid = jnp.ones(robot.nv, bool)

    def one(log: Noisy, told: Float[jax.Array, ""], reopen, gamma):
        regressors, residuals = log["y"] / told, log["residual"] / told
        at = lambda f: (f.gate, f.reopening.after)  # noqa: E731
        own = eqx.tree_at(at, filter_, (FixedGate(gamma), reopen))

        def step(state, x):
            state, made = own.update(state, *x, valid, tick)
            seen = made.innovation
            return state, (own.chart.to_pi(state.belief.mean)[0], seen.nis, seen.accepted)

        return jax.lax.scan(step, own.initial(), (regressors, residuals))[1]

    def of_log(log: Noisy, told):
        wrench = jax.vmap(lambda q, f: foot_wrenches(robot, q, f))(log["q"], log["force"])
        wrench = jnp.concatenate([wrench, log["harness"][:, None]], axis=1)
        ticks = len(log["q"])
        motion = Motion(
            time=jnp.arange(ticks) * tick,
            q=log["q"],
            v=log["v"],
            tau=log["tau"],
            valid=jnp.ones((ticks, robot.nv), bool),
            wrench=wrench,
            contact_bodies=(*FEET, stepping.PELVIS),
            quaternions=(3,),
        )
        zero = jnp.zeros(robot.nv)
        observed = Observation(motion, log["a"])
        y, residual = torque_residuals(robot, observed, filter_.bodies, zero)
        # Whitened once: R is the same at every tick but for its scale.
        white = {"y": jnp.einsum("ij,tjbp->tibp", root, y), "residual": residual @ root.T}
        each = jax.vmap(one, in_axes=(None, None, None, 0))
        each = jax.vmap(each, in_axes=(None, None, 0, None))
        each = jax.vmap(each, in_axes=(None, 0, None, None))
        return each(white, told, jnp.asarray(REOPEN), jnp.asarray(GAMMAS))

    told = np.stack([scale, np.ones_like(scale)], axis=1)
    run = jax.jit(lambda x, t: jax.lax.map(lambda y: of_log(*y), (x, t)))
    mass, nis, accepted = run(
        {k: jnp.asarray(v, float) for k, v in logs.items()}, jnp.asarray(told)
    )
    return {"mass": np.asarray(mass), "nis": np.asarray(nis), "used": np.asarray(accepted)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rollouts", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    begin = time.monotonic()
    logs, who, tick = rollouts(args.rollouts, args.seed)
    rolled = time.monotonic() - begin
    # The plant in float32, as MJX is run; the filter in float64, where two iterations are safe.
    jax.config.update("jax_enable_x64", True)
    who = jax.tree.map(np.asarray, who)
    robot = load_model(stepping.robot_model())
    found = sweep(robot, logs, np.asarray(who.noise, float), tick)
    swept = time.monotonic() - begin - rolled
    print(f"rollouts {rolled:.0f} s, sweep {swept:.0f} s, compiling included", flush=True)
    nominal = float(robot.pi[robot.body_index(stepping.TORSO), 0])
    scored = gate_page.score(found, logs["force"], np.asarray(who.load), nominal, tick)
    data = {
        "about": results.circumstances(),
        "rollouts": args.rollouts,
        "seed": args.seed,
        "seconds": {"rollouts": rolled, "sweep": swept},
        "gamma": [None if np.isinf(g) else g for g in GAMMAS],
        "name": NAMES,
        "probability": [*PROBABILITIES, *([None] * len(RAW))],
        **scored,
    }
    results.save_json(results.RESULTS / "gate_sweep.json", data)
    gate_page.draw(data, found, np.asarray(who.load), nominal, tick)
    results.write_part("gate_sweep", gate_page.page(data))


if __name__ == "__main__":
    main()
