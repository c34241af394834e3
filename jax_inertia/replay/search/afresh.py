"""Fits that start elsewhere than at the numbers without an effect: from the nominal model's, or a joint's anew.

Dead bands, limits and single effects have such starts where the loop's own response does not hold (`closed_loop.find`):
torque is logged, or chains close.
"""

import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.replay.fitting.errors import replay_errors
from jax_inertia.replay.fitting.fit import Fit, fit
from jax_inertia.replay.loop import ORDINARY
from jax_inertia.replay.record import Record
from jax_inertia.replay.search import by_law
from jax_inertia.replay.search.candidates import Candidate
from jax_inertia.replay.search.parsimony import Parabola, nominal
from jax_inertia.replay.search.tries import (
    AS_GOOD,
    ROUNDS,
    at_best,
    fitted_from,
    placed,
    price,
    ranked,
)
from jax_inertia.replay.simulation.plant import Plant

_JOINTS, _STIFFER = 3, (0.0, 0.35, 0.7, 1.1)
"""How many joints are looked at, and by what logarithms gains are raised."""
_FROM_NOMINAL, _AS_SAID, _AT_GAINS = 1, 2, 6
"""Candidates that are fitted, and rounds of the fit that keeps the gains."""


def from_nominal(
    plant: Plant,
    found: Fit,
    pool: Sequence[Candidate],
    records: Sequence[Record],
    floor: np.ndarray,
) -> list[tuple[Candidate, Fit]]:
    """Fits that start at the nominal model with one effect and few ordinary numbers.

    Where many ordinary numbers, each far off, pass for one effect, no small step leads from them to it: about them the
    cost is no parabola as far as the nominal model. About that the effects are ranked, in units of the whole gap.
    """
    theta = np.where(found.free, nominal(found), found.theta)
    start = fit(plant, found.table, records, theta, free=found.free, floor=floor, rounds=0)
    about = Parabola(start, start.samples)
    bare = about.worth().total
    linear = [c for c in pool if c.scales]
    ranked = [
        (bare - worth.total - price(start, c), c, sizes, worth.off)
        for c, worth, sizes in at_best(plant, about, linear, records)
    ]
    ranked.sort(key=lambda x: -x[0])
    out = []
    for gain, c, sizes, off in ranked[:_FROM_NOMINAL]:
        if gain > 0:
            new = theta.copy()
            new[about.go] = nominal(found)[about.go] + off
            new = np.append(new, sizes)
            out.append((c, fitted_from(plant, found, c, new, records, floor)))
    return out


def gains_as_said(
    plant: Plant, found: Fit, records: Sequence[Record], floor: np.ndarray
) -> Fit | None:
    """The fit that keeps the gains which the log or the model says; None where the simplest numbers keep them.

    A load is less gain, damping and friction of all joints before it, all by one factor: a number against many, but
    given up one by one each of them is missed. What they pass for is sought where none of them is there. Torque tells
    gains. Where a model's gains are far from the robot's, what starts there is worth less than what it is compared to.
    """
    gains = np.array([p.family in ("kp_scale", "kd_scale") for p in found.table])
    about = Parabola(found, found.samples)
    needed = gains[about.go] & (about.worth().off != 0)
    if records[0].torque is not None or not needed.any():
        return None
    held = np.where(gains, nominal(found), found.theta)
    free = found.free & ~gains
    return fit(plant, found.table, records, held, free=free, floor=floor, rounds=_AT_GAINS)


def simpler(
    plant: Plant, found: Fit, said: Fit, records: Sequence[Record], floor: np.ndarray
) -> Fit:
    """The fit that starts at gains as said, all numbers free again, where that is clearly worth more than `found`.

    Of two that are worth the same the one that errs less leaves less for an effect to pass for: a load friction of an
    XL330 was lost to a fit that was worth 0.07 nats more, and other runs were replayed by 52 mrad for 32.
    """
    new = fit(
        plant,
        found.table,
        records,
        said.theta,
        free=found.free,
        floor=floor,
        rounds=ROUNDS,
        exact=True,
    )
    was = Parabola(found, found.samples).worth()
    now = Parabola(new, found.samples, found.weights).worth()
    return new if now.total < was.total - AS_GOOD else found


