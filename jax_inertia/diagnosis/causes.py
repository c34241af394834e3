"""Which of the effects that help to predict are causes: what pays for itself where slow misfit is no sample."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from jax_inertia.diagnosis.checks import PASSING, HeldOut, OtherRun, rms
from jax_inertia.diagnosis.effects.actuator import GainTolerance, TorqueGain
from jax_inertia.diagnosis.hypothesis import Hypothesis, hypothesis
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search.evidence import Posterior
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.logs.schema import TorqueKind


def borne_out(selection: Selection, judge: OtherRun | HeldOut) -> Selection:
    """The selection without odd effects that only mop up what no equation says exactly: no causes, if good to predict.

    `selection` has its noise's whole memory (`remembering`). The faintest first, one at a time, everything else
    refitted, until each has `evidence_of_cause` for its odds.
    """
    while True:
        spare = {id(h): evidence_of_cause(selection, judge, h) - h.odds for h in selection.odd}
        worst = min(selection.odd, key=lambda h: spare[id(h)], default=None)
        if worst is None or spare[id(worst)] >= 0.0:
            return selection
        selection = remembering(selection, selection.posterior.without(worst))


def evidence_of_cause(selection: Selection, judge: OtherRun | HeldOut, h: Hypothesis) -> float:
    """Log evidence that one of the chosen is a cause, prior odds apart, nats: the lesser of two.

    What it brings by parts of the log that have to tell the same (`Selection.robust_worth`), and what it brings against
    a slow discrepancy in its place, in both runs: to the log (`Evidence.loss`), and to rows that its numbers were not
    fitted to (`support`). Of an effect that happens once, neither other parts nor another run say anything.
    """
    now, loss = selection.posterior, selection.evidence.loss(selection.posterior, h)
    if h.family in PASSING:
        return min(float(selection.evidence.worths(now)[now.chosen.index(h)]), loss)
    return min(selection.robust_worth(h), loss + judge.support(now, h))


def remembering(selection: Selection, now: Posterior) -> Selection:
    """With another posterior, each uncertain gain in it, by noise that has its whole memory."""
    now = selection.evidence.posterior((*now.chosen, *_uncertain_gains(selection.residual, now)))
    evidence = selection.evidence.remembering(now)
    return dataclasses.replace(
        selection, evidence=evidence, posterior=evidence.posterior(now.chosen)
    )


def _uncertain_gains(residual: Residual, now: Posterior) -> Iterator[Hypothesis]:
    """Of each joint whose torque is a current times a constant, unless one is in it: by that its numbers may be off."""
    if residual.log.tau_kind is TorqueKind.CURRENT:
        effect = GainTolerance()
        there = {h.place.name for h in now.chosen if isinstance(h.effect, TorqueGain)}
        for place in effect.places(residual.context):
            if place.kind == "joint" and place.name not in there:
                yield hypothesis(residual, effect, place, (), 0.0)



def carried_over(now: Posterior, judge: OtherRun | HeldOut) -> Posterior:
    """The posterior without what makes it predict the other run worse than the model as it is, tolerances too.

    The worst first, one at a time, everything else refitted.
    """
    nominal = rms(judge.residual.y, judge.residual.weight)
    while judge.error(now) > nominal:
        asked = [h for h in now.chosen if h.family not in PASSING]
        errors = judge.errors_without(now, asked)
        now = now.without(asked[int(np.argmin(errors))])
    return now
