"""Other ways to read a log than its model's, with what each leaves: units, signs, order, couplings.

Each yields `Reading`s: a finding, and the share of the torque's energy that remains if it is true.
"""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from jax_inertia.logs.findings import Finding, Severity
from jax_inertia.preflight.compared import Compared, norm

# Gains outside of these are another unit; a drive's own tolerance, and a wrong model's, are within.
LOW, HIGH = 0.35, 3.0
# The least that N m are in another unit of torque: 8.85 pound-force inches. What is less is a spring or a load.
_UNITS = 8.0
# Of one gear: the gains of all joints agree within this share.
_ALIKE = 0.1
# Loads heavier than so many robots are another unit.
_HEAVIEST = 20.0
# Joints that are not part of a reading miss less than this share of their energy.
FITS = 0.1
# A motor whose joint needs next to nothing is felt from this share of the largest torque on.
_FELT = 0.02
# Of a differential the products of the direct and of the crossed gains are opposite and about as large.
_LOWEST_MIX = 1.0 / 3.0
# A joint without a drive needs less than this of its weight's or its inertia's torque: they balance.
_PASSIVE = 0.7
# A torque that is a part of what the model needs, and one that is next to nothing compared with it.
_PART, _NOTHING = 0.5, 0.15


class Reading(NamedTuple):
    """A way to read the log, and the share of the torque's energy that it leaves."""

    left: float
    finding: Finding
    plain: float | None = None
    """What the plain model leaves at the same joints, where the reading is about some only."""
    searched: bool = False
    """One of many that were tried: it must leave still less."""


def error(check: str, message: str) -> Finding:
    """What makes an estimate senseless."""
    return Finding(Severity.ERROR, check, message)


def unlogged(c: Compared) -> Iterator[Reading]:
    """Joints whose torque is 0 throughout, though they do not move as they would without one."""
    free = norm(c.needed) < _PASSIVE * np.maximum(norm(c.weight), norm(c.inertia))
    dead = np.flatnonzero(c.judged & ~free & ~np.any(c.raw, axis=0))
    if len(dead):
        which = "every joint" if len(dead) == c.judged.sum() else c.called(dead)
        message = (
            f"tau of {which} is 0 throughout, and moving so takes a torque: none was logged; log it, "
            "or leave tau out"
        )
        yield Reading(0.0, error("no_torque", message))


def gains(c: Compared) -> Iterator[Reading]:
    """One factor for each joint: another unit, a gear's other side, a sign."""
    gain = c.gains
    left = c.tau - c.needed * gain
    # What carries nothing is moved by friction, and a factor is poorly known.
    where = np.flatnonzero(c.carrying if c.carrying.any() else c.judged)
    g = gain[where]
    if np.all(np.abs(g) < LOW) or np.all(np.abs(g) > _UNITS):
        # A load is a factor, too, where there is one joint, or all of the weight is at the end.
        if c.left_of_torque(left, where) < FITS and not (np.all(g > _UNITS) and _is_load(c, where)):
            yield Reading(float(np.mean(c.missed(left)[where])), _unit(g))
        return
    turned = np.array([j for j in np.flatnonzero(c.judged) if LOW < -gain[j] < HIGH], int)
    if len(turned):
        factor = np.where(np.isin(np.arange(len(gain)), turned), -1.0, 1.0)
        right = np.any((gain > LOW) & c.judged)
        which = c.called(turned) if right else "every joint"
        factor = factor if right else np.full(len(gain), -1.0)
        message = (
            f"tau of {which} is minus what the model needs (factor {np.median(gain[turned]):.2f}): its sign is turned, "
            "or it is the load's torque and not the motor's; turn the sign of tau: --tau-unit turned --gains -1 (1 for "
            "joints that are right)"
        )
        yield Reading(c.left(c.needed, c.tau * factor), error("sign", message))
    off = np.array([j for j in where if not LOW < abs(gain[j]) < HIGH], int)
    others = np.setdiff1d(where, off)
    if len(off) and len(others) > 1:
        rest = c.missed(c.carried(c.tau - c.needed))
        if np.all(rest[others] < FITS):
            text = ", ".join(f"{c.parts.names[j]} is {gain[j]:.3g}" for j in off)
            message = (
                f"tau of {text} times what the model needs, and as it should be at the other joints: another unit or "
                "gear there? give --tau-unit and every joint's --gains (N m per unit)"
            )
            if c.left_of_torque(left, off) < FITS:
                fits = np.where(np.isin(np.arange(len(gain)), off), c.missed(left), rest)
                yield Reading(float(np.mean(fits[where])), error("unit", message))


