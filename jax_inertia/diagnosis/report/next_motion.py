"""The motion to record next: what would tell apart what this log cannot, and show what it hardly shows."""

import dataclasses
from collections.abc import Callable, Iterable, Sequence

from jax_inertia.diagnosis.effects.advice import WIDE, Advice
from jax_inertia.diagnosis.effects.base import Effect, Place
from jax_inertia.diagnosis.effects.registry import EFFECTS


@dataclasses.dataclass(frozen=True)
class Suggestion:
    """A motion to record next."""

    between: tuple[str, str]
    where: str
    kind: str
    """A short stable name of the motion."""
    text: str
    numbers: dict[str, float]
    """By name with unit, such as `speed_below_rad_s`."""


def suggestions(
    pairs: Iterable[tuple[str, Place, str, Place]],
    peak: Callable[[str], float],
    extra: Sequence[Effect] = (),
) -> tuple[Suggestion, ...]:
    """One for each pair of effects (family, place, family, place) that another motion would split, without repeats.

    `peak`: the fastest usual speed of a joint in this log [rad/s].
    """
    out: dict[tuple[str, str], Suggestion] = {}
    for pair in pairs:
        one = _split(*pair, peak, (*EFFECTS, *extra))
        out.setdefault((one.kind, one.where), one)
    return tuple(out.values())


def _split(
    family: str, place: Place, other: str, elsewhere: Place, peak, library: Sequence[Effect]
) -> Suggestion:
    pair, where = (family, other), place.name
    if place != elsewhere:
        return Suggestion(
            pair,
            where,
            "one place at a time",
            f"Move so that {where} and {elsewhere.name} work separately: first one with the other held still, then the "
            "other, each over its whole range and through several reversals.",
            {"seconds_each": 10.0, "reversals_each": 6.0},
        )
    advice = _advice_between(*(e.advice for e in library if e.name in pair))
    numbers = dict(advice.numbers)
    if advice is WIDE:
        numbers = {"speed_rad_s": round(1.5 * peak(where), 2), **numbers}
    return Suggestion(pair, where, advice.kind, f"{asked(advice, where)}: {advice.why}.", numbers)


def _advice_between(*two: Advice) -> Advice:
    """The advice that both share, else one that tells an effect from any other, else to move in every way."""
    if len({a.kind for a in two}) == 1 and two[0].why:
        return two[0]
    return next((a for a in two if a.alone), WIDE)


def asked(advice: Advice, joint: str) -> str:
    """What to do, of a joint."""
    return advice.text.format(joint=joint)
