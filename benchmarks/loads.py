"""Loads of 0.1 to 30 times the link that takes them up: which estimators find them, when, and how honest their ± is.

    python -m benchmarks.loads            # results/loads.json, and the table of docs/online.md; minutes on two cores

Four arms (`harness/pickup_log.py`: MuJoCo C's inverse dynamics along planned motions, nothing of this project) take up
a load after 4 s of 10, with all raw samples or 0.25 or 5 % of them lost, with and without friction and offsets of 1 %
of the largest torque. All filters get the same 20 Hz observations, of which one lost raw sample in ten loses one, and
the noise's size as stated; one vmapped scan runs them all.

Baselines: `linear` is the paper's Kalman filter on π; `rls` recursive least squares of π with a memory of 2.5 s;
`batch` least squares of load, friction and offsets over what follows the pick-up, whose moment it is given; `log-det`
the same within what a body can be, by a semidefinite program (`harness/log_det.py`).
"""

import json
import sys
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jax_inertia as ji
from benchmarks.harness import log_det, pickup_log, results
from benchmarks.harness.pickup_log import WRIST
from jax_inertia.estimation import joint_terms, log_filter, pieces
from jax_inertia.estimation.inertial_filter import make_estimator
from jax_inertia.maths.charts import Linear

ROOT = Path(__file__).parents[1]
RATIOS = (0.1, 0.3, 1.0, 3.0, 10.0, 20.0, 30.0)
LOST = (0.0, 0.0025, 0.05)
FRICTION = (0.0, 0.01)
SEEDS, AT, SECONDS = 3, 4.0, 10.0
RESULTS, PAGE = ROOT / "benchmarks/results/loads.json", ROOT / "docs/online.md"
# Within a tenth of what the wrist then weighs, or a hundredth of the heaviest load, for good: found.
CLOSE, LEAST = 0.1, 0.003
MEMORY = 0.98


def logs(kind: str, friction: float, robot: ji.Robot):
    """(observations stacked over seeds × ratios, masses of the wrist afterwards)."""
    own, seen, truth = pickup_log.own_mass(kind), [], []
    for seed in range(100, 100 + SEEDS):
        for ratio in RATIOS:
            log = pickup_log.picked_up(
                kind, ratio * own, at=AT, seconds=SECONDS, seed=seed, friction=friction
            )
            seen.append(log_filter.thinned(log_filter.observe(log, robot)))
            truth.append(own * (1.0 + ratio))
    return jax.tree.map(lambda *x: np.stack([np.asarray(y) for y in x]), *seen), np.array(truth)


def with_lost(observations, share: float, seed: int):
    """The same with raw samples lost: one lost at 200 Hz is a sample lost at 20 Hz, low-pass and all."""
    rng = np.random.default_rng(seed)
    valid = np.asarray(observations.motion.valid)
    gone = rng.random(valid.shape[:2]) < 1.0 - (1.0 - share) ** 10
    return eqx.tree_at(lambda o: o.motion.valid, observations, valid & ~gone[..., None])


def _filtered(estimator, observations, dt):
    """(mass, σ, rejected, tested) of every run."""

    def one(observation):
        _, trace = estimator.run(estimator.initial(), observation, dt=dt)
        e, i = trace.estimate, trace.innovation
        return e.pi[:, 0, 0], e.sigma_pi[:, 0, 0], i.rejected, i.tested

    return jax.vmap(one)(observations)


# Compiling takes longer than filtering.
_QUICK = {"xla_backend_optimization_level": 0}
filtered = eqx.filter_jit(_filtered, compiler_options=_QUICK)  # pyright: ignore[reportCallIssue]


class Baselines(NamedTuple):
    """Mass over time by recursive least squares; mass and σ by two fits of what follows the pick-up [kg]."""

    rls: np.ndarray
    batch: tuple[float, float]
    log_det: tuple[float, float]


def baselines(robot, observation, joints, sigma, own) -> Baselines:
    """What is compared with, of one log."""
    y, others, valid = log_filter.regressors(robot, observation, [WRIST])
    nominal = np.asarray(robot.pi)[robot.body_index(WRIST)]
    prior = np.asarray(ji.Load(0.1 * float(robot.pi[:, 0].sum())).sigma_pi()) * 10.0
    rows = pieces.LinearRows(y, others + y @ nominal, valid, prior)
    inner, right, mass = np.eye(10), np.zeros(10), np.full(len(y), own)
    for k in range(len(y)):
        more, side = rows.normal(slice(k, k + 1), sigma)
        inner, right = MEMORY * inner + more - np.eye(10), MEMORY * right + side
        mass[k] = own + (prior * np.linalg.solve(inner + 1e-9 * np.eye(10), right))[0]
    wide = rows.with_joints(joints, np.asarray(observation.motion.v))
    after = slice(int(np.searchsorted(observation.motion.time, AT + 0.15)), len(y))
    inner, right = wide.normal(after, sigma)
    inverse = np.linalg.inv(inner)
    size = wide.sigma[0]
    batch = own + size * (inverse @ right)[0], size * float(np.sqrt(inverse[0, 0]))
    # The ridge of the first ten makes way for the log-det prior.
    data = inner - np.diag((np.arange(len(right)) < 10).astype(float))
    z, spread = log_det.solved(data, right, nominal, wide.sigma[:10])
    return Baselines(mass, batch, (own + size * z[0], size * float(np.sqrt(spread[0, 0]))))


def found_after(time, mass, truth) -> np.ndarray:
    """Seconds from the pick-up until each run is close for good; infinite where it never is."""
    far = np.abs(mass - truth[:, None]) > np.maximum(CLOSE * truth, LEAST * truth.max())[:, None]
    out = np.full(len(mass), np.inf)
    for i, off in enumerate(far):
        if not off[-1]:
            last = np.flatnonzero(off & (time > AT))
            out[i] = max(time[last[-1] + 1] - AT, 0.0) if len(last) else 0.0
    return out


