"""Predictive checks, never fitted: the residual of a run that played no part, and ties between hypotheses."""

import abc
import dataclasses
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.diagnosis.hypothesis import Hypothesis, elsewhere, excluded, hypothesis
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search import sensor_noise
from jax_inertia.diagnosis.search.bank import Bank
from jax_inertia.diagnosis.search.best_numbers import at_best, relinearised
from jax_inertia.diagnosis.search.candidates import pushes
from jax_inertia.diagnosis.search.discrepancy import SlowNoise
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior, scaled
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.logs.schema import TorqueKind

PASSING = frozenset({"push"})
"""Effects that happen once: on another run they are not there."""


@dataclasses.dataclass(frozen=True)
class Check:
    """Residual torque of a run [N m], rms over moving rows, before and after the effects."""

    before: float
    ordinary: float
    """With the ordinary effects alone, refitted."""
    after: float
    noise: float
    """Of the sensors, as stated or from samples, and of motors that miss their commands (`noise_of`)."""
    per_joint_before: Float[np.ndarray, " n"]
    per_joint_after: Float[np.ndarray, " n"]
    left: Float[np.ndarray, "R n"]
    """Residual after, along time."""
    expected: Float[np.ndarray, " n"]
    """What the sensors' noise and the equations' own errors leave of each row."""
    interval: tuple[float, float] = (0.0, 1.0)
    """95 % interval of 1 − after / before."""

    @property
    def excess(self) -> Float[np.ndarray, " n"]:
        """Residual of each row over what is expected of it."""
        return self.per_joint_after / np.maximum(self.expected, 1e-12)

    @property
    def after_excess(self) -> float:
        """Residual of all rows over what is expected of them."""
        whole = np.sqrt(np.mean([self.per_joint_after**2, self.expected**2], axis=1))
        return float(whole[0] / max(whole[1], 1e-12))

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
    ) -> Iterator[tuple[Bool[np.ndarray, " R"], Float[np.ndarray, "p p"]]]:
        """Rows that are predicted by one fit, and the covariance of its numbers."""

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
        weight, out = self.residual.weight, []
        least = np.maximum(self.residual.sensors, 1e-12)
        after = np.maximum(rows(self.left(now), weight), least)
        for left in self.left_without(now, asked):
            before = np.maximum(rows(left, weight), least)
            each = zip(weight.T, (left / before).T, strict=True)
            repeated = np.array([SlowNoise(w).likeliest(x).repeated for w, x in each])
            out.append(float(np.sum(weight.sum(axis=0) / repeated * np.log(before / after))))
        return out

    def expected(self, now: Posterior) -> Float[np.ndarray, " n"]:
        """Rms of each row that a right set of effects leaves on top of this run's noise [N m].

        Errors of the effects' own equations, and what is not known of all numbers, diag(A C Aᵀ): what the first run
        hardly shows, this one may show well.
        """
        own = tuple(h for h in now.chosen if h.effect.of_log)
        lasting = tuple(h for h in now.chosen if h.family not in PASSING and h not in own)
        there = tuple(elsewhere(h, self.residual) for h in lasting)
        whole = np.ones_like(self.residual.y)
        columns = scaled(there, whole).reshape(*whole.shape, -1)
        parts = map(now.part, lasting)
        at = np.array([k for p in parts for k in range(p.start, p.stop)], int)
        # Of numbers that each log has its own of, the prior is all that is known.
        anew = tuple(hypothesis(self.residual, h.effect, h.place, h.shape, h.odds) for h in own)
        variance = np.sum(scaled(anew, whole).reshape(*whole.shape, -1) ** 2, axis=-1)
        for rows_of_it, covariance in self.covariances(now):
            of_it = columns[rows_of_it]
            variance[rows_of_it] += np.sum((of_it @ covariance[np.ix_(at, at)]) * of_it, axis=-1)
        by_form = [(h.form_error * torque) ** 2 for h, torque in self.torques(now) if h.form_error]
        variance += np.sum(by_form, axis=0)
        return rows(np.sqrt(variance), self.residual.weight)

    def check(self, ordinary: Posterior, whole: Posterior) -> Check:
        """Before, with the ordinary effects, after."""
        y, weight = self.residual.y, self.residual.weight
        left = self.left(whole)
        noise = noise_of(self.residual, left)
        return Check(
            rms(y, weight),
            self.error(ordinary),
            rms(left, weight),
            rms(np.broadcast_to(noise, y.shape), weight),
            rows(y, weight),
            rows(left, weight),
            left,
            np.hypot(noise, self.expected(whole)),
            _interval(weight * y**2, weight * left**2),
        )


