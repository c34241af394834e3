"""How small an effect may be for a log to show it: below that, its absence is not known."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Parameter, Place
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.search.bank import Bank
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior
from jax_inertia.diagnosis.search.selection import Selection


def undetectable(selection: Selection) -> tuple[tuple[str, Place, Parameter], ...]:
    """Smallest size of each odd effect that this log would have shown, by family and place.

    With information s, everything chosen marginalised, of a number in units of its prior standard deviation, an effect
    of z of them gains ½ z² s²/(1 + s) − ½ ln(1 + s) nats: that has to pay the prior odds. Of what has a grid of
    nonlinear numbers, at its middle one; where those *are* the size, at the faintest that pays. Of a vector, along the
    axis that is seen best.
    """
    chosen = {h.key for h in selection.posterior.chosen}
    every: dict[tuple[str, str, str], list[Hypothesis]] = {}
    for c in selection.candidates:
        if c.named and c.is_odd and c.key not in chosen:
            every.setdefault(c.key, []).append(c)
    sizes = (_smallest(selection, group) for group in every.values())
    return tuple(
        (group[0].family, group[0].place, p)
        for group, p in zip(every.values(), sizes, strict=True)
        if p is not None
    )


MOST_AXES = 3
"""Numbers of a vector; of a body's ten, the first alone (a mass)."""


def _smallest(selection: Selection, group: list[Hypothesis]) -> Parameter | None:
    if group[0].effect.misses:
        return _faintest(selection, group)
    found = list(_along_axes(selection, group[len(group) // 2]))
    return min(found, key=lambda x: x[0])[1] if found else None


def _along_axes(selection: Selection, h: Hypothesis) -> Iterator[tuple[float, Parameter]]:
    """Along each of its axes: how many prior standard deviations have to be there, and what is reported of them."""
    # Beyond the ordinary number that it is one law with: that is an effect of its own.
    first = 0 if h.level is None else 1
    (every,) = information(selection.evidence, selection.posterior, [h])
    for axis in range(first, h.count if h.count <= MOST_AXES else 1):
        s = float(every[axis])
        if s <= 0:
            continue
        z = smallest(s, h.odds)
        theta = np.zeros(h.count)
        theta[axis] = z * h.scale[axis]
        if not h.possible(selection.residual, theta):
            continue
        nothing = h.numbers(selection.residual, 0.0 * theta)
        numbers = h.numbers(selection.residual, theta)
        shown = (p for name, p in numbers.items() if p.value != nothing[name].value)
        # Where a spring would rest that is not there is no number.
        if (p := next(shown, None)) is not None:
            yield z, p


def _faintest(selection: Selection, group: list[Hypothesis]) -> Parameter | None:
    """Of effects that are all there or not at all, the first number of the one that does least and still pays."""
    best, least = None, np.inf
    every = information(selection.evidence, selection.posterior, group)
    for h, (s, *_) in zip(group, every, strict=True):
        gain = 0.5 * s * float(h.prior_mean[0]) ** 2 - 0.5 * np.log1p(s) if s > 0 else -np.inf
        gain -= selection.evidence.unsaid(h)
        if h.odds < gain < least:
            best, least = h, gain
    if best is None:
        return None
    return next(iter(best.numbers(selection.residual, np.ones(1)).values()))


def smallest(s: float, odds: float) -> float:
    """How many prior standard deviations of a number with information s gain as much as the prior odds cost."""
    return float(np.sqrt((2.0 * odds + np.log1p(s)) * (1.0 + s)) / s)


def information(
    evidence: Evidence, now: Posterior, asked: Sequence[Hypothesis]
) -> list[Float[np.ndarray, " k"]]:
    """diag(AᵀA − AᵀX C XᵀA) of each of some: A its columns per prior standard deviation, X the chosen ones', C their
    covariance, both weighed by the residual's precision."""
    out = {
        int(i): np.diag(s) - 1.0
        for seen in evidence.seen_of(now, Bank(asked))[0]
        for i, s in zip(seen.at, seen.s, strict=True)
    }
    return [out[i] for i in range(len(asked))]