def arm(kind: str) -> list[dict]:
    """All cells of one arm, a row for each estimator, loss, friction and ratio."""
    robot, out = ji.load_model(pickup_log.arm(kind)), []
    for friction in FRICTION:
        observations, truth = logs(kind, friction, robot)
        tau, v = (
            np.concatenate(np.asarray(x)) for x in (observations.motion.tau, observations.motion.v)
        )
        joints = joint_terms.of_log(robot, tau, v)
        time = np.asarray(observations.motion.time)[0]
        dt = jnp.asarray(np.diff(time, prepend=2 * time[0] - time[1]))
        # What is left of white noise below 10 Hz of 200, and of the encoders' in the model's torques.
        limit = (
            2.0
            * np.abs(
                pickup_log.torques(
                    pickup_log.arm(kind), *pickup_log.motion(kind, np.arange(2000) / 200, 0)
                )
            ).max()
        )
        sigma = 0.002 * limit * np.linspace(1, 0.2, robot.nv) * 0.5 + 1e-3 * limit / 30
        stated = jnp.asarray(sigma)
        print(f"{kind}, friction {friction}: {len(truth)} logs", flush=True)
        own = {
            "default": make_estimator(robot, [WRIST], sigma_tau=stated),
            "default with friction": make_estimator(
                robot, [WRIST], sigma_tau=stated, joints=joints
            ),
            "linear": make_estimator(robot, [WRIST], sigma_tau=stated, paper=True, chart=Linear()),
        }
        for lost in LOST:
            seen = with_lost(observations, lost, seed=int(1e4 * lost))
            for name, estimator in own.items():
                mass, s, rejected, tested = (np.asarray(x) for x in filtered(estimator, seen, dt))
                share = rejected.sum(1) / np.maximum(tested.sum(1), 1)
                out += cells(kind, name, lost, friction, time, mass, s[:, -1], share, truth)
            runs = [jax.tree.map(lambda x, i=i: x[i], seen) for i in range(len(truth))]
            both = [baselines(robot, x, joints, sigma, pickup_log.own_mass(kind)) for x in runs]
            mass = np.array([x.rls for x in both])
            none = np.full(len(truth), np.nan)
            out += cells(kind, "rls", lost, friction, time, mass, none, none, truth)
            for name, told in (
                ("batch", [x.batch for x in both]),
                ("log-det", [x.log_det for x in both]),
            ):
                last, s = np.array(told).T
                mass = np.repeat(last[:, None], len(time), 1)
                out += cells(kind, name, lost, friction, time, mass, s, none, truth)
    return out


def cells(kind, name, lost, friction, time, mass, sigma, rejected, truth) -> list[dict]:
    """One row for each ratio."""
    after, error, out = found_after(time, mass, truth), mass[:, -1] - truth, []
    for k, ratio in enumerate(RATIOS):
        i = slice(k, None, len(RATIOS))
        z = error[i] / sigma[i]
        out.append(
            {
                "arm": kind,
                "estimator": name,
                "lost": lost,
                "friction": friction,
                "ratio": ratio,
                "runs": len(error[i]),
                "found_within_1s": int(np.sum(after[i] <= 1.0 + 1e-9)),
                "found": int(np.sum(np.isfinite(after[i]))),
                "seconds_median": _number(np.median(after[i])),
                "error_kg_median": _number(np.median(np.abs(error[i]))),
                "error_share_max": _number(np.max(np.abs(error[i]) / truth[i])),
                "mass_nees_mean": _number(np.mean(z**2)),
                "within_95": _number(np.sum(np.abs(z) < 1.96)),
                "rejected_share_mean": _number(np.mean(rejected[i])),
            }
        )
    return out


def _number(x) -> float | None:
    return float(f"{float(x):.4g}") if np.isfinite(x) else None


def table(rows: list[dict]) -> str:
    """For the page: estimators by friction and loss, all arms and ratios together."""
    lines = [
        "| estimator | friction | lost | runs | found within 1 s | found | largest error | 95 % holds | refused |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(x["estimator"] for x in rows):
        for friction in FRICTION:
            for lost in LOST:
                own = [
                    x
                    for x in rows
                    if (x["estimator"], x["friction"], x["lost"]) == (name, friction, lost)
                ]
                total = {
                    k: sum(x[k] or 0 for x in own)
                    for k in ("runs", "found", "found_within_1s", "within_95")
                }
                has = own[0]["within_95"] is not None and own[0]["mass_nees_mean"] is not None
                worst = max(x["error_share_max"] or 0 for x in own)
                refused = [x["rejected_share_mean"] for x in own]
                lines.append(
                    f"| {name} | {'1 %' if friction else 'none'} | {100 * lost:g} % | {total['runs']} | "
                    f"{total['found_within_1s']} | {total['found']} | {100 * worst:.2g} % | "
                    + (f"{100 * total['within_95'] / total['runs']:.0f} %" if has else "–")
                    + (
                        f" | {100 * float(np.mean(refused)):.1f} % |"
                        if refused[0] is not None
                        else " | – |"
                    )
                )
    return "\n".join(lines) + "\n"


def write(rows: list[dict]) -> None:
    """The results, and the page's table of them."""
    RESULTS.write_text(json.dumps({"rows": rows}, indent=1) + "\n")
    results.write_part("loads", table(rows), PAGE)


def main() -> None:
    """Run arm by arm; what is written holds all that are done."""
    rows = []
    for kind in sys.argv[1:] or pickup_log.ARMS:
        rows += arm(kind)
        write(rows)
    print(table(rows))


if __name__ == "__main__":
    main()
