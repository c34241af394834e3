"""Nonlinear numbers of a hypothesis at their best: uphill between a grid's points, secants at the value found."""

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
CLOSE, ROUNDS = 0.01, 20
"""Prior standard deviations by which a secant may be off, and how often it is laid again at most."""
FURTHEST = 3.0
"""Times its last move that one secant goes beyond its own value, where moves point one way."""


def at_best(
    residual, evidence: Evidence, rest: Posterior, h: Hypothesis, every: Sequence[Hypothesis]
) -> Hypothesis:
    """The hypothesis at the nonlinear numbers of most evidence: uphill from its own and from other starts.

    `every` candidate of its family and place that explains anything is a start, the best for each value of what no
    search moves: whether friction is the motor's or the link's, say, has its own optimum. Of those that a robot can
    have, if any.
    """
    if h.effect.secant:
        return _own_value(residual, evidence, rest, h, every)
    steps = steps_of(residual, h)
    if not np.any(steps):
        return h
    starts = {_unmoved(h, steps): h}
    others = [c for c in every if c.key == h.key and not h.effect.many]
    gains = evidence.gains(rest, others) if others else []
    for k in (k for k in np.argsort(gains)[::-1] if gains[k] > 0.0):
        starts.setdefault(_unmoved(others[k], steps), others[k])
    climbed = [_between_points(residual, evidence, rest, start, steps) for start in starts.values()]
    laid = sorted(
        (_laid(residual, evidence, rest, *found) for found in climbed), key=lambda found: -found[1]
    )
    best = (x for x, _ in laid if _there(residual, evidence, rest, x))
    return laid[0][0] if len(laid) == 1 else next(best, laid[0][0])


MOST_SECANTS, FEW_ROUNDS = 4, 4
"""Of one effect, the best as they are laid, which are asked about their own value, and how often each is laid again."""


def _own_value(
    residual, evidence: Evidence, rest: Posterior, h: Hypothesis, every: Sequence[Hypothesis]
) -> Hypothesis:
    """The secant that explains most at its own value: one that is laid elsewhere may explain what none there does."""
    alike = [c for c in every if c.key == h.key]
    if len(alike) < 2:
        return h
    order = np.argsort(-evidence.gains(rest, alike))[:MOST_SECANTS]
    laid = [_alone(residual, evidence, rest, alike[k]) for k in order]
    best = sorted(laid, key=lambda x: -float(evidence.gains(rest, (x,))[0]))
    # None that a robot can have is refused where it is laid, not where it is not.
    return next((x for x in best if _there(residual, evidence, rest, x)), best[0])


def _alone(residual, evidence: Evidence, rest: Posterior, h: Hypothesis) -> Hypothesis:
    """A secant about where it would be, those of the others as they are."""
    for _ in range(FEW_ROUNDS):
        value = h.effect.at_value(h.shape, evidence.posterior((*rest.chosen, h)).of(h)[0])
        at, found = np.array(h.shape), np.array(value)
        if _close(h, at, found) or not np.all(np.isfinite(found)):
            break
        h = reshaped(h, residual, tuple(value))
    return h


def _there(residual, evidence: Evidence, rest: Posterior, h: Hypothesis) -> bool:
    """Whether a robot can have the hypothesis at its likeliest size."""
    after = evidence.posterior((*rest.chosen, h))
    return h.possible(residual, after.of(h)[0])


def _laid(
    residual, evidence: Evidence, rest: Posterior, h: Hypothesis, gain: float
) -> tuple[Hypothesis, float]:
    """With nonlinear numbers that are θ's own at the value found: forms that are alike at none differ there."""
    if h.effect.at_value(h.shape, h.scale) == h.shape:
        return h, gain
    laid = relinearised(residual, evidence, (*rest.chosen, h)).chosen[-1]
    return laid, float(evidence.gains(rest, (laid,))[0])


def steps_of(residual, h: Hypothesis) -> Shape:
    """First steps of the search for its nonlinear numbers; 0 of those that are not searched."""
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
    """The nonlinear numbers of most evidence near those of a hypothesis: a pattern search (Hooke and Jeeves).

    J. ACM 8(2), 1961: along each number in turn, then as far again as all of them went, along a valley of several.
    """
    best, gain = h, float(evidence.gains(rest, (h,))[0])
    context = residual.context_of(h.effect)

    def led(shape: np.ndarray) -> bool:
        nonlocal best, gain
        turned_over = np.any(shape * np.array(best.shape) < 0)
        if turned_over or not h.effect.within(context, h.place, tuple(shape.tolist())):
            return False
        trial = reshaped(h, residual, tuple(shape.tolist()))
        got = float(evidence.gains(rest, (trial,))[0])
        if not np.isfinite(got) or got <= gain:
            return False
        best, gain = trial, got
        return True

    for step in (np.asarray(steps) * 0.5**k for k in range(HALVINGS)):
        moving = np.flatnonzero(step)
        for _ in range(MOST_MOVES):
            base = np.array(best.shape)
            for k in moving:
                one = step[k] * np.eye(len(step))[k]
                if not led(np.array(best.shape) - one):
                    led(np.array(best.shape) + one)
            if best.shape == tuple(base.tolist()):
                break
            if len(moving) > 1:
                led(2.0 * np.array(best.shape) - base)
    return best, gain


def relinearised(residual, evidence: Evidence, chosen: tuple[Hypothesis, ...]) -> Posterior:
    """The posterior with every secant at the value found: exact for an offset of degrees, a long delay.

    Laid again and again where it is found, g(x) → x, it may come nearer by a tenth each time, from either side. So two
    moves tell where the next one ends (Anderson, J. ACM 12(4), 1965, of depth one).
    """
    now = evidence.posterior(chosen)
    before: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for _ in range(ROUNDS):
        moved = list(now.chosen)
        for k, h in enumerate(now.chosen):
            value = h.effect.at_value(h.shape, now.of(h)[0])
            if value == h.shape:
                continue
            at, found = np.array(h.shape), np.array(value)
            if _close(h, at, found) or not np.all(np.isfinite(found)):
                continue
            ahead = _extrapolated(h, at, found, *before[k]) if k in before else found
            before[k] = at, found
            ahead = ahead if _possible(residual, h, ahead) else found
            moved[k] = reshaped(h, residual, tuple(ahead.tolist()))
        if tuple(moved) == now.chosen:
            break
        now = evidence.posterior(tuple(moved))
    return now


def _possible(residual, h: Hypothesis, shape: np.ndarray) -> bool:
    """Whether a robot can have θ where nonlinear numbers that are its own are these."""
    own = shape if h.effect.secant else shape[-1:]
    return h.effect.possible(residual.context, h.place, own)


def _extrapolated(h: Hypothesis, at, found, at_before, found_before) -> np.ndarray:
    """Where g(x) = x by the last two values, x and g each."""
    unit = _unit(h)
    last, before = (found - at) / unit, (found_before - at_before) / unit
    turned = last - before
    share = float(turned @ last) / max(float(turned @ turned), 1e-300)
    return found - np.clip(share, -FURTHEST, 1.0) * (found - found_before)


def _close(h: Hypothesis, at: np.ndarray, found: np.ndarray) -> bool:
    """Whether nonlinear numbers that are θ's own are at the value found."""
    return bool(np.all(np.abs(found - at) < CLOSE * _unit(h)))


def _unit(h: Hypothesis) -> np.ndarray:
    """Prior standard deviation of those numbers."""
    return h.scale if h.effect.secant else h.scale[-1:]
