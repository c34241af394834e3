"""What is said of a diagnosis, as an engineer would say it."""

from jax_inertia.diagnosis.result import Diagnosis, Found, Remainder, Shrink, Verdict
from jax_inertia.text import words
from jax_inertia.text.words import number, percent, plain, unit

MANY = 3
LEAST = 0.005
"""Share that is rounded to no per cent."""


def headline(found: Diagnosis, lacking: str, refuted: tuple[str, ...] = ()) -> str:
    """One to three sentences: what is missing, how far the error shrinks with it, what remains and where."""
    checked, remainder = found.checked, found.remainder
    where = {"other motion": "on the other run", "held out": "on held-out rows"}.get(
        found.checked_on, "on the validation run"
    )
    if found.verdict is Verdict.NO_GAP:
        return "No gap: model and robot agree within the sensors' noise and the model's tolerances."
    top = max(remainder.where, key=lambda n: remainder.where[n], default="")
    if not found.found and refuted:
        return (
            f"The model misses the robot by {number(checked.before)} N m, and what fits that is a number of its own: "
            f"{refuted[0]}."
        )
    if not found.found:
        return (
            f"The model misses the robot by {number(checked.before)} N m, mostly at {top}, and no effect that is "
            f"known here explains it{_resembled(remainder, checked)}."
        )
    parts = [*_outdone(checked, where)]
    parts += [f"The model has no {lacking} at any joint; the robot has."] if lacking else []
    odd = list(found.odd)
    shrunk = (
        f"{percent(max(checked.share, 0.0))} of the torque error {where} goes "
        f"({number(checked.before)} → {number(checked.after)} N m, sensors {number(checked.noise)})"
    )
    ordinary = any(f.ordinary for f in found.found)
    names = [named(f) for f in odd[:MANY]]
    more = f" and {len(odd) - MANY} more" if len(odd) > MANY else ""
    causes = ["each joint's friction, rotor inertia and offset"] if ordinary else []
    causes += names
    listed = causes[0] if len(causes) == 1 else ", ".join(causes[:-1]) + " and " + causes[-1]
    parts.append(f"With {listed}{more}, {shrunk}.")
    like = _resembled(remainder, checked)
    if found.verdict is not Verdict.EXPLAINED and (remainder.share > 0 or like):
        share = percent(remainder.share) if remainder.share >= LEAST else "Under 1 %"
        parts.append(f"{share} of its energy remains, mostly at {top}{like}.")
    return " ".join(parts)


def _outdone(checked: Shrink, where: str) -> tuple[str, ...]:
    """A sentence where less than this result predicts a run better."""
    others = {"the model as given": checked.before}
    if checked.least_squares is not None:
        others["plain least squares of four terms a joint"] = checked.least_squares
    best = min(others, key=lambda name: others[name])
    if others[best] >= checked.after:
        return ()
    errors = f"{number(others[best])} N m for {number(checked.after)}"
    return (f"{best[0].upper()}{best[1:]} errs less {where}: {errors}.",)


def _resembled(remainder: Remainder, checked: Shrink) -> str:
    """What the remainder looks like, if it is distinct from noise, and how much of it such shapes take."""
    if not remainder.resembles:
        return ""
    like = f", and resembles {remainder.resembles[0]}"
    if remainder.with_shapes < 0.9 * checked.after:
        like += (
            f"; such shapes, which name no cause, take it to {number(remainder.with_shapes)} N m"
        )
    return like


def named(f: Found) -> str:
    """Effect, place and its first number; of a vector its length."""
    name, p = next(iter(f.parameters.items()), ("", None))
    text = words.named(f.family, f.place)
    if p is None:
        return text
    vector = words.length(f.parameters)
    if vector is not None:
        return f"{text} ({number(vector)}{unit(p.unit)})"
    times = "× " if p.factor else ""
    model = f" for the model's {number(p.added_to)}" if p.added_to else ""
    return f"{text} ({plain(name)} {times}{number(p.whole.value)}{unit(p.unit)}{model})"
