"""Evidence of sets of effects in a linear Gaussian model, and the search by adding and deleting.

With target y = D z + noise, noise variance 1/w by row, prior z ~ N(0, S²), H = Dᵀ W D and b = Dᵀ W y, the logarithm of
the evidence of a set A relative to the empty one is (Laplace's, exact where the model is linear; MacKay 2003, ch. 28)

    ln p(A) = ½ b_Aᵀ C b_A − ½ ln det(1 + S H S),   C = (H_A + S_A⁻²)⁻¹          [nats]

plus each effect's prior log odds. Bounds hold the solution; a set whose best numbers lie outside is judged inside.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jax_inertia.likelihood.columns import Number

_ROUNDS = 200
_BETTER, _TRIED = 1e-6, 3
"""Least gain of a move [nats], and moves that are tried where bounds spoil what the best one promised."""


class Normal(NamedTuple):
    """Normal equations of all numbers about zero."""

    information: Float[np.ndarray, "P P"]
    """H."""
    pull: Float[np.ndarray, " P"]
    """b."""
    square: float
    """yᵀ W y."""


class Solved(NamedTuple):
    """Best numbers of a set, and how well they are known."""

    theta: Float[np.ndarray, " P"]
    covariance: Float[np.ndarray, "P P"]
    """0 for numbers that are not in the set."""
    evidence: float
    """ln p(set) − ln p(none) with prior odds [nats]."""


class Groups:
    """Numbers by effect: each effect comes and goes whole."""

    def __init__(self, numbers: Sequence[Number]):
        self.numbers = tuple(numbers)
        keys = dict.fromkeys(n.key for n in numbers)
        self.rows = [
            np.array([k for k, n in enumerate(numbers) if n.key == key], int) for key in keys
        ]
        places = [numbers[r[0]].place for r in self.rows]
        self.rivals = [
            {h for h, other in enumerate(places) if other == place and h != g}
            for g, place in enumerate(places)
        ]
        """Of each effect, those that stand in for it: of the same place, and of another shape."""
        self.odds = np.array([numbers[r[0]].odds for r in self.rows])
        self.always = np.array([numbers[r[0]].always for r in self.rows], bool)
        self.sd = np.array([n.sd for n in numbers])
        self.low = np.array([n.low for n in numbers])
        self.high = np.array([n.high for n in numbers])

    @property
    def ordinary(self) -> list[int]:
        """Effects that are as likely there as not."""
        return np.flatnonzero(self.odds >= 0.0).tolist()

    @property
    def together(self) -> list[int]:
        """Every effect, of those that stand in for each other the first."""
        return [g for g, others in enumerate(self.rivals) if not others or g < min(others)]

    def there(self, theta: Float[np.ndarray, " P"]) -> list[int]:
        """Effects of which some number is not zero, and those that are always there."""
        return [g for g, r in enumerate(self.rows) if self.always[g] or np.any(theta[r] != 0)]

    def rows_of(self, chosen: Sequence[int]) -> Int[np.ndarray, " a"]:
        """Numbers of some effects."""
        parts = [self.rows[g] for g in sorted(chosen)]
        return np.concatenate(parts) if parts else np.zeros(0, int)


def solve(normal: Normal, groups: Groups, chosen: Sequence[int]) -> Solved:
    """The best numbers of a set of effects within their bounds, and the set's evidence."""
    rows = groups.rows_of(chosen)
    count = len(groups.sd)
    theta, covariance = np.zeros(count), np.zeros((count, count))
    sd = groups.sd[rows]
    h = normal.information[np.ix_(rows, rows)] * np.outer(sd, sd)
    b = normal.pull[rows] * sd
    a = h + np.eye(len(rows))
    z = _bounded(a, b, groups.low[rows] / sd, groups.high[rows] / sd)
    theta[rows] = z * sd
    inverse = np.linalg.inv(a)
    covariance[np.ix_(rows, rows)] = inverse * np.outer(sd, sd)
    fit = float(b @ z - 0.5 * z @ a @ z)
    return Solved(theta, covariance, fit + occam(normal, groups, chosen))


def occam(normal: Normal, groups: Groups, chosen: Sequence[int]) -> float:
    """What a set costs beyond its fit: −½ ln det(1 + S H S) and its prior log odds [nats]."""
    rows = groups.rows_of(chosen)
    sd = groups.sd[rows]
    a = normal.information[np.ix_(rows, rows)] * np.outer(sd, sd) + np.eye(len(rows))
    return float(groups.odds[sorted(chosen)].sum()) - 0.5 * float(np.linalg.slogdet(a)[1])


