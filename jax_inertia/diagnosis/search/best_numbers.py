"""Numbers of a hypothesis at their best: nonlinear ones uphill, secants where they stand, variances with them."""

import copy
import itertools
from collections.abc import Sequence

import numpy as np

from jax_inertia.diagnosis.effects.base import Shape
from jax_inertia.diagnosis.hypothesis import Hypothesis, reshaped
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior

MOST_MOVES = 4
"""Steps of one length that lead up: as far as the grid's next point."""
HALVINGS = 6
"""Of a pattern search's steps: to a sixtieth of the grid's spacing, less than what the log tells."""
ROUNDS, CONVERGED = 6, 0.5
"""Of variances and numbers in turn at most, and the change of log evidence [nats] from which there are no more."""
SECANTS, FEW = 30, 4
"""Moves of a secant at most, which end where it stands at the value found; and between two looks at the noise."""


def at_best(
    residual, evidence: Evidence, rest: Posterior, h: Hypothesis, every: Sequence[Hypothesis]
) -> Hypothesis:
    """The hypothesis at the nonlinear numbers of most evidence: uphill from its own and from other starts.

    `every` candidate of its family and place is a start, the best for each value of what no search moves: whether
    friction is the motor's or the link's, say, has its own optimum.
    """
    if h.effect.secant:
        return h
    steps = h.effect.steps(residual.context, h.place, h.shape)
    others = [c for c in every if c.key == h.key and not h.effect.many]
    gains = evidence.gains(rest, others) if others else np.zeros(0)
    if not np.any(steps):
        alone = float(evidence.gains(rest, (h,))[0])
        return others[int(np.argmax(gains))] if np.max(gains, initial=-np.inf) > alone else h
    starts = {_unmoved(h, steps): h}
    for k in np.argsort(gains)[::-1]:
        starts.setdefault(_unmoved(others[k], steps), others[k])
    climbed = [_between_points(residual, evidence, rest, start, steps) for start in starts.values()]
    return max(climbed, key=lambda found: found[1])[0]


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


def relinearised(
    residual,
    evidence: Evidence,
    rest: tuple[Hypothesis, ...],
    h: Hypothesis,
    *,
    most: int = SECANTS,
) -> Posterior:
    """The posterior with one more, its secant at the value found: exact for an offset of degrees, a long delay."""
    now = evidence.posterior((*rest, h))
    if not h.effect.secant:
        return now
    for _ in range(most):
        theta = now.of(now.chosen[-1])[0]
        if np.all(np.abs(theta - np.asarray(h.shape)) < 0.01 * h.scale):
            break
        h = reshaped(h, residual, tuple(float(x) for x in theta))
        now = evidence.posterior((*now.chosen[:-1], h))
    return now


def learned_with(residual, evidence: Evidence, now: Posterior) -> tuple[Evidence, Posterior]:
    """The evidence by variances learned with what is chosen, and the posterior: they are found in turn, best of two.

    From the variances that are there, and from the sensors' alone: by those that hold a whole gap, a prior outweighs
    what the log says of its cause; by those of the sensors, a cause that is not all of it is bent to be.
    """
    sharp = evidence.by_sensors_alone()
    bent = relinearised(residual, sharp, now.chosen[:-1], now.chosen[-1])
    starts = (evidence, now), (sharp, bent)
    found = (learned_in_turn(residual, start, after, ROUNDS) for start, after in starts)
    return max(found, key=lambda one: one[1].log_evidence)


def learned_in_turn(
    residual, evidence: Evidence, now: Posterior, rounds: int
) -> tuple[Evidence, Posterior]:
    """Variances and numbers in turn, until they stand."""
    before = -np.inf
    for _ in range(rounds):
        evidence = copy.copy(evidence)
        evidence.learn(now, memory=False)
        now = relinearised(residual, evidence, now.chosen[:-1], now.chosen[-1], most=FEW)
        if abs(now.log_evidence - before) < CONVERGED:
            break
        before = now.log_evidence
    return evidence, now
