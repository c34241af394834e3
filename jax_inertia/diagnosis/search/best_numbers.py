"""Nonlinear numbers of a hypothesis at their best: uphill between a grid's points, secants at the value found."""

import itertools
from collections.abc import Sequence

import numpy as np

from jax_inertia.diagnosis.effects.base import Shape
from jax_inertia.diagnosis.effects.dry_friction import DryFriction
from jax_inertia.diagnosis.hypothesis import Hypothesis, reshaped
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior

MOST_MOVES = 4
"""Steps of one length that lead up: as far as the grid's next point."""
HALVINGS = 6
"""Of a pattern search's steps: to a sixtieth of the grid's spacing, less than what the log tells."""
CLOSE, ROUNDS = 0.01, 4
"""Prior standard deviations by which a secant may be off, and how often it is laid again."""


def at_best(
    residual, evidence: Evidence, rest: Posterior, h: Hypothesis, every: Sequence[Hypothesis]
) -> Hypothesis:
    """The hypothesis at the nonlinear numbers of most evidence: uphill from its own and from other starts.

    `every` candidate of its family and place is a start, the best for each value of what no search moves: whether
    friction is the motor's or the link's, say, has its own optimum.
    """
    steps = () if h.effect.secant else _steps(residual, h)
    if not np.any(steps):
        return h
    starts = {_unmoved(h, steps): h}
    others = [c for c in every if c.key == h.key and not h.effect.many]
    gains = evidence.gains(rest, others) if others else []
    for k in np.argsort(gains)[::-1]:
        starts.setdefault(_unmoved(others[k], steps), others[k])
    climbed = [_between_points(residual, evidence, rest, start, steps) for start in starts.values()]
    return max(climbed, key=lambda found: found[1])[0]


def _steps(residual, h: Hypothesis) -> Shape:
    steps = h.effect.steps(residual.context, h.place, h.shape)
    if isinstance(h.effect, DryFriction) and not h.fills:
        # All forms of a friction that every hypothesis has turn round as it does.
        return (0.0, *steps[1:])
    return steps


def _unmoved(h: Hypothesis, steps: Shape) -> Shape:
    """What of its nonlinear numbers no search between the grid's points moves."""
    return tuple(x for x, step in zip(h.shape, steps, strict=True) if not step)


def _between_points(
    residual, evidence: Evidence, rest: Posterior, h: Hypothesis, steps: Shape
) -> tuple[Hypothesis, float]:
    """The hypothesis at the nonlinear numbers of most evidence near its own, and that: a pattern search."""
    best, gain = h, float(evidence.gains(rest, (h,))[0])
    for step in (np.asarray(steps) * 0.5**k for k in range(HALVINGS)):
        for k, sign in itertools.product(np.flatnonzero(step), (-1.0, 1.0)):
            # On while it leads up: an optimum may be several steps from the grid's point.
            for _ in range(MOST_MOVES):
                shape = list(best.shape)
                shape[k] += float(sign * step[k])
                if shape[k] * best.shape[k] < 0 or not h.effect.within(tuple(shape)):
                    break
                trial = reshaped(h, residual, tuple(shape))
                got = float(evidence.gains(rest, (trial,))[0])
                if not np.isfinite(got) or got <= gain:
                    break
                best, gain = trial, got
    return best, gain


def relinearised(residual, evidence: Evidence, chosen: tuple[Hypothesis, ...]) -> Posterior:
    """The posterior with every secant at the value found: exact for an offset of degrees, a long delay."""
    now = evidence.posterior(chosen)
    for _ in range(ROUNDS):
        moved = tuple(_at_its_value(residual, now, h) for h in now.chosen)
        if moved == now.chosen:
            break
        now = evidence.posterior(moved)
    return now


def _at_its_value(residual, now: Posterior, h: Hypothesis) -> Hypothesis:
    """Nonlinear numbers that are θ's own at the value found, where that is another by a hundredth of its scale."""
    shape = h.effect.at_value(h.shape, now.of(h)[0])
    if shape == h.shape:
        return h
    away = np.abs(np.subtract(shape, h.shape))
    if np.all(away < CLOSE * (h.scale if h.effect.secant else h.scale[-1])):
        return h
    return reshaped(h, residual, shape)
