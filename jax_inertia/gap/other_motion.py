"""The effects of a log, as they are, on another motion of the same robot.

What happened in passing (a push) need not happen again, nor at the same moment, nor as hard. It is expected where the
other motion shows it: as it was, if it fits there, else at the same place over a stretch that stands out, with the
force that fits. Only the first is a prediction, and counts as one in how far the gap shrinks.
"""

import copy
import dataclasses
from collections.abc import Iterator

import numpy as np
import scipy.optimize
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Shape
from jax_inertia.diagnosis.features.band import Band
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.gap import locate
from jax_inertia.gap.candidate import Candidate, effect_torque
from jax_inertia.gap.energies import Shrink
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.families.friction import DryFriction
from jax_inertia.gap.finder import LEAST
from jax_inertia.gap.motors import with_torque_noise
from jax_inertia.gap.noise import Whitener, whitener
from jax_inertia.gap.nuisance import Tolerance, nuisances
from jax_inertia.gap.outcome import Search
from jax_inertia.gap.propose import STOP
from jax_inertia.gap.shrink import Sight
from jax_inertia.gap.turning import REACHES, turning_over
from jax_inertia.gap.verdict import Tried, Verdict, second_look
from jax_inertia.logs.log import Log
from jax_inertia.model.robot import Robot
from jax_inertia.signals.torque_residual import prepare

# Of the shape of what happened at another time.
TRIES = 60
# Rows with more than this share of what is left on the row where most is are told of.
LOUD = 0.1

Way = tuple[Float[np.ndarray, "R nv"], Float[np.ndarray, " n"]]
"""An effect's torque here, finished, and the same charged."""


@dataclasses.dataclass(frozen=True)
class Trial:
    """The found effects on another motion."""

    shrink: Shrink
    misfit: Tried
    left: Float[np.ndarray, " n"]
    """What they leave, charged."""
    grown: float
    """Missing torque of all rows with the effects, over that without."""


@dataclasses.dataclass(frozen=True)
class Predicted:
    """The found effects as another motion shows them."""

    torques: list[Float[np.ndarray, "R nv"]]
    """Of each; of what passes only what was foretold."""
    left: Float[np.ndarray, " n"]
    """What they leave, charged."""
    misfit: Tried


