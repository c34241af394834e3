"""The numbers of a closed loop that fit: which effects are there, by evidence; Gauss–Newton rounds, judged by replays.

Each round makes columns at the numbers so far, chooses effects by adding and deleting (`evidence.selected`), and takes
the step as far as replays get better for it. First rounds are along the measured motion, which leads from any start;
where a step is short or gains little the next round is along the replay's own motion, which has no noise, and back.
The fit ends when neither leads on.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.likelihood.evidence import (
    Groups,
    Normal,
    Solved,
    additions,
    occam,
    selected,
    solve,
)
from jax_inertia.likelihood.rows import Likelihood, Rows, Weights

ROUNDS = 12
_STEPS = np.array([1.0, 0.6]), np.array([0.3, 0.1, 0.03])
"""Parts of a step: tried first, and where these are no better."""
_BOTH_WAYS = 2
"""First rounds, whose sets are sought from all ordinary numbers too."""
_ENOUGH = 0.005
"""Of the score, what a round gains at least that is worth another one."""
_LEADS = 0.3
"""Of the score, what a round gains at least after which the next one is along the same motion."""
_MOST, _FINALISTS, _FIRST = 6, 3, 4
"""Odd effects at most; of each turn, those that are fitted, and the rounds of such a fit."""
_DELAYS = (0.004, 0.01, 0.02, 0.035, 0.06, 0.1, 0.15)
"""Delays of all targets that are tried at the start [s]: none leads to another by small steps over a jump."""


class Rival(NamedTuple):
    """What was fitted in place of an odd effect, and was less likely along the linear response."""

    effect: int
    instead_of: int
    theta: Float[np.ndarray, " P"]


class Found(NamedTuple):
    """Numbers of a closed loop, and which effects are there."""

    theta: Float[np.ndarray, " P"]
    groups: Groups
    rivals: tuple[Rival, ...]
    """Of the same joints as the odd effects that were taken."""

    @property
    def there(self) -> Bool[np.ndarray, " P"]:
        """Which numbers are of effects that are there."""
        out = np.zeros(len(self.theta), bool)
        out[self.groups.rows_of(self.groups.there(self.theta))] = True
        return out


class _State(NamedTuple):
    """Numbers, what their replays err by, and the last round's normal equations."""

    theta: Float[np.ndarray, " P"]
    error: list[Float[np.ndarray, "T n"]]
    weights: Weights
    normal: Normal | None = None


def fitted(loop: Likelihood) -> Found:
    """The effects of most evidence and their numbers, from the model as given.

    Ordinary numbers first; then odd effects one by one, each with all others fitted anew, for as long as the replays'
    score asks for one: far from the right numbers a linear model is wrong, and many effects would mend it.
    """
    groups = Groups(loop.numbers)
    theta = np.zeros(len(loop.numbers))
    error = [e[0] for e in loop.errors(theta[None])]
    allowed = {*groups.ordinary, *groups.there(theta)}
    first = _State(theta, error, loop.weights(error))
    now = _converged(loop, groups, first, allowed, ROUNDS, with_delay=True)
    rivals: list[Rival] = []
    for k in range(_MOST):
        best, taken = now, -1
        lost: list[tuple[int, Float[np.ndarray, " P"]]] = []
        # What ordinary numbers, each far off, pass for is sought where they are not off yet, too.
        for state in (now, first) if k == 0 else (now,):
            for g in _promising(loop, groups, state, allowed):
                wider = allowed | {g} | groups.rivals[g]
                tried = _converged(
                    loop, groups, state, wider, _FIRST, added=g, with_delay=state is first
                )
                if _better(loop, groups, tried, best):
                    best, taken, tried, g = tried, g, best, taken
                lost.append((g, tried.theta))
        if best is now:
            break
        rivals += _rivals(groups, taken, lost)
        before = {*groups.there(now.theta)} - {*groups.ordinary}
        allowed = {*groups.ordinary, *groups.there(best.theta)}
        now = _converged(loop, groups, best, allowed, ROUNDS)
        if {*groups.there(now.theta)} - {*groups.ordinary} == before:
            break
    return Found(now.theta, groups, tuple(rivals))


def _rivals(
    groups: Groups, taken: int, lost: Sequence[tuple[int, Float[np.ndarray, " P"]]]
) -> list[Rival]:
    """Of the fits that lost a turn, the latest with each other effect of the joint or body that gained one."""

    def place(g: int) -> tuple[int, str]:
        number = groups.numbers[groups.rows[g][0]]
        return number.joint, number.body

    near = {g: x for g, x in lost if g >= 0 and g != taken and place(g) == place(taken)}
    return [Rival(g, taken, x) for g, x in near.items() if np.any(x[groups.rows[g]] != 0.0)]


def _better(loop: Likelihood, groups: Groups, new: _State, old: _State) -> bool:
    """Whether a fit's replays and its set are likelier than another's, by the noise that the closer one leaves."""
    close = min((new, old), key=lambda x: _total(loop, x.error))
    normal = close.normal or new.normal
    assert normal is not None
    thetas = np.stack([new.theta, old.theta])
    errors = [np.stack(e) for e in zip(new.error, old.error, strict=True)]
    scores = _scores(loop, groups, normal, thetas, errors, close.weights)
    return bool(scores[0] > scores[1])


