"""Numbers that are handed over are inside physics, and so is what goes with them: conditioned, never clipped.

A number beyond its bound is put at it, and every other number moves to its likeliest value given that: what a clipped
number alone would leave, the others take up as far as they can.
"""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.diagnosis.effects.tolerances import inertial_changes
from jax_inertia.diagnosis.hypothesis import Hypothesis, fast_torque, reshaped
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search.best_numbers import CLOSE
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior
from jax_inertia.diagnosis.search.ordinary import ordinary_of
from jax_inertia.maths.inertial_parameters import is_physical

MOST_ROUNDS = 20
"""Times that secants are laid again about numbers at their bounds: each round comes nearer by a half or more."""
LOADED = 4
"""Rounds in which loads follow what was found: gains and loads of a few tenths change each other by a tenth each."""
SHARES = (0.9, 0.75, 0.5, 0.25, 0.0)
"""Of a body's error, the largest first, that may be taken out of it."""


def physical(residual: Residual, evidence: Evidence, now: Posterior) -> tuple[Residual, Posterior]:
    """The posterior with its mean at its likeliest where a body can exist and every number is within its bounds.

    Secants are laid at the values found, and what goes with the load (gains, friction under load) is of the loads of
    the robot as found: the residual returned has them. Where a secant is at a bound, it is laid from each point of its
    grid, and the likeliest within bounds is taken: a load of another mass may need no impossible inertia. Covariances
    are those without the bounds.
    """
    residual, best, penalty = _laid_within(residual, evidence, now)
    for h in [h for h in best.chosen if h.effect.secant and _beyond(residual, best, h).any()]:
        for shape in h.effect.shapes(residual.context, h.place):
            others = tuple(c for c in best.chosen if c.key != h.key)
            start = evidence.posterior((*others, reshaped(h, residual, shape)))
            loaded, trial, lost = _laid_within(residual, evidence, start)
            if trial.log_evidence - lost > best.log_evidence - penalty:
                residual, best, penalty = loaded, trial, lost
    return residual, best


def _laid_within(
    residual: Residual, evidence: Evidence, now: Posterior
) -> tuple[Residual, Posterior, float]:
    """Secants at their own values, every number within its bounds; and the nats that the bounds cost.

    A number that once was beyond its bound stays at it, and secants move half-way: laid all the way they may take
    turns, since the moment of a load times its lever is all that a bound leaves.
    """
    held: dict[tuple, Bool[np.ndarray, " k"]] = {}
    for k in range(MOST_ROUNDS):
        for h in now.chosen:
            beyond = now.mean[now.part(h)] * h.scale < _least(residual, h)
            held[h.key] = held.get(h.key, np.zeros(h.count, bool)) | beyond
        bounded = within_bounds(residual, now, held)
        if k < LOADED:
            residual = loaded(residual, bounded)
        moved = tuple(_laid(residual, bounded, h) for h in bounded.chosen)
        if k >= LOADED and moved == bounded.chosen:
            break
        if k < LOADED:
            moved = tuple(
                reshaped(h, residual, h.shape) if h.effect.by_load or h.effect.calibrated else h
                for h in moved
            )
        now = evidence.posterior(moved)
    bounded = within_bounds(residual, now, held)
    away = bounded.mean - now.mean
    lost = float(0.5 * away @ np.linalg.solve(now.covariance, away)) if any(away) else 0.0
    return residual, bounded, lost


def loaded(residual: Residual, now: Posterior) -> Residual:
    """The residual whose calibrated model has the loads of the robot as found."""
    carried = np.zeros_like(residual.context.v)
    for h in now.chosen:
        if h.effect.loads:
            carried -= fast_torque(h, residual, h.effect.of_links(now.of(h)[0]))
    return residual.calibrated(ordinary_of(residual, now), carried)


def _laid(residual: Residual, now: Posterior, h: Hypothesis) -> Hypothesis:
    """A secant half-way to its own value."""
    if not h.effect.secant:
        return h
    at, value = np.array(h.shape), np.array(h.effect.at_value(h.shape, now.of(h)[0]))
    if np.all(np.abs(value - at) < CLOSE * h.scale):
        return h
    return reshaped(h, residual, tuple((0.5 * (at + value)).tolist()))


def _least(residual: Residual, h: Hypothesis) -> Float[np.ndarray, " k"]:
    """Least value of each number, those of its level first."""
    context = residual.context
    out = h.effect.least(context, h.place, h.shape, h.count)
    laws = [h.effect] if h.level is None else [h.level, h.effect]
    for k, law in enumerate(laws):
        out[k] = max(out[k], law.lower(context, h.place))
    return out


def _beyond(residual: Residual, now: Posterior, h: Hypothesis) -> Bool[np.ndarray, " k"]:
    """Which numbers are at their bounds or beyond."""
    least = _least(residual, h)
    return np.isfinite(least) & (now.mean[now.part(h)] * h.scale <= least + 1e-12)


def within_bounds(
    residual: Residual, now: Posterior, held_at: Mapping[tuple, Bool[np.ndarray, " k"]]
) -> Posterior:
    """With its mean at the bounds of numbers that are held there, then at shares of errors that leave bodies."""
    at, values = [], []
    for h, part in zip(now.chosen, now.slices, strict=True):
        least = _least(residual, h)
        for k in np.flatnonzero(held_at[h.key]):
            at.append(part.start + int(k))
            values.append(float(least[k] / h.scale[k]))
    now = now.given(np.array(at, int), np.array(values))
    held = set(at)
    base = next((h for h in now.chosen if h.family == "tolerances"), None)
    if base is None:
        return now
    first = start = now.part(base).start
    bodies = []
    for change, _, pi in inertial_changes(residual.context, base.shape):
        bodies.append((change, pi, np.arange(start, start + change.shape[1])))
        start += change.shape[1]
    # What one body's bound moves may take another one beyond its own: until none is.
    while True:
        for change, pi, own in bodies:
            error = change @ (now.mean[own] * base.scale[own - first])
            if own[0] not in held and not bool(is_physical(jnp.asarray(pi - error))):
                break
        else:
            return now
        share = next(
            t for t in SHARES if t == 0.0 or bool(is_physical(jnp.asarray(pi - t * error)))
        )
        before = np.array(sorted(held), int)
        wanted = np.concatenate([now.mean[before], share * now.mean[own]])
        now = now.given(np.concatenate([before, own]), wanted)
        held |= set(own.tolist())
