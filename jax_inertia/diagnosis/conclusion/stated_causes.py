"""Which effects of a selection are stated as causes, with their numbers, and what speaks against them."""

import dataclasses
from collections.abc import Collection, Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.certainty.causes import Judges, carried_over, odds_of_others, remembering
from jax_inertia.diagnosis.certainty.doubts import Doubts
from jax_inertia.diagnosis.checks import HeldOut, OtherRun, share
from jax_inertia.diagnosis.conclusion.listing import effects
from jax_inertia.diagnosis.corrected.handed_over import HandedOver
from jax_inertia.diagnosis.corrected.motor_gains import distinct
from jax_inertia.diagnosis.corrected.physical_bounds import physical
from jax_inertia.diagnosis.effects.actuator import GainTolerance
from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.diagnosis.hypothesis import Hypothesis, elsewhere
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.result import Found
from jax_inertia.diagnosis.search.evidence import Posterior
from jax_inertia.diagnosis.search.one_more import SETTLING
from jax_inertia.diagnosis.search.ordinary import bounded
from jax_inertia.diagnosis.search.refuted_tolerances import refuted
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import CalibrationState, Settings


@dataclasses.dataclass(frozen=True)
class Causes:
    """What is stated of a selection, and what speaks against it."""

    selection: Selection
    """With stand-ins."""
    told: Selection
    """With causes alone: its numbers are those that are stated."""
    likely: list[tuple[Hypothesis, Found]]
    ordinary: Posterior
    everything: Posterior
    """With the stand-ins that help to predict."""
    generic: list[Hypothesis]
    others: list[tuple[Hypothesis, float]]
    """Named effects that are no causes, and the log odds that each is there [nats]."""
    doubts: Doubts
    bent: tuple[str, ...]
    dropped: tuple[Hypothesis, ...]

    @property
    def now(self) -> Posterior:
        """Numbers of the causes."""
        return self.told.posterior

    def naming(self, keys: Collection[tuple[str, Place]]) -> "Causes":
        """The same where some effects, by family and place, are named after all: none of them is a doubt any more."""
        others = [(h, odds) for h, odds in self.others if (h.family, h.place) not in keys]
        doubts = self.doubts._replace(another=_any_of(others))
        return dataclasses.replace(self, others=others, doubts=doubts)

    def left(self, run: HeldOut, handed: HandedOver) -> Float[np.ndarray, "R n"]:
        """Residual of held-out rows by what is handed over [N m].

        What the files lose of the fit comes on top of what rows are predicted with by the others.
        """
        by_files = self.by_files(run.residual, handed)
        return run.left(self.now) + by_files - (run.residual.y - self.now.fitted)

    def by_files(self, residual: Residual, handed: HandedOver) -> Float[np.ndarray, "R n"]:
        """Residual of a log by what is handed over, less what is of that log alone [N m]."""
        left = handed.residual(residual) - self.of_log(residual)
        return left - handed.ringing(residual, left)

    def of_log(self, residual: Residual) -> Float[np.ndarray, "R n"]:
        """Torque of how a log is read, no part of the robot [N m]: when its torques and its wrenches acted, what feet
        that give and hold make of them. Fitted; of what each log has numbers of its own, nothing of another one.
        """
        out = np.zeros_like(residual.y)
        own = residual.log is self.told.residual.log
        for h in self.now.chosen:
            if h.effect.marginal and (own or not h.effect.of_log):
                theta = self.now.of(h)[0]
                there = h if own else elsewhere(h, residual)
                out += there.torque((theta - h.effect.of_links(theta)) / h.scale, out.shape)
        return out


def causes_of(
    selection: Selection,
    everything: Posterior,
    judges: Judges,
    dropped: tuple[Hypothesis, ...],
    settings: Settings,
) -> Causes:
    """Which effects of a selection are causes, by rows that choices may depend on; the last judge is the strictest."""
    now, evidence, residual = selection.posterior, selection.evidence, selection.residual
    ordinary = evidence.posterior(tuple(h for h in now.chosen if not h.is_odd))
    left = residual.y - now.fitted
    shares = {id(h): share(residual, left, now.torque(h)) for h in now.chosen}
    likely, doubtful = effects(selection, shares, judges, settings)
    generic = [h for h in now.chosen if h.is_odd and (not h.named or h in doubtful)]
    stated = without(selection, generic)
    residual, causes = _causes(stated, judges[-1], settings)
    # Where a secant was laid again it is another object of the same key.
    kept = {h.key: h for h in causes.chosen}
    likely = [(h if h in causes.chosen else kept[h.key], f) for h, f in likely if h.key in kept]
    told = dataclasses.replace(stated, residual=residual, posterior=causes)
    before = remembering(selection, everything)
    others = odds_of_others(before, causes, dropped, judges)
    bent = tuple(x.line for x in refuted(told, settings))
    worths = zip(now.chosen, evidence.worths(now), strict=True)
    unnamed = max((float(w) - h.odds for h, w in worths if h in generic), default=None)
    # A model that lacks its joints' friction is no sound one, even where a log determines none of the numbers.
    lacking = selection.state is CalibrationState.AS_BOUGHT
    doubts = Doubts(_any_of(others), bool(bent) or lacking, unnamed)
    return Causes(
        selection, told, likely, ordinary, everything, generic, others, doubts, bent, dropped
    )


def _any_of(others: Sequence[tuple[Hypothesis, float]]) -> float:
    """Odds that any one of some effects is there, of the log odds of each [nats]."""
    return float(np.exp(np.minimum([odds for _, odds in others], 50.0)).sum())


def without(selection: Selection, generic: Sequence[Hypothesis]) -> Selection:
    """The selection without shapes that name no cause, by the noise of rows that they are not taken from."""
    if not generic:
        return selection
    kept = tuple(h for h in selection.posterior.chosen if h not in generic)
    now = selection.evidence.posterior(kept)
    for _ in range(SETTLING):
        selection = remembering(selection, now)
        now = selection.posterior
    return selection


def _causes(
    selection: Selection, judge: HeldOut | OtherRun, settings: Settings
) -> tuple[Residual, Posterior]:
    """What the verdict is about, and whose numbers are stated: a shape that names no cause explains nothing.

    With the residual that has the loads of the robot as found.
    """
    causes, residual = selection.posterior, selection.residual
    causes = carried_over(bounded(residual, selection.evidence, causes), judge)
    causes = _at_stated_gains(causes, judge, settings)
    return physical(residual, selection.evidence, bounded(residual, selection.evidence, causes))


def _at_stated_gains(now: Posterior, judge: HeldOut | OtherRun, settings: Settings) -> Posterior:
    """With motors' gains at one, as the log has them, where they are not distinct from it and predict no better.

    How uncertain they are stays in every interval.
    """
    gains = [
        now.part(h)
        for h in now.chosen
        if isinstance(h.effect, GainTolerance) and not distinct(now, h, settings)
    ]
    if not gains:
        return now
    at = np.concatenate([np.arange(part.start, part.stop) for part in gains])
    stated = now.given(at, np.zeros(len(at)))
    return stated if judge.error(stated) <= (1.0 + settings.gate) * judge.error(now) else now