STRETCHES, DRAWS = 20, 1000
"""Of a run, drawn again with replacement, and how often."""


def _interval(
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
"""Of a joint's torque, rms: how far a motor is from its command at random. Torque ripple of servo drives: 1 to 3 %."""


def noise_of(residual: Residual, left: Float[np.ndarray, "R n"]) -> Float[np.ndarray, " n"]:
    """Standard deviation of each row's noise [N m]; `left`: what effects leave of it.

    That of the sensors. A command is exact and no sensor's: what its motor makes of it moves the robot and is not in
    the log, so there what is forgotten within two rows of the residual is noise too, as far as motors ripple: the
    thirty rows in which a joint moves, say, tell that from white noise by chance.
    """
    out = residual.sensors
    if residual.log.tau_kind is not TorqueKind.COMMANDED or residual.log.sigma_tau is not None:
        return out
    own, most = rows(left, residual.weight), RIPPLE * rows(residual.torque, residual.weight)
    unit = left / np.maximum(own, 1e-300)
    fits = [SlowNoise(w).likeliest(z) for w, z in zip(residual.weight.T, unit.T, strict=True)]
    short = own * np.sqrt([1.0 - fit.lasting for fit in fits])
    return np.maximum(out, np.minimum(short, most))


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

    def left(self, now: Posterior) -> Float[np.ndarray, "R n"]:
        """Residual of this run at numbers from the first."""
        return self.residual.y - np.sum([torque for _, torque in self.torques(now)], axis=0)

    def torques(self, now):
        """At numbers from the first run.

        What happens once and was found in the first may happen in this one too: when, and how hard, this one tells.
        """
        left = self.residual.y.copy()
        for h in now.chosen:
            if h.family not in PASSING and not h.effect.of_log:
                torque = elsewhere(h, self.residual).torque(now.mean[now.part(h)], left.shape)
                left -= torque
                yield h, torque
        for h in {h.key: h for h in now.chosen if h.family in PASSING}.values():
            torque = self._once_more(left, h)
            left = left - torque
            yield h, torque

    def _once_more(self, left: Float[np.ndarray, "R n"], h: Hypothesis) -> Float[np.ndarray, "R n"]:
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
        yield np.ones(len(self.residual.y), bool), now.covariance


class HeldOut(_Run):
    """The log itself, each of a few stretches predicted from the others; what happens once, by itself."""

    def __init__(self, selection: Selection, settings: Settings):
        self.evidence, self.residual = selection.evidence, selection.residual
        count = len(self.residual.y)
        self.fold = np.minimum(np.arange(count) * settings.folds // count, settings.folds - 1)

    def torques(self, now):
        return ((h, now.torque(h)) for h in now.chosen)

    def left(self, now: Posterior) -> Float[np.ndarray, "R n"]:
        """Residual of each stretch, fitted to the others."""
        return self._left(now, self._fits(now))

    def left_without(self, now, asked):
        fits = self._fits(now)
        return (self._left(now, [fit.without(h) for fit in fits]) for h in asked)

    def covariances(self, now):
        return ((self.fold == k, fit.covariance) for k, fit in enumerate(self._fits(now)))

    def shares(self, now: Posterior, asked: Sequence[Hypothesis]) -> list[float]:
        """Of the gap's energy, what returns without each of some that are chosen, by numbers of other stretches."""
        fits = self._fits(now)
        left = self._left(now, fits)
        return [share(self.residual, left, self._torque(now, fits, h)) for h in asked]

    def _fits(self, now: Posterior) -> list[Posterior]:
        """To all stretches but one, for each."""
        folds = range(int(self.fold[-1]) + 1)
        return [self.evidence.without(self.fold == k).posterior(now.chosen) for k in folds]

    def _left(self, now: Posterior, fits: list[Posterior]) -> Float[np.ndarray, "R n"]:
        left = self.residual.y - self._of_folds([fit.fitted for fit in fits])
        for h in (h for h in fits[0].chosen if h.family in PASSING):
            left += self._of_folds([fit.torque(h) for fit in fits]) - now.torque(h)
        return left

    def _torque(
        self, now: Posterior, fits: list[Posterior], h: Hypothesis
    ) -> Float[np.ndarray, "R n"]:
        """Of one of the chosen in every stretch, by numbers of the others."""
        if h.family in PASSING:
            return now.torque(h)
        return self._of_folds([fit.torque(h) for fit in fits])

    def _of_folds(self, every: list[Float[np.ndarray, "R n"]]) -> Float[np.ndarray, "R n"]:
        """Of what each fit says of the whole log, its own stretch."""
        return np.array(every)[self.fold, np.arange(len(self.fold))]


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


def told_apart(selection: Selection, judge: OtherRun, settings: Settings) -> Selection:
    """The selection with each odd effect that another motion speaks against the one of its ties that it speaks for.

    Two that one motion makes alike another may not: a friction and a constant torque, where a joint moved one way. One
    gives way to another that leaves less of the other run by `gate`.
    """
    for h in selection.odd:
        if not h.named or h.family in PASSING:
            continue
        now, rest = selection.posterior, selection.posterior.without(h)
        error = judge.error(now)
        if judge.error(rest) > error:
            continue
        own = selection.evidence.worths(now)[now.chosen.index(h)] - h.odds
        least, reach = (1.0 - settings.gate) * error, settings.reach(own)
        for rival in (r.hypothesis for r in rivals(selection, h, settings) if r.behind < reach):
            after = selection.evidence.posterior((*rest.chosen, rival))
            if (error := judge.error(after)) < least:
                least, selection = error, dataclasses.replace(selection, posterior=after)
    return selection


def _asked(now: Posterior) -> list[Hypothesis]:
    """Of what is chosen, what should be there on another run."""
    return [h for h in now.chosen if not h.effect.marginal and h.family not in PASSING]


MOST_RIVALS = 8
"""Ties that are looked for: a longer list tells a reader nothing."""
NEAR = 10.0
"""Nats beyond a tie up to which another hypothesis counts against a probability."""
BEYOND_SECANT = 0.3
"""Share of the evidence that a secant at the wrong value may miss."""


@dataclasses.dataclass(frozen=True)
class Rival:
    """Another hypothesis that explains about as much in the place of one that was chosen."""

    hypothesis: Hypothesis
    behind: float
    """By how much its log evidence is lower, odds counted, nats."""


def _at_other_places(residual: Residual, h: Hypothesis) -> tuple[Hypothesis, ...]:
    """What happens once, at the moments found, to each other body."""
    if h.family not in PASSING:
        return ()
    places = (p for p in h.effect.places(residual.context) if p != h.place)
    return tuple(hypothesis(residual, h.effect, p, h.shape, h.odds) for p in places)


def is_law_of(other: Hypothesis, h: Hypothesis) -> bool:
    """Whether one is the other with more numbers, as a Stribeck friction is a level friction with more at low speed."""
    return other.level is not None and other.level.name == h.family and other.place == h.place


def _no_more(now: Posterior, law: Hypothesis, settings: Settings) -> bool:
    """Whether what a law adds to its level is nowhere in the log more than next to nothing: it is no other friction."""
    mean, covariance = now.of(law)
    most = np.abs(mean) + 2.0 * np.sqrt(np.diag(covariance))
    size = np.max(np.abs(law.own_columns), axis=0) * most
    return bool(np.sum(size[1:]) < settings.ordinary_tolerance * size[0])


def rivals(selection: Selection, h: Hypothesis, settings: Settings) -> tuple[Rival, ...]:
    """Best shape of each other family and place, in the place of `h`, those within reach first."""
    now, evidence = selection.posterior, selection.evidence
    rest = now.without(h)
    banks = selection.named, Bank(_at_other_places(selection.residual, h))
    others, taken = [c for bank in banks for c in bank.candidates], {c.key for c in now.chosen}
    # What makes one likelier beforehand than its kind makes the others so: that something is there is known.
    usual = max((c.odds for c in selection.candidates if c.key == h.key), default=h.odds)
    own = float(evidence.gains(rest, (h,))[0]) - usual
    own -= sensor_noise.owed(selection.residual, evidence, rest, h)
    gains = np.concatenate([evidence.gains(now, bank, (h,)) - bank.odds for bank in banks])
    reach = settings.reach(own) + NEAR
    best: dict[tuple[str, str, str], Rival] = {}
    for k in np.argsort(-gains):
        c, behind = others[k], own - float(gains[k])
        if behind > reach + (BEYOND_SECANT * abs(own) if c.effect.secant else 0.0):
            continue
        if c.key in best or c.key in taken or excluded(selection.residual, c, rest.chosen):
            continue
        if len(best) == MOST_RIVALS:
            break
        with_it = relinearised(selection.residual, evidence, (*rest.chosen, c))
        c = with_it.chosen[-1]
        if c.effect.secant:
            behind = own - float(evidence.gains(rest, (c,))[0]) + c.odds
        if behind <= reach and c.possible(selection.residual, with_it.of(c)[0]):
            if is_law_of(c, h) and _no_more(with_it, c, settings):
                continue
            behind += sensor_noise.owed(selection.residual, evidence, rest, c)
            best[c.key] = Rival(c, behind)
    out = sorted(best.values(), key=lambda r: r.behind)
    return tuple(out)
