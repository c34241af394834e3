"""Turned signs and lost weights, by bounds on a joint's friction, rotor inertia and offset.

Friction, rotor inertia and offset are free where a torque is compared with its model (`compared`), and of a slide that
always carries the same nothing is left to compare: it needs b + J a + F sign(v) + d v. But no rotor has less than no
inertia, no friction drives, and an offset is a part of what a joint carries:

    τ = w + m a + b + J a + F sign(v) + d v,    J, F, d ≥ 0,    |b| ≤ |w| / 2
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from jax_inertia.logs.findings import Finding
from jax_inertia.preflight.compared import Compared, norm
from jax_inertia.preflight.other_readings import FITS, error

# An offset is less than this share of the weight that the joint carries (a decision: a drive holds half at least).
_OFFSET = 0.5
# Offsets hide a weight that changes by less than this share of it (a decision: a slide that tilts by 1 in 50).
_CONSTANT = 0.02
# Of the logged energy, what another reading leaves of what the plain one does, which leaves more than the latter.
_LEAVES, _SOUND = 1.0 / 9.0, 0.05


def by_own_numbers(c: Compared) -> Iterator[Finding]:
    """Joints whose torque has its sign turned, and slides whose torque does not hold what they carry."""
    weight, inertia = c.parts.weight, c.parts.inertia
    needed = weight + inertia
    constant = norm(c.weight) < _CONSTANT * norm(weight)
    turned, weightless = [], []
    for j in np.flatnonzero(c.parts.used.any(axis=0) & c.raw.any(axis=0)).tolist():
        plain = _left(c, j, c.raw[:, j], needed[:, j])
        most = min(_LEAVES * plain, FITS)
        if plain < _SOUND:
            continue
        if _left(c, j, -c.raw[:, j], needed[:, j]) < most:
            turned.append(j)
        elif constant[j] and _left(c, j, c.raw[:, j], inertia[:, j]) < most:
            weightless.append(j)
    if turned:
        yield error(
            "sign",
            f"tau of {c.called(turned)} is minus what moves its mass and its friction: its sign is turned, or it is "
            "the load's torque and not the motor's; turn the sign of tau: --tau-unit turned --gains -1 (1 for joints "
            "that are right)",
        )
    if weightless:
        yield error(
            "gravity",
            f"tau of {c.called(weightless)} does not hold the weight that the model says the joint carries: the "
            "controller took it out, and --gravity-compensated adds the model's gravity to tau; or a counterweight "
            "that the model lacks carries it",
        )


def _left(
    c: Compared, j: int, tau: Float[np.ndarray, " R"], needed: Float[np.ndarray, " R"]
) -> float:
    """Share of a joint's logged energy that is left where it needs so much, given numbers that it can have."""
    used, a, v = c.parts.used[:, j], c.parts.motion[2], c.parts.motion[1]
    row = c.parts.rows[j]
    columns = np.stack([np.ones(len(v)), a[:, row], np.sign(v[:, row]), v[:, row]], axis=1)[used]
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    carried = float(np.abs(c.parts.weight[used, j]).mean())
    free = carried < _SOUND * float(np.abs(tau[used]).mean())
    most = np.inf if free else _OFFSET * carried * scale[0]
    bounds = (np.array([-most, 0.0, 0.0, 0.0]), np.array([most, *[np.inf] * 3]))
    missing = (tau - needed)[used]
    best = lsq_linear(columns / scale, missing, bounds)
    return float(2.0 * best.cost / max(float(np.sum(tau[used] ** 2)), 1e-300))