def own_gains(c: Compared) -> Iterator[Reading]:
    """Another factor at each joint: currents or counts of different drives."""
    where = np.flatnonzero(c.carrying if c.carrying.any() else c.judged)
    g = c.gains[where]
    left = c.tau - c.needed * c.gains
    strange = np.any((np.abs(g) < LOW) | (np.abs(g) > HIGH))
    if (
        len(where) > 1
        and strange
        and c.left_of_torque(left, where) < FITS
        and not _is_load(c, where)
    ):
        yield Reading(float(np.mean(c.missed(left)[where])), _unit(g))


def _is_load(c: Compared, where: np.ndarray) -> bool:
    """Whether a load that somebody may hang there explains torques that are larger than the model's."""
    missing = c.tau - c.needed
    masses = c.masses(missing, free=True)
    fits = c.left_of_torque(missing - c.load @ masses, where) < FITS
    return fits and bool(masses.sum() < _HEAVIEST * c.mass)


def _unit(gain: np.ndarray) -> Finding:
    middle = float(np.median(gain))
    alike = bool(np.ptp(gain) < _ALIKE * abs(middle))
    span = f"{middle:.4g}" if alike else f"{gain.min():.2g} to {gain.max():.2g}"
    if alike and LOW < middle / 1000.0 < HIGH:
        ask = "N mm? give --tau-unit mNm --gains 0.001; or masses of the model in another unit? correct the model"
    elif alike and abs(middle) > _UNITS:
        ask = (
            "masses of the model in another unit? correct the model; or another unit of torque? give --tau-unit other "
            f"--gains {1 / middle:.3g}"
        )
    elif alike:
        ask = (
            f"the motor's side of a gear of {1 / middle:.3g}? give --tau-unit motor --gains {1 / middle:.4g}; or "
            "currents of motors? give --tau-unit A"
        )
    else:
        ask = "currents or counts of motors? give --tau-unit A (or counts)"
    return error(
        "unit",
        f"tau is {span} times what the model needs, at every joint that carries: not N m of the joint; {ask}",
    )


def inertia_unit(c: Compared) -> Iterator[Reading]:
    """Inertias of the model in another unit, masses right."""
    joints = np.flatnonzero(c.judged)
    scale = c.size[joints]
    a, b = ((x[:, joints] / scale).ravel() for x in (c.inertia, c.tau - c.weight))
    factor = float(a @ b / max(a @ a, 1e-300))
    if not 0.1 < factor < 10.0:
        message = (
            f"tau fits gravity and {factor:.2g} times the model's inertia torque: inertias of the model in another "
            "unit? give kg m²"
        )
        left = c.tau - c.weight - factor * c.inertia
        if c.left_of_torque(left, joints) < FITS:
            yield Reading(float(np.mean(c.missed(left)[joints])), error("inertia_unit", message))


