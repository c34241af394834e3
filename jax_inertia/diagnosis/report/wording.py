"""What is said of a diagnosis, as an engineer would say it."""

from jax_inertia.diagnosis.result import Found, Remainder, Shrink, Verdict
from jax_inertia.text import words
from jax_inertia.text.words import number, percent, plain, unit

MANY = 3
LEAST = 0.005
"""Share that is rounded to no per cent."""


def headline(
    verdict: Verdict,
    found: tuple[Found, ...],
    shrinks: tuple[Shrink, Shrink | None],
    remainder: Remainder,
    lacking: str,
    refuted: tuple[str, ...] = (),
) -> str:
    """One to three sentences: what is missing, how far the error shrinks with it, what remains and where."""
    heldout, test = shrinks
    checked = heldout if test is None else test
    where = "on held-out stretches" if test is None else "on the other run"
    if verdict is Verdict.NO_GAP:
        return "No gap: model and robot agree within the sensors' noise and the model's tolerances."
    top = max(remainder.where, key=lambda n: remainder.where[n], default="")
    if not found and refuted:
        return (
            f"The model misses the robot by {number(checked.before)} N m, and what fits that is a number of its own: "
            f"{refuted[0]}."
        )
    if not found:
        return (
            f"The model misses the robot by {number(checked.before)} N m, mostly at {top}, and no effect that is "
            f"known here explains it{_resembled(remainder, checked)}."
        )
    parts = [f"The model has no {lacking} at any joint; the robot has."] if lacking else []
    odd = [f for f in found if not f.ordinary]
    by_cause = 1.0 - remainder.after / max(checked.before, 1e-300)
    shrunk = (
        f"{percent(max(by_cause, 0.0))} of the torque error {where} goes "
        f"({number(checked.before)} → {number(remainder.after)} N m, sensors {number(checked.noise)})"
    )
    ordinary = any(f.ordinary for f in found)
    names = [named(f) for f in odd[:MANY]]
    more = f" and {len(odd) - MANY} more" if len(odd) > MANY else ""
    causes = ["each joint's friction, rotor inertia and offset"] if ordinary else []
    causes += names
    listed = causes[0] if len(causes) == 1 else ", ".join(causes[:-1]) + " and " + causes[-1]
    parts.append(f"With {listed}{more}, {shrunk}.")
    like = _resembled(remainder, checked)
    if verdict is not Verdict.EXPLAINED and (remainder.share > 0 or like):
        share = percent(remainder.share) if remainder.share >= LEAST else "Under 1 %"
        parts.append(f"{share} of its energy remains, mostly at {top}{like}.")
    return " ".join(parts)


def _resembled(remainder: Remainder, checked: Shrink) -> str:
    """What the remainder looks like, if it is distinct from noise, and how much of it such shapes take."""
    if not remainder.resembles:
        return ""
    like = f", and resembles {remainder.resembles[0]}"
    if checked.after < 0.9 * remainder.after:
        like += f"; such shapes, which name no cause, take it to {number(checked.after)} N m"
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
    return f"{text} ({plain(name)} {times}{number(p.value)}{unit(p.unit)})"
