"""NEES and NIS of the exact filter and of the extended one, by Monte Carlo on MuJoCo C's inverse dynamics.

    python -m benchmarks.online.honest ROBOT TRIALS OUT

Each trial: a load drawn at random on the robot's first link, two seconds of motion, noise of torques and velocities.
NEES is that of mass and first moments (4 numbers, N = 4), which a motion of two seconds sees.
"""

import json
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.stats

from benchmarks.harness.results import commit
from benchmarks.online.draws import (
    RATE,
    REACH,
    WINDOW,
    Subject,
    ball,
    carrying,
    forces,
    noise_of_acceleration,
    noise_of_torque,
    observed,
    subject,
    trajectory,
)
from jax_inertia import load_model, mass_matrix
from jax_inertia.estimation.inertial_filter import Estimator, make_estimator
from jax_inertia.estimation.online.exact_memory import ExactEstimator, make_exact_estimator
from jax_inertia.estimation.priors import Load
from jax_inertia.maths.precision import in_full_precision
from jax_inertia.model.load import body_pi

SECONDS, SEED, SETTLED = 2.0, 77, 30


def logs(who: Subject, count: int):
    """(observations, true π of the link) of so many trials."""
    seen, true = [], []
    link = who.links[0]
    for k in range(count):
        rng = np.random.default_rng([SEED, k])
        load = ball(who, link, rng)
        path = trajectory(who, SECONDS, rng)
        seen.append(observed(who, path, forces(carrying(who.model, {link: load}), path), rng))
        true.append(body_pi(who.model, who.model.body(link).id) + load.pi())
    return jax.tree.map(lambda *x: np.stack(x), *seen), np.array(true)


def _exact(who: Subject, dtype: str) -> ExactEstimator:
    return make_exact_estimator(
        load_model(who.model).astype(dtype),
        [who.links[0]],
        sigma_tau=jnp.asarray(noise_of_torque(who)),
        sigma_v=who.sigma_v,
        prior=Load(who.load, REACH),
    )


def _extended(who: Subject, dtype: str) -> Estimator:
    robot = load_model(who.model).astype(dtype)
    q = jnp.asarray(who.model.qpos0 if who.model.nkey == 0 else who.model.key_qpos[0], dtype)
    inertia = np.asarray(mass_matrix(robot, q))
    sigma = np.hypot(
        noise_of_torque(who), noise_of_acceleration(who) * np.sqrt((inertia**2).sum(axis=1))
    )
    prior = Load(who.load, REACH)
    return make_estimator(robot, [who.links[0]], sigma_tau=jnp.asarray(sigma), prior=prior)


def _follow(own: ExactEstimator | Estimator, log):
    """(belief at the end, (NIS, rows, whether it was believed) of every sample)."""
    if isinstance(own, Estimator):
        state, trace = own.run(own.initial(), log)
        seen = trace.innovation
        return state.belief, (seen.nis, seen.rows, seen.accepted)

    def one(state, x):
        state, step = own.step(state, x, WINDOW / RATE)
        return state, (step.nis, step.rows, step.weight > 0.5)

    state, kept = jax.lax.scan(one, own.initial(), log)
    return state.belief, kept


def trials(name: str, drawn: tuple, dtype: str, kind: str = "exact") -> dict:
    """Shares within σ and 2σ of the mass, NEES of mass and first moments, NIS per row, over the `logs` drawn."""
    who, (log, true) = subject(name), drawn
    count = len(true)
    own = _exact(who, dtype) if kind == "exact" else _extended(who, dtype)

    @in_full_precision
    def one(x):
        belief, kept = _follow(own, x)
        x = belief.mean.reshape(-1, 10)
        g = own.chart.jacobian(x)[0]
        return own.chart.to_pi(x)[0], g @ belief.covariance @ g.T, kept

    batch = 16 if jax.default_backend() == "cpu" else 500
    run = eqx.filter_jit(lambda logs: jax.lax.map(one, logs, batch_size=batch))
    pi, covariance, (nis, rows, good) = jax.tree.map(lambda x: np.asarray(x, float), run(log))
    error = pi - true
    z = np.abs(error[:, 0]) / np.sqrt(covariance[:, 0, 0])
    four = np.einsum(
        "bi,bij,bj->b", error[:, :4], np.linalg.inv(covariance[:, :4, :4]), error[:, :4]
    )
    low, high = np.array(scipy.stats.chi2.interval(0.95, 4 * count)) / count
    used = good[:, SETTLED:] > 0
    below = float(np.mean(four < scipy.stats.chi2.ppf(0.95, 4)))
    return {
        "commit": commit(),
        "robot": name,
        "dtype": dtype,
        "filter": kind,
        "trials": count,
        "within_1_sigma": float(np.mean(z < 1)),
        "within_2_sigma": float(np.mean(z < 2)),
        "median_error_kg": float(np.median(np.abs(error[:, 0]))),
        "median_sigma_kg": float(np.median(np.sqrt(covariance[:, 0, 0]))),
        "nees_mean": float(four.mean()),
        "nees_interval": [float(low), float(high)],
        "nees_median": float(np.median(four)),
        "nees_below_95": below,
        "nees_largest": np.sort(four)[-5:].tolist(),
        "nees_mean_in_bounds": bool(low <= four.mean() <= high),
        "nis_per_row": float(nis[:, SETTLED:][used].sum() / rows[:, SETTLED:][used].sum()),
        "rejected": float(1.0 - good.mean()),
    }


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    robot_, count_, out_ = sys.argv[1:]
    drawn_ = logs(subject(robot_), int(count_))
    result = []
    for kind_, dtype_ in (("exact", "float64"), ("exact", "float32"), ("extended", "float64")):
        result.append(trials(robot_, drawn_, dtype_, kind_))
        print(json.dumps(result[-1]), flush=True)
    with open(out_, "w") as file:
        json.dump(result, file)
