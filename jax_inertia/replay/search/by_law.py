"""Where effects of a loop are likely, by the torque of the joint alone: fits without a replay.

A loop's torque at the positions that were measured depends on its own numbers and nothing else, so that gain, damping
and one effect of a joint are fitted to it in a moment, from the nominal gains: a lag of 25 ms passes for half the kp to
positions, and no small step leads from one to the other.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.loop import ALL, COMMAND
from jax_inertia.replay.record import Record
from jax_inertia.replay.search.candidates import Candidate
from jax_inertia.replay.search.tries import AS_GOOD
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import misses

ROUGH = 3.0
"""Error of a joint's output in units of what encoders leave, from which something of its loop is sought."""
_JOINTS, _MOST = 3, 2
"""Joints looked at, the worst ones, and starts that are left of each."""
_STEPS = 8


class Start(NamedTuple):
    """Numbers from which a fit with a candidate starts; those of the candidate are last."""

    candidate: Candidate
    theta: Float[np.ndarray, " P"]
    gain: float
    """Of the log likelihood of this joint's torque, twice, less ln N for each number."""


def excess(
    plant: Plant, found: Fit, records: Sequence[Record], floor: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " n"]:
    """Error of each joint's torque, at the gains that are said, in units of what encoders leave."""
    gains = [p.family in ("kp_scale", "kd_scale") for p in found.table]
    theta = np.where(gains, [p.mean for p in found.table], found.theta)
    parts = [misses(plant, found.table, theta[None], r)[0][r.settled] for r in records]
    return np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0)) / floor[len(plant.names) :]


def sought(
    pool: Sequence[Candidate], excess: Float[np.ndarray, " n"]
) -> tuple[list[Candidate], list[Candidate]]:
    """(of one joint's loop, all others): no effect of a loop whose torque is as it should be, it would be in it."""
    off = excess > ROUGH
    loops = [c for c in pool if c.family in COMMAND and c.place[0] >= 0]
    mine = [c for c in loops if off[c.place[0]]]
    rest = [c for c in pool if c.family not in COMMAND or (c.place[0] < 0 and off.any())]
    return mine, rest


def starts(
    plant: Plant,
    found: Fit,
    pool: Sequence[Candidate],
    excess: Float[np.ndarray, " n"],
    records: Sequence[Record],
) -> list[list[Start]]:
    """Joint by joint, the likeliest effect of its loop and what may be in its place, the likeliest joint first.

    Each with the joint's gains and its own numbers as the torque has them.
    """
    out: list[list[Start]] = []
    n = len(plant.names)
    for j in np.argsort(-excess)[:_JOINTS].tolist():
        now = float(np.mean(found.error[:, n + j] ** 2))
        samples = len(found.error) / found.weights.correlated[n + j]
        best: dict[str, Start] = {}
        for c in (c for c in pool if c.place[0] == j):
            for s in c.starts:
                theta, square = _fitted(plant, found, c, s, j, records)
                gain = samples * np.log(now / square) - len(c.parameters) * np.log(samples)
                if c.family not in best or gain > best[c.family].gain:
                    best[c.family] = Start(c, theta, float(gain))
        # What the torque leaves open, replays and the ties of the report are asked about.
        least = max(max((x.gain for x in best.values()), default=0.0) - AS_GOOD, 0.0)
        near = sorted((x for x in best.values() if x.gain > least), key=lambda x: -x.gain)
        if near:
            out.append(near[:_MOST])
    return sorted(out, key=lambda near: -near[0].gain)


def _fitted(plant, found: Fit, c: Candidate, start, j: int, records) -> tuple[np.ndarray, float]:
    """(numbers, mean square of the torque's error) at the best gains of the joint and numbers of the candidate.

    The delay of all targets is free as far as other joints leave it: where they do not tell, half of a lag is in it.
    """
    table = (*found.table, *c.parameters)
    rows = [
        k for k, p in enumerate(found.table)
        if p.joint == j and p.family in COMMAND and found.free[k]
    ]  # fmt: skip
    theta = np.append(found.theta, start)
    # Gains that stand for the effect are no place to start from, nor is a delay that does.
    theta[rows] = [table[k].mean for k in rows]
    scale = [table[k].sd for k in rows]
    late = delay_of_others(found, j, len(plant.names))
    if late is not None:
        k, theta[k], sd = late
        rows, scale = [*rows, k], [*scale, sd]
    rows += range(len(found.table), len(table))
    scale += [p.sd for p in c.parameters]
    low, high = (np.array([getattr(table[k], x) for k in rows]) for x in ("low", "high"))
    root = found.weights.root[len(plant.names) + j]

    def error(x: np.ndarray) -> np.ndarray:
        new = theta.copy()
        new[rows] = x
        parts = [misses(plant, table, new[None], r, (j,))[0][r.settled, 0] for r in records]
        return np.concatenate(parts)

    def weighed(x: np.ndarray) -> np.ndarray:
        pull = () if late is None else (x[rows.index(late[0])] - late[1]) / late[2]
        return np.append(root * error(x), pull)

    inside = np.clip(theta[rows], low + 1e-9, high - 1e-9)
    done = least_squares(weighed, inside, bounds=(low, high), x_scale=scale, max_nfev=_STEPS)
    theta[rows] = done.x
    return theta, max(float(np.mean(error(done.x) ** 2)), 1e-300)


def delay_of_others(found: Fit, j: int, n: int) -> tuple[int, float, float] | None:
    """(row, value, deviation) of the delay of all targets, as the prior and the torques of the other joints have it."""
    for k, p in enumerate(found.table):
        if p.family == "target_delay" and p.joint == ALL and found.free[k]:
            others = n + np.delete(np.arange(n), j)
            root = found.weights.root[others]
            slope, error = found.columns[k][:, others] * root, found.error[:, others] * root
            known = float(np.sum(slope**2)) + p.sd**-2
            pull = float(np.sum(slope * error)) + (found.theta[k] - p.mean) * p.sd**-2
            return k, float(found.theta[k] - pull / known), known**-0.5
    return None
