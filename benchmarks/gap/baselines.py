"""What an engineer would try without a diagnosis: three fits of the missing torque, and an oracle.

- `largest_residual`: Coulomb friction at the joint with the largest residual.
- `greedy_bic`: linear families at every place, forward by BIC, residuals unwhitened.
- `pace_like`: armature, viscous and Coulomb friction and a bias at every joint and one delay, all at once (after
  PACE, which fits these by simulation); what it finds is whatever carries a tenth of what the fit explains.
- `sysid_oracle` (`baseline_sysid`): MuJoCo's own `mujoco.sysid`, told which parameter to fit.

Each gives effects in the form of report.json, so that `evaluate.py` scores them like a diagnosis. None can say
`unknown`, or that there is no gap unless it finds nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy.optimize
from baseline_chain import SIGN, Guess, Residual, as_effect
from baseline_guesses import guesses

MOST = 3  # effects, as the diagnosis looks for by default
DELAYS = np.linspace(0.0, 0.04, 41)  # s
CARRIES = 0.1  # of what is explained, or a term of the fit is no finding


def largest_residual(r: Residual) -> list[dict]:
    """Coulomb friction, fitted at the joint whose missing torque has the largest rms."""
    name, (dof, _) = max(r.joints.items(), key=lambda j: float(np.mean(r.y[:, j[1][0]] ** 2)))
    s = r.finish(np.tanh(r.v[:, dof] / SIGN))
    level = -float(s @ r.y[:, dof]) / float(s @ s)
    if level <= 0:
        return []
    return [as_effect("coulomb_friction", "joint", name, {"coulomb": level})]


def greedy_bic(r: Residual) -> list[dict]:
    """Forward selection: n ln(RSS/n) + k ln n over all rows at once, refitted at each step."""
    pool = guesses(r)
    y = r.y.ravel()
    chosen: list[Guess] = []
    best, thetas = len(y) * np.log(y @ y / len(y)), []
    while len(chosen) < MOST:
        trials = [(*_bic(y, [*chosen, g]), g) for g in pool if g not in chosen]
        score, theta, guess = min(trials, key=lambda t: t[0])
        if score >= best:
            break
        best, thetas = score, theta
        chosen.append(guess)
    return [g.effect(theta) for g, theta in zip(chosen, thetas, strict=True)]


def _bic(y: np.ndarray, some: list[Guess]) -> tuple[float, list[np.ndarray]]:
    """The criterion, infinite where a number is impossible, and θ of each guess."""
    columns = np.concatenate([g.columns.reshape(len(y), -1) for g in some], axis=1)
    scale = np.linalg.norm(columns, axis=0)
    alive = scale > 1e-9 * max(float(scale.max()), 1e-300)
    theta = np.zeros(len(scale))
    theta[alive] = np.linalg.lstsq(columns[:, alive], y, rcond=None)[0]
    left = y - columns @ theta
    parts = np.split(theta, np.cumsum([g.columns.shape[2] for g in some])[:-1])
    if not all(g.possible(t) for g, t in zip(some, parts, strict=True)):
        return np.inf, parts
    score = len(y) * float(np.log(left @ left / len(y))) + int(alive.sum()) * float(np.log(len(y)))
    return score, parts


_TERMS = (
    ("armature", "armature"),
    ("viscous_friction", "damping"),
    ("coulomb_friction", "coulomb"),
    ("torque_bias", "bias"),
)


def pace_like(r: Residual) -> list[dict]:
    """Every joint by bounded least squares, for the delay that leaves least (each row by its own torque's variance)."""
    dofs = [dof for dof, _ in r.joints.values()]
    model, size = r.model, np.var(r.tau[:, dofs], axis=0) + 1e-12
    columns, lower = [], []
    for dof in dofs:
        v = r.v[:, dof]
        full = np.stack([-r.a[:, dof], -v, -np.tanh(v / SIGN), np.ones_like(v)], axis=1)
        columns.append(r.finish(full))
        own = (model.dof_armature[dof], model.dof_damping[dof], model.dof_frictionloss[dof])
        lower.append([*(-float(x) - 1e-9 for x in own), -np.inf])

    def fit(delay: float) -> tuple[float, np.ndarray, np.ndarray]:
        """Cost, θ (n, 4), and what each term carries (n, 4), both in units of the torque's variance."""
        late = np.stack([np.interp(r.time - delay, r.time, r.tau[:, d]) for d in dofs], axis=1)
        target = r.y[:, dofs] - r.finish(late - r.tau[:, dofs])
        cost, theta, carried = 0.0, np.zeros((len(dofs), 4)), np.zeros((len(dofs), 4))
        for j in range(len(dofs)):
            bounds = (np.array(lower[j]), np.full(4, np.inf))
            theta[j] = scipy.optimize.lsq_linear(columns[j], target[:, j], bounds).x
            left = target[:, j] - columns[j] @ theta[j]
            cost += float(np.mean(left**2)) / size[j]
            for k in range(4):
                without = left + columns[j][:, k] * theta[j, k]
                carried[j, k] = (np.mean(without**2) - np.mean(left**2)) / size[j]
        return cost, theta, carried

    fits = [fit(d) for d in DELAYS]
    best = int(np.argmin([f[0] for f in fits]))
    cost, theta, carried = fits[best]
    before = float(np.sum(np.mean(r.y[:, dofs] ** 2, axis=0) / size))
    terms = [
        (fits[0][0] - cost, as_effect("time_delay", "global", "global", {"delay": DELAYS[best]}))
    ]
    for j, name in enumerate(r.joints):
        for k, (family, parameter) in enumerate(_TERMS):
            effect = as_effect(family, "joint", name, {parameter: theta[j, k]})
            terms.append((float(carried[j, k]), effect))
    terms.sort(key=lambda t: -t[0])
    return [e for share, e in terms[:MOST] if share > CARRIES * max(before - cost, 1e-300)]


BASELINES: dict[str, Callable[[Residual], list[dict]]] = {
    "largest residual": largest_residual,
    "greedy BIC": greedy_bic,
    "PACE-like": pace_like,
}


def as_report(effects: list[dict]) -> dict:
    """The contract's report, as far as a baseline has one."""
    return {
        "verdict": "explained" if effects else "no_gap",
        "effects": effects,
        "gap": {"chi2": None, "noise_floor": None},
        "shrink": {"heldout": None},
    }


def run(folder: Path) -> dict[str, tuple[dict, float]]:
    """Every baseline on one log: its report, and seconds with what they share."""
    start = time.perf_counter()
    residual = Residual.read(folder)
    shared = time.perf_counter() - start
    out = {}
    for name, fit in BASELINES.items():
        start = time.perf_counter()
        effects = fit(residual)
        out[name] = as_report(effects), shared + time.perf_counter() - start
    return out