def _bounded(a: np.ndarray, b: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Least of ½ zᵀ a z − bᵀ z within bounds, by active sets."""
    z = np.linalg.solve(a, b) if len(b) else np.zeros(0)
    if np.all((z >= low) & (z <= high)):
        return z
    at = np.zeros(len(b), int)
    for _ in range(_ROUNDS):
        free = at == 0
        fixed = np.where(at < 0, low, np.where(at > 0, high, 0.0))
        z = fixed.copy()
        if free.any():
            rest = b[free] - a[np.ix_(free, ~free)] @ fixed[~free]
            z[free] = np.linalg.solve(a[np.ix_(free, free)], rest)
        below, above = free & (z < low - 1e-12), free & (z > high + 1e-12)
        if below.any() or above.any():
            # The one that is furthest out is held first: others may come back by themselves.
            out = np.where(below, low - z, np.where(above, z - high, 0.0))
            k = int(np.argmax(out))
            at[k] = -1 if below[k] else 1
            continue
        gradient = b - a @ z
        wants_in = (at < 0) & (gradient > 1e-9) | (at > 0) & (gradient < -1e-9)
        if not wants_in.any():
            break
        at[int(np.argmax(np.abs(gradient) * wants_in))] = 0
    return np.clip(z, low, high)


def selected(
    normal: Normal,
    groups: Groups,
    start: Sequence[int] = (),
    allowed: Collection[int] | None = None,
) -> tuple[list[int], Solved]:
    """The set of effects of most evidence that adding, deleting and exchanging one at a time reaches from `start`.

    `allowed`: which effects may be in it; all where none are named.
    """
    allowed = range(len(groups.rows)) if allowed is None else allowed
    chosen = {int(g) for g in np.flatnonzero(groups.always)} | {*start}
    best = solve(normal, groups, [*chosen])
    for _ in range(_ROUNDS):
        away = _deletions(groups, chosen, best)
        # Far from the best set many go at once; near it one at a time, and others come.
        many = {g for gain, g in sorted(away)[-max(len(away) // 4, 1) :] if gain > 0}
        if len(many) > 1:
            tried = solve(normal, groups, [*chosen - many])
            if tried.evidence > best.evidence + _BETTER:
                chosen, best = chosen - many, tried
                continue
        moves = [(gain, {g}) for gain, g in additions(normal, groups, chosen, allowed) + away]
        better = _best_move(normal, groups, chosen, best, moves)
        if better is None:
            better = _best_move(
                normal, groups, chosen, best, _exchanges(normal, groups, chosen, away, allowed)
            )
        if better is None:
            break
        chosen, best = better
    return sorted(chosen), best


def _best_move(
    normal: Normal,
    groups: Groups,
    chosen: set[int],
    now: Solved,
    moves: list[tuple[float, set[int]]],
) -> tuple[set[int], Solved] | None:
    """The set after the move that promises most of (gain, effects that come or go), and its solution."""
    moves.sort(key=lambda x: -x[0])
    for gain, turned in moves[:_TRIED]:
        if gain <= _BETTER:
            return None
        tried = solve(normal, groups, [*chosen ^ turned])
        if tried.evidence > now.evidence + _BETTER:
            return chosen ^ turned, tried
    return None


def _exchanges(
    normal: Normal,
    groups: Groups,
    chosen: set[int],
    away: list[tuple[float, int]],
    allowed: Collection[int],
) -> list[tuple[float, set[int]]]:
    """(gain of evidence, effects) of one effect for another: for each odd one that is there, the best in its place."""
    out = []
    for gain, g in away:
        if groups.odds[g] < 0.0:
            added = additions(normal, groups, chosen - {g}, allowed)
            out += [(gain + more, {g, h}) for more, h in added if h != g]
    return out


def additions(
    normal: Normal, groups: Groups, chosen: set[int], allowed: Collection[int]
) -> list[tuple[float, int]]:
    """(gain of evidence, effect) of each effect that is not in the set, bounds of its own numbers apart."""
    rows = groups.rows_of([*chosen])
    sd = groups.sd
    h = normal.information * np.outer(sd, sd)
    b = normal.pull * sd
    inverse = np.linalg.inv(h[np.ix_(rows, rows)] + np.eye(len(rows)))
    across = inverse @ h[rows]
    left = h - h[:, rows] @ across
    pull = b - h[:, rows] @ (inverse @ b[rows])
    out, low, high = [], groups.low / sd, groups.high / sd
    size = np.diagonal(left) + 1.0
    z = np.clip(pull / size, low, high)
    alone = pull * z - 0.5 * size * z * z - 0.5 * np.log(np.maximum(size, 1.0))
    for g in allowed:
        own = groups.rows[g]
        if g in chosen or groups.rivals[g] & chosen:
            continue
        if len(own) == 1:
            out.append((float(alone[own[0]] + groups.odds[g]), g))
            continue
        a = left[np.ix_(own, own)] + np.eye(len(own))
        best = _bounded(a, pull[own], low[own], high[own])
        fit = float(pull[own] @ best - 0.5 * best @ a @ best)
        out.append((fit - 0.5 * float(np.linalg.slogdet(a)[1]) + float(groups.odds[g]), g))
    return out


def _deletions(groups: Groups, chosen: set[int], now: Solved) -> list[tuple[float, int]]:
    """(gain of evidence, effect) of taking each effect out."""
    out = []
    for g in chosen:
        if groups.always[g]:
            continue
        own = groups.rows[g]
        c, z = now.covariance[np.ix_(own, own)], now.theta[own]
        lost = 0.5 * float(z @ np.linalg.solve(c, z))
        # Of det(1 + S H S), an effect's own share is det S² / det C.
        size = float(np.sum(2.0 * np.log(groups.sd[own]))) - float(np.linalg.slogdet(c)[1])
        out.append((0.5 * size - lost - float(groups.odds[g]), g))
    return out
