"""Predictive checks, never fitted: the residual of rows, or of a run, that played no part."""

import abc
import copy
import dataclasses
import functools
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from jax_inertia.diagnosis.hypothesis import Hypothesis, elsewhere, hypothesis
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search.best_numbers import at_best
from jax_inertia.diagnosis.search.candidates import pushes
from jax_inertia.diagnosis.search.discrepancy import SlowNoise
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior, scaled
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.diagnosis.verdict import Errors
from jax_inertia.logs.schema import TorqueKind
from jax_inertia.maths.sample_weight import odds_within

PASSING = frozenset({"push"})
"""Effects that happen once: on another run they are not there."""


@dataclasses.dataclass(frozen=True)
class Check:
    """Residual torque of a run [N m], rms over moving rows, before and after the effects."""

    errors: Errors
    """Of each row: floor, before and after, and what is stated of their discrepancy."""
    before: float
    after: float
    noise: float
    """Of the sensors, as stated or from samples, and of motors that miss their commands (`noise_of`)."""
    left: Float[np.ndarray, "R n"]
    """Residual after, along time."""
    weight: Float[np.ndarray, "R n"]

    def odds_within(self, limit: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
        """Log odds of each row that moves that its error is within a limit [nats]."""
        moves, counted = self.errors.moves, self.weight > 0
        scale = np.sqrt(counted.sum(axis=0) / np.maximum(self.weight.sum(axis=0), 1e-9))
        e = np.where(counted, scale * np.sqrt(self.weight) * self.left, np.nan)
        return odds_within(e[:, moves], limit[moves])

    @property
    def unexplained(self) -> float:
        """Share of the gap's energy above the sensors' noise that remains."""
        whole = max(self.before**2 - self.noise**2, 1e-300)
        return float(max(self.after**2 - self.noise**2, 0.0) / whole)


class _Run(abc.ABC):
    """Rows that are predicted and not fitted."""

    residual: Residual
    evidence: Evidence

    @abc.abstractmethod
    def torques(self, now: Posterior) -> Iterator[tuple[Hypothesis, Float[np.ndarray, "R n"]]]:
        """Torque of each of the chosen on this run [N m]."""

    @abc.abstractmethod
    def left(self, now: Posterior) -> Float[np.ndarray, "R n"]:
        """Residual of every row after everything chosen [N m]."""

    @abc.abstractmethod
    def covariances(
        self, now: Posterior
    ) -> Iterator[tuple[Bool[np.ndarray, "R n"], Float[np.ndarray, "p p"]]]:
        """Rows that are predicted by one fit, and the covariance of its numbers."""

    @abc.abstractmethod
    def parts(
        self, weight: Float[np.ndarray, "S n"]
    ) -> Iterator[tuple[Float[np.ndarray, "S n"], Bool[np.ndarray, "R n"]]]:
        """Weights of the log's rows that one fit sees, of `weight`, and rows of this run that it predicts."""

    def error(self, now: Posterior) -> float:
        """Residual after, rms over moving rows [N m]."""
        return rms(self.left(now), self.residual.weight)

    @abc.abstractmethod
    def left_without(
        self, now: Posterior, asked: Sequence[Hypothesis]
    ) -> Iterator[Float[np.ndarray, "R n"]]:
        """Residual of every row without each of some that are chosen, everything else refitted [N m]."""

    def errors_without(self, now: Posterior, asked: Sequence[Hypothesis]) -> list[float]:
        """Its rms over moving rows [N m]."""
        return [rms(left, self.residual.weight) for left in self.left_without(now, asked)]

    def support(self, now: Posterior, asked: Sequence[Hypothesis]) -> list[float]:
        """Log likelihood that each of some that are chosen brings to rows its numbers were not fitted to, nats.

            Σⱼ (Nⱼ / mⱼ) ln(σⱼ⁻ / σⱼ)

        σⱼ, σⱼ⁻: residual rms of row j with it and without, everything else refitted (a Gaussian's likelihood at its own
        variance); Nⱼ: rows; mⱼ: how many of them tell as much as one, of the residual without it, since a slow
        discrepancy may be in its place (`SlowNoise.repeated`).
        """
        after = self.left(now)
        return [self.likelier(after, left) for left in self.left_without(now, asked)]

    def ahead(self, now: Posterior, other: Posterior) -> float:
        """By how much rows its numbers were not fitted to are likelier by one posterior than by another, nats."""
        return self.likelier(self.left(now), self.left(other))

    def likelier(self, after: Float[np.ndarray, "R n"], before: Float[np.ndarray, "R n"]) -> float:
        """Σⱼ (Nⱼ / mⱼ) ln(σⱼ⁻ / σⱼ) of two residuals, mⱼ of the latter (`support`) [nats]."""
        weight, least = self.residual.weight, np.maximum(self.residual.sensors, 1e-12)
        own, other = (np.maximum(rows(x, weight), least) for x in (after, before))
        each = zip(weight.T, (before / other).T, strict=True)
        repeated = np.array([SlowNoise(w).likeliest(x).repeated for w, x in each])
        return float(np.sum(weight.sum(axis=0) / repeated * np.log(other / own)))

    def discrepancy(self, now: Posterior) -> Float[np.ndarray, " n"]:
        """Rms of each row that a right set of effects leaves on top of this run's noise [N m].

        Errors of the effects' own equations, and what is not known of all numbers, diag(A C Aᵀ): what the first run
        hardly shows, this one may show well.
        """
        own = tuple(h for h in now.chosen if h.effect.of_log)
        lasting = tuple(h for h in now.chosen if h.family not in PASSING and h not in own)
        columns = self._columns(tuple(elsewhere(h, self.residual) for h in lasting))
        parts = map(now.part, lasting)
        at = np.array([k for p in parts for k in range(p.start, p.stop)], int)
        # Of numbers that each log has its own of, the prior is all that is known.
        anew = tuple(hypothesis(self.residual, h.effect, h.place, h.shape, h.odds) for h in own)
        variance = np.sum(self._columns(anew) ** 2, axis=-1)
        for rows_of_it, covariance in self.covariances(now):
            of_it = columns[rows_of_it]
            variance[rows_of_it] += np.sum((of_it @ covariance[np.ix_(at, at)]) * of_it, axis=-1)
        by_form = [(h.form_error * torque) ** 2 for h, torque in self.torques(now) if h.form_error]
        variance += np.sum(by_form, axis=0)
        return rows(np.sqrt(variance), self.residual.weight)

    def _columns(self, there: tuple[Hypothesis, ...]) -> Float[np.ndarray, "R n p"]:
        """Columns of several effects on all rows of this run, per prior standard deviation [N m]."""
        whole = np.ones_like(self.residual.y)
        return scaled(there, whole).reshape(*whole.shape, -1)

    def check(self, now: Posterior, left: Float[np.ndarray, "R n"]) -> Check:
        """Before, and after what is handed over, which leaves `left` [N m]."""
        y, weight = self.residual.y, self.residual.weight
        noise = np.broadcast_to(noise_of(self.residual, left), (y.shape[1],))
        errors = Errors(
            tuple(self.residual.context.row_names),
            noise,
            rows(y, weight),
            rows(left, weight),
            weight.sum(axis=0) >= LEAST_ROWS,
            self.discrepancy(now),
        )
        every = rms(np.broadcast_to(noise, y.shape), weight)
        return Check(errors, rms(y, weight), rms(left, weight), every, left, weight)


LEAST_ROWS = 20
"""Moving rows of a joint from which they say something of it: five for each of its four ordinary numbers."""
STRETCHES, DRAWS = 20, 1000
"""Of a run, drawn again with replacement, and how often."""


def shrink_interval(
    before: Float[np.ndarray, "R n"], after: Float[np.ndarray, "R n"]
) -> tuple[float, float]:
    """95 % interval of 1 − √(Σ after / Σ before), energies of rows, whole stretches drawn again."""
    stretch = np.arange(len(before)) * STRETCHES // len(before)
    sums = [np.bincount(stretch, x.sum(axis=1), STRETCHES) for x in (before, after)]
    drawn = np.random.default_rng(0).integers(STRETCHES, size=(DRAWS, STRETCHES))
    was, left = (x[drawn].sum(axis=1) for x in sums)
    low, high = np.quantile(1.0 - np.sqrt(left / np.maximum(was, 1e-300)), [0.025, 0.975])
    return float(low), float(high)


RIPPLE = 0.03
"""Of a joint's peak torque: how far a motor is from its command at random, rms. Torque ripple of servo drives: 1 to 3 %
of what they are rated for, whatever a motion needs of it."""


def noise_of(residual: Residual, left: Float[np.ndarray, "R n"]) -> Float[np.ndarray, " n"]:
    """Standard deviation of each row's noise [N m]; `left`: what effects leave of it.

    That of the sensors. A command is exact and no sensor's: what its motor makes of it moves the robot and is not in
    the log, so there what is forgotten within two rows of the residual is noise too, as far as motors ripple: the
    thirty rows in which a joint moves, say, tell that from white noise by chance.
    """
    out = residual.sensors
    if residual.log.tau_kind is not TorqueKind.COMMANDED or residual.log.sigma_tau is not None:
        return out
    own = rows(left, residual.weight)
    most = RIPPLE * np.percentile(np.abs(residual.torque), 99.5, axis=0)
    unit = left / np.maximum(own, 1e-300)
    fits = [SlowNoise(w).likeliest(z) for w, z in zip(residual.weight.T, unit.T, strict=True)]
    short = own * np.sqrt([1.0 - fit.lasting for fit in fits])
    return np.maximum(out, np.minimum(short, most))


GUARD = 2
"""Rows on either side of a part that are left out with it: five rows are two periods of the chain's band."""
MOST_SEARCHES = 8
"""Of when something happens in another run: given other effects it was at about the same time, and a run is asked of
hundreds of sets of them."""


class OtherRun(_Run):
    """Another log of the same robot, predicted from the first."""

    def __init__(self, residual: Residual, evidence: Evidence):
        self.residual, self.evidence = residual, evidence
        self._moments: dict[tuple[str, str, str], tuple[Hypothesis, ...]] = {}
        self._searches: Counter[tuple[str, str, str]] = Counter()
        """How often moments between a grid's points were searched, of each effect."""

    def parts(self, weight):
        yield weight, np.ones(self.residual.y.shape, bool)

    def left(self, now: Posterior) -> Float[np.ndarray, "R n"]:
        """Residual of this run at numbers from the first."""
        return self.residual.y - np.sum([torque for _, torque in self.torques(now)], axis=0)

    def torques(self, now):
        """At numbers from the first run; what happens once, at numbers from this one."""
        left = self.residual.y.copy()
        for h in now.chosen:
            if h.family not in PASSING and not h.effect.of_log:
                torque = elsewhere(h, self.residual).torque(now.mean[now.part(h)], left.shape)
                left -= torque
                yield h, torque
        yield from self._passing(now, left)

    def once_more(self, now: Posterior, left: Float[np.ndarray, "R n"]) -> Float[np.ndarray, "R n"]:
        """Torque of passing effects in this run [N m], fitted to the residual `left` of all lasting effects.

        What was found in the first run may happen in this one too, and is no part of the robot: when, and how hard,
        this one tells.
        """
        return sum((torque for _, torque in self._passing(now, left)), np.zeros_like(left))

    def _passing(
        self, now: Posterior, left: Float[np.ndarray, "R n"]
    ) -> Iterator[tuple[Hypothesis, Float[np.ndarray, "R n"]]]:
        for h in {h.key: h for h in now.chosen if h.family in PASSING}.values():
            torque = self._again(left, h)
            left = left - torque
            yield h, torque

    def _again(self, left: Float[np.ndarray, "R n"], h: Hypothesis) -> Float[np.ndarray, "R n"]:
        """Torque of the same in this run, zero where its evidence does not pay its odds."""
        noise = np.sqrt(np.mean(self.evidence.noise.variance, axis=0))
        evidence = Evidence(left, self.residual.weight, noise)
        evidence.noise = dataclasses.replace(
            evidence.noise, variance=np.broadcast_to(noise**2, left.shape)
        )
        nothing = evidence.nothing()
        if h.key not in self._moments:
            every = pushes(self.residual, evidence, nothing, h.effect, self.residual.settings)
            self._moments[h.key] = tuple(c for c in every if c.key == h.key)
        moments = self._moments[h.key]
        gains = evidence.gains(nothing, moments) - [c.odds for c in moments]
        if not np.any(gains > 0):
            return np.zeros_like(left)
        best = moments[int(np.argmax(gains))]
        if self._searches[h.key] < MOST_SEARCHES:
            self._searches[h.key] += 1
            best = at_best(self.residual, evidence, nothing, best, ())
            self._moments[h.key] = (*moments, best)
        return evidence.posterior((best,)).fitted

    def left_without(self, now, asked):
        return (self.left(now.without(h)) for h in asked)

    def covariances(self, now):
        yield np.ones(self.residual.y.shape, bool), now.covariance


class HeldOut(_Run):
    """The log itself, each joint's rows in one part of its range predicted from the others; pushes by themselves.

    Parts of the range and not stretches of time: a motion comes by the same postures again, so the next stretch is
    predicted by the last one whatever is wrong with the equations, and another motion is not (`Settings.folds`).
    Rows next to those held out are left out of the fit too, as far as the chain's filter remembers.
    """

    def __init__(self, selection: Selection, settings: Settings):
        self.evidence, self.residual = selection.evidence, selection.residual
        context, y = selection.residual.context, selection.residual.y
        parts = np.arange(settings.folds) / settings.folds
        # Rows of a base have no range of their own.
        at = np.broadcast_to(np.linspace(0.0, 1.0, len(y))[:, None], y.shape).copy()
        for row in context.joint_dofs.values():
            at[:, row] = context.joint_position[selection.residual.prepared.kept, row]
        edges = np.quantile(at, parts[1:], axis=0)
        self.fold = np.sum(at[None] > edges[:, None], axis=0)

    def by_noise_of(self, evidence: Evidence) -> "HeldOut":
        """The same rows, predicted by fits to others under another noise."""
        out = copy.copy(self)
        out.evidence = evidence
        return out

    def _apart(self, k: int) -> Bool[np.ndarray, "R n"]:
        """Rows of a part, and those next to them that are left out with them."""
        return ndimage.binary_dilation(self.fold == k, np.ones((2 * GUARD + 1, 1), bool))

    def parts(self, weight):
        for k in range(int(self.fold.max()) + 1):
            yield np.where(self._apart(k), 0.0, weight), self.fold == k

    def torques(self, now):
        return ((h, now.torque(h)) for h in now.chosen)

    def left(self, now: Posterior) -> Float[np.ndarray, "R n"]:
        """Residual of each part, fitted to the others."""
        return self._left(now, self._fits(now))

    def left_without(self, now, asked):
        fits = self._fits(now)
        return (self._left(now, [fit.without(h) for fit in fits]) for h in asked)

    def covariances(self, now):
        return ((self.fold == k, fit.covariance) for k, fit in enumerate(self._fits(now)))

    def shares(self, now: Posterior, asked: Sequence[Hypothesis]) -> list[float]:
        """Of the gap's energy, what returns without each of some that are chosen, by numbers of other parts."""
        fits = self._fits(now)
        left = self._left(now, fits)
        return [share(self.residual, left, self._torque(now, fits, h)) for h in asked]

    def _fits(self, now: Posterior) -> list[Posterior]:
        """To all parts but one, for each."""
        for part in self._parts:
            part.noise = self.evidence.noise
        return [part.posterior(now.chosen) for part in self._parts]

    @functools.cached_property
    def _parts(self) -> list[Evidence]:
        """The rows of all parts but one, for each."""
        folds = range(int(self.fold.max()) + 1)
        return [self.evidence.without(self._apart(k)) for k in folds]

    def _left(self, now: Posterior, fits: list[Posterior]) -> Float[np.ndarray, "R n"]:
        left = self.residual.y - self._of_folds([fit.fitted for fit in fits])
        for h in (h for h in fits[0].chosen if h.family in PASSING):
            left += self._of_folds([fit.torque(h) for fit in fits]) - now.torque(h)
        return left

    def _torque(
        self, now: Posterior, fits: list[Posterior], h: Hypothesis
    ) -> Float[np.ndarray, "R n"]:
        """Of one of the chosen in every part, by numbers of the others."""
        if h.family in PASSING:
            return now.torque(h)
        return self._of_folds([fit.torque(h) for fit in fits])

    def _of_folds(self, every: list[Float[np.ndarray, "R n"]]) -> Float[np.ndarray, "R n"]:
        """Of what each fit says of the whole log, its own part."""
        return np.take_along_axis(np.array(every), self.fold[None], axis=0)[0]


def share(
    residual: Residual, left: Float[np.ndarray, "R n"], torque: Float[np.ndarray, "R n"]
) -> float:
    """Of the gap's energy, what returns to a residual when a torque is no longer taken from it."""
    whole = float((residual.weight * residual.y**2).sum())
    back = residual.weight * ((left + torque) ** 2 - left**2)
    return float(back.sum() / max(whole, 1e-300))


def rms(e: Float[np.ndarray, "R n"], weight: Float[np.ndarray, "R n"]) -> float:
    """Over all rows by weight."""
    return float(np.sqrt((weight * e**2).sum() / max(float(weight.sum()), 1e-9)))


def rows(e: Float[np.ndarray, "R n"], weight: Float[np.ndarray, "R n"]) -> Float[np.ndarray, " n"]:
    """Of each row by weight."""
    return np.sqrt((weight * e**2).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-9))


