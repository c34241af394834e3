"""What speaks against the effects that were found, in words: no verdict is in doubt without a word why."""

import numpy as np

from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.constancy import crowded
from jax_inertia.gap.doubt import leans_on
from jax_inertia.gap.other_motion import Trial
from jax_inertia.gap.outcome import Search
from jax_inertia.gap.together import misfit, remaining
from jax_inertia.gap.verdict import Verdict
from jax_inertia.text.words import named, percent

# An outsider says something of what is left from this share of it.
TELLING = 0.3
# Numbers of the model that are told to be beyond their tolerances, at most.
SHOWN = 3


def objections(
    search: Search,
    chosen: list[Candidate],
    verdict: Verdict,
    trial: Trial | None,
    beside: list[str],
    max_effects: int,
) -> tuple[str, ...]:
    """All of it, what other motions told (`beside`) first; empty where nothing does.

    `chosen`: those that stand of what the search found. `trial`: they, on another motion.
    """
    dropped = [
        f"{named(c.family.name, c.place)} fits this log, and where it was not fitted it does worse than the model alone"
        for c in search.chosen
        if len(chosen) < len(search.chosen) and not any(c.same_cause(x) for x in chosen)
    ]
    told = [*beside, *dropped]
    if verdict not in (Verdict.UNKNOWN, Verdict.PARTLY):
        return tuple(told)
    told += [*_what_it_leans_on(search, chosen, verdict), *_cut_short(chosen, max_effects)]
    return tuple(told or _what_is_left(search, chosen, trial))


def _what_it_leans_on(search: Search, chosen: list[Candidate], verdict: Verdict) -> list[str]:
    """What the log says of an effect that is not in the library."""
    beyond = [
        f"the log wants the model's {x}: the number is wrong, or stands for an effect that is not in the library"
        for x in search.strains[:SHOWN]
    ]
    if search.missed is not None:
        beyond.append(search.missed.at(search.pool.context.row_names[search.missed.row]))
    if search.inconstant is not None:
        beyond.append(f"{search.inconstant}: the cause resembles it and is not in the library")
    if (pushes := crowded(search.chosen)) is not None:
        names = " and ".join(c.place.name for c in pushes)
        beyond.append(
            f"forces in passing at {names}: likelier than two events is one cause that the library has no equation for"
        )
    if search.rival is not None:
        replaced, outsider = search.rival
        found = " and ".join(named(c.family.name, c.place) for c in replaced)
        does = f"fits better than {found}" if replaced else "explains what is there"
        return [*beyond, f"{outsider.name} {does}: the cause is not in the library"]
    outsider, share = leans_on(search.pool, chosen)
    if share < TELLING:
        return beyond
    return [
        *beyond,
        f"{outsider.name} takes {percent(share)} of what is left (energy against the noise): look there for what is "
        "not in the library",
    ]


def _what_is_left(search: Search, chosen: list[Candidate], trial: Trial | None) -> list[str]:
    """How much effects leave of a gap, where it resembles nothing."""
    pool = search.pool
    energy = pool.evidence.by_row(remaining(pool, chosen)) - search.noise_by_row
    gap = max(misfit(pool, []) - search.floor, 1e-300)
    here = _share(energy.sum() / gap)
    if trial is not None:
        tried = trial.misfit
        there = _share((tried.after - tried.floor) / max(tried.before - tried.floor, 1e-300))
        if there > here:
            return [
                f"of the other motion's gap {percent(there)} is left (energy against the noise), of this log's "
                f"{percent(here)}: more is missing there, or its noise is louder"
            ]
    return [
        f"{percent(here)} of the gap is left (energy against the noise), most of it at "
        f"{pool.context.row_names[int(np.argmax(energy))]}, and resembles nothing that is known here"
    ]


def _share(x: float) -> float:
    return float(np.clip(x, 0.0, 1.0))


def _cut_short(chosen: list[Candidate], max_effects: int) -> list[str]:
    """That no more effects were asked for than were found, where that may be why much is left."""
    if len(chosen) < max_effects:
        return []
    return [
        f"no more than {max_effects} {'effect was' if max_effects == 1 else 'effects were'} looked for: with more "
        "(--max-effects) more of it may be explained"
    ]
