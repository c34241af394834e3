"""Which of the effects that help to predict are causes: what pays for itself where slow misfit is no sample."""

import dataclasses
from collections.abc import Collection, Iterator, Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.checks import PASSING, HeldOut, OtherRun, rms
from jax_inertia.diagnosis.effects.actuator import GainTolerance, TorqueGain
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.diagnosis.hypothesis import Hypothesis, hypothesis
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search.evidence import Posterior
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.logs.schema import TorqueKind

Judges = Sequence[OtherRun | HeldOut]


def judges_of(heldout: HeldOut, other: OtherRun | None) -> Judges:
    """Rows that numbers were not fitted to: held-out rows, and the other run where there is one."""
    return [heldout] if other is None else [heldout, other]


def borne_out(selection: Selection, judges: Judges) -> Selection:
    """The selection without odd effects that only mop up what no equation says exactly: no causes, if good to predict.

    `selection` has its noise's whole memory (`remembering`). The faintest first, one at a time, everything else
    refitted, until each brings its odds (`evidence_of_causes`). What happens at the same moments as more of its kind
    elsewhere goes before: by an equation that errs one push leaves others at bodies next to it.
    """
    now, context = selection.posterior, selection.residual.context
    for h in _echoes(context, selection.evidence.worths(now), now.chosen):
        selection = remembering(selection, selection.posterior.without(h))
    while True:
        worst = _faintest(selection.odd, evidence_of_causes(selection, selection.odd, judges))
        if worst is None:
            return selection
        selection = remembering(selection, selection.posterior.without(worst))


def _echoes(
    context: Context, worths: Float[np.ndarray, " m"], chosen: Sequence[Hypothesis]
) -> list[Hypothesis]:
    """Of the chosen what happens once while the same of more evidence happens at another place."""
    ranked = sorted(zip(worths, chosen, strict=True), key=lambda x: -x[0])
    out, kept = [], []
    for _, h in ranked:
        if h.family in PASSING:
            (kept if all(_apart(context, h, c) for c in kept) else out).append(h)
    return out


def _faintest(odd: Sequence[Hypothesis], evidence: Sequence[float]) -> Hypothesis | None:
    """The one that falls furthest short of its odds, if any does."""
    spare = [e - h.odds for e, h in zip(evidence, odd, strict=True)]
    return odd[int(np.argmin(spare))] if min(spare, default=0.0) < 0.0 else None


def evidence_of_causes(
    selection: Selection, asked: Sequence[Hypothesis], judges: Judges
) -> list[float]:
    """Log evidence that each of some that are chosen is a cause, prior odds apart, nats.

    The less of what the log brings by its parts (`by_parts`) and of what numbers bring to what they were not fitted
    to: rows of all judges (`_Run.support`), and the nominal model, whose numbers are measured too (`strain`): one far
    beyond its tolerance may predict as well as a load does. The latter is not asked where a model is calibrated: a
    discrepancy as large as an effect is no part of such a model. Nor of what happens once.
    """
    parts = by_parts(selection, asked)
    if _exact(selection):
        return parts
    lasting = [h for h in asked if h.family not in PASSING]
    now = selection.posterior
    every = np.sum([judge.support(now, lasting) for judge in judges], axis=0)
    every = every + [strain(now.without(h)) - strain(now) for h in lasting]
    supports = dict(zip(map(id, lasting), every.tolist(), strict=True))
    return [min(p, supports.get(id(h), np.inf)) for h, p in zip(asked, parts, strict=True)]


def odds_of_others(
    selection: Selection, causes: Posterior, refuted: Collection[Hypothesis], judges: Judges
) -> list[tuple[Hypothesis, float]]:
    """Named effects that are not among the causes, with the log odds that each is there [nats], the likeliest first.

    Log evidence − prior odds of what was chosen and is no cause, and of what else may be there; each has to be a cause
    (`evidence_of_causes`). What happens as a cause does, at another place, is its echo; what another run `refuted` is
    not there.
    """
    now, context = selection.posterior, selection.residual.context
    there = {h.key for h in causes.chosen}
    gone = [h for h in now.chosen if h.is_odd and h.named and h.key not in there]
    once = [h for h in causes.chosen if h.family in PASSING]
    gone = [h for h in gone if all(_apart(context, h, c) for c in once)]
    evidence = evidence_of_causes(selection, gone, judges)
    others = [(h, e - h.odds) for h, e in zip(gone, evidence, strict=True)]
    barred = {h.key for h in (*now.chosen, *refuted)}
    for odds, h, with_it in selection.further(barred):
        one_more = dataclasses.replace(selection, posterior=with_it)
        (told,) = evidence_of_causes(one_more, (h,), judges)
        others.append((h, min(odds, told - h.odds)))
    return sorted(others, key=lambda other: -other[1])