def gated(
    selection: Selection, judge: OtherRun | HeldOut, settings: Settings
) -> tuple[Selection, tuple[Hypothesis, ...]]:
    """The selection without effects that do not carry over to the other run, and those removed.

    The worst first, one at a time, everything else refitted: where an effect alone, an ordinary one too, raises the
    other run's error by `gate`, and while all odd effects together do worse than the ordinary ones by as much. Effects
    that happen once are not asked.
    """
    now, dropped = selection.posterior, []
    ordinary = judge.error(
        selection.evidence.posterior(tuple(h for h in now.chosen if not h.is_odd))
    )
    while True:
        asked = _asked(now)
        errors = dict(zip(map(id, asked), judge.errors_without(now, asked), strict=True))
        error = judge.error(now)
        worst = min(asked, key=lambda h: errors[id(h)], default=None)
        if worst is None or errors[id(worst)] >= error * (1.0 - settings.gate):
            odd = [h for h in asked if h.is_odd]
            worst = min(odd, key=lambda h: errors[id(h)], default=None)
            together = error > (1.0 + settings.gate) * ordinary
            if worst is None or not together or errors[id(worst)] >= error:
                return dataclasses.replace(selection, posterior=now), tuple(dropped)
        dropped.append(worst)
        now = now.without(worst)


def _asked(now: Posterior) -> list[Hypothesis]:
    """Of what is chosen, what should be there on another run."""
    return [h for h in now.chosen if not h.effect.marginal and h.family not in PASSING]
