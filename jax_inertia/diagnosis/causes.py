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
from jax_inertia.diagnosis.settings import CalibrationState
from jax_inertia.logs.schema import TorqueKind


def borne_out(selection: Selection) -> Selection:
    """The selection without odd effects that only mop up what no equation says exactly: no causes, if good to predict.

    `selection` has its noise's whole memory (`remembering`). Each has to pay its odds by parts of the log that tell the
    same (`Selection.robust_worth`), and against a slow discrepancy in its place (`Evidence.loss`). The faintest first,
    one at a time, everything else refitted. Effects that happen once are not asked of the log's parts.
    """
    while True:
        worths = [_sure_worth(selection, h) - h.odds for h in selection.odd]
        faintest = sorted(zip(worths, selection.odd, strict=True), key=lambda x: x[0])
        worst = next((h for w, h in faintest if not _pays(selection, h, w)), None)
        if worst is None:
            return selection
        selection = remembering(selection, selection.posterior.without(worst))


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


def _sure_worth(selection: Selection, h: Hypothesis) -> float:
    now = selection.posterior
    own = float(selection.evidence.worths(now)[now.chosen.index(h)])
    if h.family in PASSING:
        return own
    robust = selection.robust_worth(h)
    # Of a calibrated model equations are exact: the whole log pays the odds, and its parts must not refute it.
    return min(own, robust + h.odds) if selection.state is CalibrationState.CALIBRATED else robust


def _pays(selection: Selection, h: Hypothesis, worth: float) -> bool:
    if selection.state is CalibrationState.CALIBRATED:
        # Its equations are stated to be right: a discrepancy as large as any effect is no part of such a model.
        return worth >= 0.0
    return worth >= 0.0 and selection.evidence.loss(selection.posterior, h) >= h.odds


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