def as_said(
    plant: Plant,
    found: Fit,
    said: Fit,
    pool: Sequence[Candidate],
    records: Sequence[Record],
    floor: np.ndarray,
) -> list[tuple[Candidate, Fit]]:
    """Fits that start at gains as said, with effects that grow in proportion to their size."""
    out, pool = [], [c for c in pool if c.scales]
    for _, c, size in ranked(plant, said, pool, records)[:_AS_SAID]:
        tried = fitted_from(plant, said, c, np.append(said.theta, size), records, floor)
        best, tried = next(iter(placed(plant, c, tried, records, floor)), (c, tried))
        out.append((best, fitted_from(plant, found, best, tried.theta, records, floor)))
    return out


def dead_bands(
    plant: Plant,
    found: Fit,
    pool: Sequence[Candidate],
    excess: Float[np.ndarray, " n"],
    records: Sequence[Record],
    floor: np.ndarray,
) -> list[tuple[Candidate, Fit]]:
    """Fits with a dead band that do not start at the numbers without one.

    A soft loop with much friction passes for a stiff one with a dead band, and no small step leads from one to the
    other: gain, friction and dead band are looked for together, at the joints whose replays, or torques, err most.
    """
    pool = [c for c in pool if c.family == "dead_band" and c.place[0] >= 0]
    pool = sorted(
        (c for c in pool if excess[c.place[0]] > by_law.ROUGH), key=lambda c: -excess[c.place[0]]
    )
    where = {(p.family, p.joint): k for k, p in enumerate(found.table)}
    out = []
    for c in pool[:_JOINTS]:
        gain, dry, wet = (
            where.get((f, c.place[0]), -1)
            for f in ("kp_scale", "coulomb_friction", "viscous_friction")
        )
        if min(gain, dry, wet) < 0:
            continue
        table, tries = (*found.table, *c.parameters), []
        for (width,), stiffer, rubs in itertools.product(c.starts, _STIFFER, (True, False)):
            theta = np.append(found.theta, width)
            theta[gain] += stiffer
            if not rubs:
                theta[[dry, wet]] = table[dry].nominal, table[wet].nominal
            tries.append(theta)
        out.append((c, _fitted_from_best(plant, found, c, np.array(tries), records, floor)))
    return out


def limits(
    plant: Plant,
    found: Fit,
    pool: Sequence[Candidate],
    excess: Float[np.ndarray, " n"],
    records: Sequence[Record],
    floor: np.ndarray,
) -> list[tuple[Candidate, Fit]]:
    """Fits with a limit of the joint that errs most, its ordinary numbers starting at the nominal model's.

    What a low limit does to a motion, a loop with half its kp and twice its damping does in part, and at those numbers
    a limit is hardly reached.
    """
    worst, out = int(np.argmax(excess)), []
    if excess[worst] <= by_law.ROUGH:
        return out
    own = [k for k, p in enumerate(found.table) if p.joint == worst and p.family in ORDINARY]
    for c in pool:
        if c.family not in ("torque_saturation", "torque_speed") or c.place[0] != worst:
            continue
        thetas = np.array([np.append(found.theta, start) for start in c.starts])
        thetas[:, own] = nominal(found)[own]
        out.append((c, _fitted_from_best(plant, found, c, thetas, records, floor)))
    return out


def _fitted_from_best(
    plant: Plant,
    found: Fit,
    c: Candidate,
    thetas: Float[np.ndarray, "B P"],
    records: Sequence[Record],
    floor: np.ndarray,
) -> Fit:
    """The fit from whichever numbers replay best, weighed as `found` is."""
    replayed = replay_errors(plant.quick, (*found.table, *c.parameters), thetas, records)
    costs = np.sum((replayed * found.weights.root) ** 2, axis=(1, 2))
    return fitted_from(plant, found, c, thetas[int(np.argmin(costs))], records, floor)