class OtherMotion:
    """A test log, made ready once, to try effects on."""

    def __init__(self, robot: Robot, log: Log, tolerance: Tolerance, search: Search):
        prepared = prepare(robot, log)
        log = with_torque_noise(log, robot, search.torque_noise)
        own, replicas, again = whitener(prepared, log)
        context = Context(prepared, Band.of(prepared, again))
        # The errors that the first log showed beyond its sensors' are there on this one too.
        own = Whitener(own.sigma, (*own.stages, *search.white.stages[1:]))
        doubts = nuisances(context, tolerance, log)
        self._prepared, self._context = prepared, context
        first = search.pool.evidence
        self._known, self._replicas = search.known, replicas
        self._judge_by(Evidence(prepared, own, doubts, first.scales).pinning(first.pinned))

    def _judge_by(self, evidence: Evidence) -> None:
        self._evidence, self._floor = evidence, evidence.noise_energy(self._replicas)
        self._seen: dict[int, tuple[Candidate, list[Way]]] = {}

    def trial(self, chosen: list[Candidate], sight: Sight) -> Trial:
        """Missing torque, where the first log's gap is measured, and misfit with and without the effects."""
        evidence = self._evidence
        predicted = self._predicted(chosen)
        y = self._prepared.finish_torque(self._prepared.missing)
        after = y - sum(predicted.torques, np.zeros_like(y))
        return Trial(
            shrink=sight.shrink(evidence, sight.energies(evidence, y, after, self._replicas)),
            misfit=predicted.misfit,
            left=predicted.left,
            grown=grown(evidence, y, after),
        )

    def second_look(
        self, verdict: Verdict, trial: Trial, chosen: list[Candidate]
    ) -> tuple[Verdict, list[str]]:
        """The verdict on effects after they were tried on this motion, and what else it shows.

        Effects that fit in the rows where they act are causes, whatever the others show that the first log did not.
        """
        seen = second_look(verdict, trial.misfit)
        if seen is not Verdict.UNKNOWN or seen is verdict or any(c.family.passing for c in chosen):
            return seen, []
        acts = np.any([self._evidence.acted_on(self._finished(c)) for c in chosen], axis=0)
        used = self._evidence.used & acts
        if acts.all() or used.sum() < LEAST:
            return seen, []
        own = copy.copy(self)
        own._judge_by(self._evidence.among(used))
        misfit = own._predicted(chosen).misfit
        # Not only uncontradicted there: seen again.
        again = misfit.after - misfit.floor < 0.5 * (misfit.before - misfit.floor)
        if not again or second_look(verdict, misfit) is Verdict.UNKNOWN:
            return seen, []
        left = self._evidence.by_row(trial.left) * ~acts
        loud = np.flatnonzero(left > LOUD * left.max())
        names = {dof: name for name, dof in self._context.joint_dofs.items()}
        where = " and ".join(dict.fromkeys(names.get(j, "the base") for j in loud.tolist()))
        return Verdict.PARTLY, [
            f"the effects fit the other motion where they act; its gap at {where} is another, and not in this log"
        ]

    def _predicted(self, chosen: list[Candidate]) -> Predicted:
        """The effects, and what they leave."""
        evidence = self._evidence
        torques, left, allowed = [], evidence.y, 0.0
        for c in sorted(
            chosen, key=lambda c: (c.family.passing, isinstance(c.family, DryFriction))
        ):
            torque, charged = min(
                self._ways(c), key=lambda way: float(np.sum((left - way[1]) ** 2))
            )
            if c.family.passing:
                again = self._again(c, charged, left)
                if again is not charged:
                    torque, charged = np.zeros_like(torque), again
            torques.append(torque)
            left = left - charged
            allowed += c.excuses(charged)
        before, after = (float(x @ x) for x in (evidence.y, left))
        return Predicted(torques, left, Tried(before, after, self._floor, allowed, self._known))

    def _finished(self, c: Candidate) -> Float[np.ndarray, "R nv"]:
        return self._prepared.finish_torque(effect_torque(self._context, c))

    def _ways(self, c: Candidate) -> list[Way]:
        """An effect as it was; a dry friction also as it turns round over other displacements.

        A log that dwells where it turns round does not tell how soon its friction does. Kept: an effect is tried in
        one set of effects after another.
        """
        if id(c) not in self._seen:
            torques = [self._finished(c)]
            if isinstance(c.family, DryFriction):
                over = (turning_over(self._context, c, reach) for reach in REACHES)
                torques += [self._prepared.finish_torque(x) for x in over]
            # With the effect itself, which keeps its `id` its own.
            self._seen[id(c)] = c, [(x, self._evidence.charged(x)) for x in torques]
        return self._seen[id(c)][1]

    def _again(
        self, c: Candidate, same: Float[np.ndarray, " n"], left: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """What happened in passing, as it most likely happened here: the `same`, another time, or not at all."""

        def rest(effect: Float[np.ndarray, " n"]) -> float:
            return float(np.sum((left - effect) ** 2))

        most = float(left @ left)
        price = STOP * max(1.0, most / max(self._floor, 1.0))
        best, least = np.zeros_like(left), most - price
        if (left_over := rest(same)) < least:
            # What was foretold stands, unless another has to be paid for and is better still.
            best, least = same, left_over - price
        if least > self._floor:
            for effect in self._at_other_times(c, left):
                if (left_over := rest(effect)) < least:
                    best, least = effect, left_over
        return best

    def _at_other_times(
        self, c: Candidate, left: Float[np.ndarray, " n"]
    ) -> Iterator[Float[np.ndarray, " n"]]:
        """Over each stretch that stands out, with the force that fits."""
        context, evidence = self._context, self._evidence

        def fitted(shape: Shape) -> Float[np.ndarray, " n"]:
            columns = evidence.column(c.family.again(context, c.place, shape, c.theta))
            return columns @ np.linalg.lstsq(columns, left, rcond=1e-8)[0]

        context.windows = locate.windows(evidence, left, self._floor)
        for shape in c.family.shapes(context, c.place):
            found = scipy.optimize.minimize(
                lambda x: float(np.sum((left - fitted(tuple(x))) ** 2)),
                shape,
                method="Nelder-Mead",
                bounds=c.family.around(context, c.place, shape),
                options={"maxfev": TRIES},
            )
            yield fitted(tuple(found.x))


def grown(
    evidence: Evidence, before: Float[np.ndarray, "R nv"], after: Float[np.ndarray, "R nv"]
) -> float:
    """Finished torques' rms over all rows, after over before."""
    sizes = [float(np.linalg.norm(x[evidence.used])) for x in (after, before)]
    return sizes[0] / max(sizes[1], 1e-300)