def external(c: Compared) -> Iterator[Reading]:
    """Nothing but a load's torque: what remains once a controller took its whole model out."""
    size = _size(c)
    carrying = np.flatnonzero(c.carrying)
    if not carrying.size:
        return
    weak = c.left_of_torque(c.tau - c.needed * c.gains, carrying) < FITS
    # Where one joint carries, a drive that gives less than it should is a load, too.
    if weak and np.all(c.gains[carrying] > LOW):
        return
    if size < _PART:
        message = (
            f"tau is {100 * size:.0f} % of what the model needs, and a load at the robot's end, without the robot, is "
            "all there is in it: the external torque that a controller estimates; log what motors or sensors give"
        )
        for tau in (c.tau, -c.tau):
            if c.left_of_torque(c.carried(tau), carrying) < FITS:
                yield Reading(c.left_beside_load(tau), error("external", message))


def nothing(c: Compared) -> Iterator[Finding]:
    """A torque in which there is nothing of the model's, and next to nothing at all."""
    size, (gravity, inertia) = _size(c), c.factors()
    if size < _NOTHING and max(abs(gravity), abs(inertia)) < LOW:
        yield error(
            "external",
            f"tau is {100 * size:.0f} % of what the model needs, with neither gravity nor inertia in it (factors "
            f"{gravity:.2f} and {inertia:.2f}): the external torque that a controller estimates, or no torque in N m; "
            "log what motors or sensors give (where the controller took gravity alone out: --gravity-compensated)",
        )


def _size(c: Compared) -> float:
    """Logged against the model's torque at the joints that carry."""
    if not c.carrying.any():
        return np.inf
    return float(np.linalg.norm(c.tau[:, c.carrying]) / np.linalg.norm(c.needed[:, c.carrying]))


def pairs(c: Compared) -> Iterator[Reading]:
    """Two joints driven by two motors through a constant matrix: a differential, a parallel ankle."""
    off = c.missed(c.tau - c.needed)
    # One of the motors may have a joint to turn that needs next to nothing.
    felt = np.flatnonzero(c.judged | (norm(c.tau) > _FELT * c.size.max()))
    for i, j in itertools.combinations(felt.tolist(), 2):
        others = [k for k in felt if k not in (i, j)]
        if (
            max(off[i], off[j]) < FITS
            or min(off[i], off[j]) < 0.3 * FITS
            or np.any(off[others] > FITS)
        ):
            continue
        both = [i, j]
        # Friction of either joint may be in either motor's torque.
        rows = c.parts.used[:, i] & c.parts.used[:, j]
        basis = np.linalg.qr(np.hstack([c.parts.friction[k][rows] for k in both]))[0]
        raw, weight = c.raw[rows][:, both], (c.parts.weight + c.parts.inertia)[rows][:, both]
        tau, needed = (x - basis @ (basis.T @ x) for x in (raw, weight))
        matrix = np.linalg.lstsq(needed, tau, rcond=None)[0].T
        alone = tau - needed * np.sum(tau * needed, axis=0) / np.sum(needed**2, axis=0)
        left = tau - needed @ matrix.T
        share, before = (float(np.mean(norm(x) ** 2 / norm(tau) ** 2)) for x in (left, alone))
        if not _mixed(matrix) or share > 0.25 * before or abs(np.linalg.det(matrix)) < 1e-6:
            continue
        inverse = np.linalg.inv(matrix)
        p, r = (c.parts.names[k] for k in both)
        lines = [
            f"{name} = {x:.3g} tau[{p}] {'-' if y < 0 else '+'} {abs(y):.3g} tau[{r}]"
            for name, (x, y) in zip((p, r), inverse, strict=True)
        ]
        message = (
            f"tau of {p} and {r} are the torques of two motors that drive both joints (differential, parallel ankle): "
            f"{', '.join(lines)} fits all of it; put the joints' torques into tau"
        )
        yield Reading(share * 2 / len(felt), error("coupled", message))


def _mixed(matrix: np.ndarray) -> bool:
    """Whether two motors drive two joints about alike, together one and against each other the other."""
    direct, crossed = matrix[0, 0] * matrix[1, 1], matrix[0, 1] * matrix[1, 0]
    return bool(direct * crossed < 0 and _LOWEST_MIX < abs(crossed / direct) < 1.0 / _LOWEST_MIX)