def _apart(context: Context, a: Hypothesis, b: Hypothesis) -> bool:
    """Whether two are no echoes of each other."""
    return a.family != b.family or a.effect.apart(context, a.place, a.shape, b.shape)


def strain(now: Posterior) -> float:
    """½ Σ z² of what the model may be off by, z in tolerances: minus the log likelihood of its own numbers, nats."""
    off = [now.mean[now.part(h)] for h in now.chosen if h.effect.marginal]
    return float(0.5 * np.sum(np.concatenate(off) ** 2)) if off else 0.0


def by_parts(selection: Selection, asked: Sequence[Hypothesis]) -> list[float]:
    """Log evidence that each of some that are chosen brings where parts of the log have to tell the same, nats.

    Prior odds apart. Of an effect that happens once parts say nothing: of it, what it brings against a slow discrepancy
    in its place (`Evidence.loss`). A calibrated model's equations are stated to be right: as far as its residual is the
    sensors' noise the whole log pays the odds, and its parts must not refute it.
    """
    now, evidence, out = selection.posterior, selection.evidence, []
    worths = dict(zip(map(id, now.chosen), evidence.worths(now), strict=True))
    for h in asked:
        if h.family in PASSING:
            robust = evidence.loss(now, h)
        else:
            robust = selection.robust_worth(h)
            if _exact(selection):
                robust += h.odds * _by_sensors(selection, h)
        out.append(min(float(worths[id(h)]), robust))
    return out


def _exact(selection: Selection) -> bool:
    """Whether equations are right: a calibrated model's, but forces of the ground that are not measured have none."""
    return selection.evidence.exact and selection.residual.prepared.support is None


def _by_sensors(selection: Selection, h: Hypothesis) -> float:
    """Share of the residual's variance that is the sensors', on the rows that show a hypothesis most."""
    evidence, now = selection.evidence, selection.posterior
    shown = np.sum(evidence.precision * now.torque(h) ** 2, axis=0)
    variance = np.mean(evidence.noise.variance, axis=0)
    shares = np.minimum(selection.residual.sensors**2 / variance, 1.0)
    return float(shown @ shares / max(float(np.sum(shown)), 1e-300))


def remembering(selection: Selection, now: Posterior) -> Selection:
    """With another posterior, each uncertain gain in it, by noise that has its whole memory."""
    # A calibrated model's friction and weights were identified by these torques: its gains are calibrated with it.
    if not selection.evidence.exact:
        gains = _uncertain_gains(selection.residual, now)
        now = selection.evidence.posterior((*now.chosen, *gains))
    evidence = selection.evidence.remembering(now)
    return dataclasses.replace(
        selection, evidence=evidence, posterior=evidence.posterior(now.chosen)
    )


def _uncertain_gains(residual: Residual, now: Posterior) -> Iterator[Hypothesis]:
    """Of each joint whose torque is a current times a constant, unless one is in it: by that its numbers may be off.

    Torques of a leg that stands say what the robot weighs: a gain there passes for weight, and is as the log has it.
    """
    if residual.log.tau_kind is TorqueKind.CURRENT:
        effect = GainTolerance()
        there = {h.place.name for h in now.chosen if isinstance(h.effect, TorqueGain)}
        for place in effect.places(residual.context):
            weighs = residual.prepared.spreads(place.index)
            if place.kind == "joint" and place.name not in there and not weighs:
                yield hypothesis(residual, effect, place, (), 0.0)


def carried_over(now: Posterior, judge: OtherRun | HeldOut) -> Posterior:
    """The posterior without what makes it predict the other run worse than the model as it is, tolerances too.

    The worst first, one at a time, everything else refitted; then each of those again that helps with the others gone:
    what one of them did harm with may have been another's.
    """
    nominal = rms(judge.residual.y, judge.residual.weight)
    gone = []
    while judge.error(now) > nominal:
        asked = [h for h in now.chosen if h.family not in PASSING]
        errors = judge.errors_without(now, asked)
        gone.append(asked[int(np.argmin(errors))])
        now = now.without(gone[-1])
    while gone:
        each = [judge.evidence.posterior((*now.chosen, h)) for h in gone]
        errors = [judge.error(p) for p in each]
        best = int(np.argmin(errors))
        if errors[best] >= judge.error(now):
            break
        now = each[best]
        gone.pop(best)
    return now