def _promising(loop: Likelihood, groups: Groups, now: _State, allowed: set[int]) -> list[int]:
    """Odd effects that promise most evidence given all ordinary numbers, each of another kind or place."""
    others = {g for g in range(len(groups.rows)) if g not in allowed}
    if not others:
        return []
    rows = loop.rows(now.theta, now.error)
    beside = sorted(allowed & {*groups.together} | {*groups.there(now.theta)})
    w = loop.weights(rows.left(solve(rows.normal(now.weights), groups, beside).theta))
    gains = additions(rows.normal(w), groups, {*beside}, others)
    out: list[int] = []
    for gain, g in sorted(gains, key=lambda x: -x[0]):
        if gain > 0.0 and not groups.rivals[g] & {*out}:
            out.append(g)
    return out[:_FINALISTS]


def _converged(
    loop: Likelihood,
    groups: Groups,
    now: _State,
    allowed: set[int],
    rounds: int,
    *,
    added: int | None = None,
    with_delay: bool = False,
) -> _State:
    """Gauss–Newton rounds of numbers of some effects; each round's set by evidence, and its step by replays."""
    along_replay, vain = False, 0
    theta, error, w, normal = now
    asked = groups.rows_of([*allowed]).tolist()
    for k in range(rounds):
        rows = loop.rows(theta, error, along_replay=along_replay, asked=asked)
        if k == 0 and with_delay:
            rows = _with_delay(loop, groups, rows, asked)
        more = [added] if k == 0 and added is not None else []
        normal, ends, w = _chosen(loop, groups, rows, allowed, more, k < _BOTH_WAYS)
        score = _scores(loop, groups, normal, rows.theta[None], [e[None] for e in rows.error], w)[0]
        theta, error, gain, part = rows.theta, rows.error, 0.0, 0.0
        for parts in _STEPS:
            parts = np.tile(parts, len(ends))
            to = np.repeat([x.theta for x in ends], len(parts) // len(ends), axis=0)
            tries = rows.theta + parts[:, None] * (to - rows.theta)
            tried = loop.errors(tries)
            scores = _scores(loop, groups, normal, tries, tried, w)
            best = int(np.argmax(scores))
            if scores[best] > score:
                gain, part = float(scores[best] - score), float(parts[best])
                theta, error = tries[best], [e[best] for e in tried]
                break
        gain /= max(-float(score), 1.0)
        vain = vain + 1 if gain < _ENOUGH else 0
        if vain == 2:
            break
        if gain < _LEADS or part < _STEPS[0].min():
            along_replay = not along_replay
    return _State(theta, error, w, normal)


def _total(loop: Likelihood, error: Sequence[Float[np.ndarray, "T n"]]) -> float:
    return float(np.sqrt(np.mean(loop.rms(error) ** 2)))


def _scores(
    loop: Likelihood, groups: Groups, normal: Normal, thetas, errors, w: Weights
) -> Float[np.ndarray, " B"]:
    """Logarithm of likelihood and prior of each vector's replays, with what its set of effects costs [nats]."""
    cost = loop.squares(errors, w) + np.sum((thetas / groups.sd) ** 2, axis=1)
    price = np.array([occam(normal, groups, groups.there(x)) for x in thetas])
    return price - 0.5 * cost


def _chosen(
    loop: Likelihood,
    groups: Groups,
    rows: Rows,
    allowed: set[int],
    more: list[int],
    both_ways: bool,
) -> tuple[Normal, list[Solved], Weights]:
    """Sets of effects by evidence, best first, with the noise that they leave.

    Many numbers of a robot's links, each a little off, pass for one of its drives, and no single exchange leads from
    there: sought `both_ways`, from what is there and from all that is ordinary. Replays tell between the two.
    """
    w = loop.weights(rows.error)
    for _ in range(2):
        every = solve(rows.normal(w), groups, sorted({*groups.together, *more} & allowed))
        w = loop.weights(rows.left(every.theta))
    there = {*groups.there(rows.theta), *more}
    starts = [there, *([{*groups.ordinary, *there}] if both_ways else [])]
    reached = [selected(rows.normal(w), groups, [*start], allowed) for start in starts]
    reached.sort(key=lambda x: -x[1].evidence)
    w = loop.weights(rows.left(reached[0][1].theta))
    normal = rows.normal(w)
    ends = {tuple(x): y for x, y in (selected(normal, groups, x[0], allowed) for x in reached)}
    return normal, [*ends.values()], loop.weights(rows.left(next(iter(ends.values())).theta))


def _with_delay(loop: Likelihood, groups: Groups, rows: Rows, asked: list[int]) -> Rows:
    """Rows at the delay of all targets that leaves least once all numbers follow."""
    late = [k for k, n in enumerate(loop.numbers) if n.family == "target_delay" and n.joint < 0]
    if not late:
        return rows
    everything = groups.ordinary
    base, costs = loop.weights(rows.error), []
    for moved in (None, *loop.delayed(_DELAYS)):
        left = rows.error
        if moved is not None:
            left = [e - m for e, m in zip(rows.error, moved, strict=True)]
        normal = rows.normal(base, left)
        costs.append(normal.square - 2.0 * solve(normal, groups, everything).evidence)
    best = int(np.argmin(costs))
    if best == 0:
        return rows
    new = rows.theta.copy()
    new[late[0]] = _DELAYS[best - 1]
    return loop.rows(new, [e[0] for e in loop.errors(new[None])], asked=asked)
