"""The motion to record next: what would tell apart what this log cannot, and show what it hardly shows."""

import dataclasses
from collections.abc import Callable, Iterable, Sequence

from jax_inertia.diagnosis.effects.advice import ALONE, ANOTHER, WIDE, Advice
from jax_inertia.diagnosis.effects.base import Effect, Interval, Place
from jax_inertia.diagnosis.effects.registry import EFFECTS
from jax_inertia.diagnosis.result import Diagnosis, Verdict
from jax_inertia.text.words import plain


@dataclasses.dataclass(frozen=True)
class Suggestion:
    """A motion to record next."""

    between: tuple[str, ...]
    """Effects that it tells apart, or the one that it shows."""
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


def next_step(found: Diagnosis, wanted: Sequence[Suggestion]) -> str:
    """One sentence: what to do with this result."""
    if found.verdict is Verdict.NO_GAP:
        return "Keep the model: this log shows nothing to correct in it."
    better = found.checked.after < found.checked.before
    use = "Use corrected.xml in place of the model"
    if found.verdict is Verdict.EXPLAINED:
        check = " and check it on another motion (--test-log)" if found.test is None else ""
        return f"{use}{check}."
    top = max(found.remainder.where, key=lambda n: found.remainder.where[n], default="")
    start = (
        f"{use}, which is closer to the robot, and look" if better else "Keep the model, and look"
    )
    more = ": record the first motion that is suggested" if wanted else ""
    return f"{start} for the rest of the error at {top}{more}."


UNTOLD = ("viscous_friction", "coulomb_friction", "armature")
"""Ordinary numbers that no joint is without."""


def to_record(found: Diagnosis, extra: Sequence[Effect] = ()) -> tuple[Suggestion, ...]:
    """What to record next of a whole robot: where two causes tie, where something remains, what no joint showed."""
    pairs = (
        (f.family, f.place, tie.family, tie.place)
        for f in found.odd
        for tie in f.equivalent
        if tie.kind == "motion_limited"
    )
    out = list(suggestions(pairs, lambda joint: found.speed.get(joint, 0.0), extra))
    if found.verdict in (Verdict.PARTLY, Verdict.UNKNOWN):
        top = max(found.remainder.where, key=lambda n: found.remainder.where[n])
        out.append(
            Suggestion(
                (), top, ALONE.kind, f"{asked(ALONE, top)}: {ALONE.why}.", dict(ALONE.numbers)
            )
        )
    for effect in (e for e in EFFECTS if e.name in UNTOLD):
        joints = [n for n, own in found.joints.items() if _is_open(own[effect.name])]
        if joints:
            where = ", ".join(joints)
            text = f"{plain(effect.name)} of {where} is not determined by this log. {asked(effect.advice, where)}."
            numbers = dict(effect.advice.numbers)
            out.append(Suggestion((effect.name,), where, effect.advice.kind, text, numbers))
    if found.test is None and found.verdict is not Verdict.NO_GAP:
        text = f"{ANOTHER.text}: {ANOTHER.why}."
        out.append(Suggestion((), "", ANOTHER.kind, text, dict(ANOTHER.numbers)))
    return tuple(out)


def _is_open(p: Interval) -> bool:
    """Whether a number's interval holds zero."""
    return bool(p.low <= 0.0 < p.high)


def asked(advice: Advice, joint: str) -> str:
    """What to do, of a joint."""
    return advice.text.format(joint=joint)
