"""How far the gap shrinks: held out on the log itself, and on another motion."""

import dataclasses

import numpy as np

from jax_inertia.gap import nuisance
from jax_inertia.gap.chain import prepare
from jax_inertia.gap.context import Context
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.families.base import Columns
from jax_inertia.gap.noise import Whitener, stated, whitener
from jax_inertia.gap.nuisance import Tolerance
from jax_inertia.gap.pool import Candidate, effect_torque
from jax_inertia.gap.search import Search
from jax_inertia.gap.verdict import Tried
from jax_inertia.log import Log
from jax_inertia.robot import Robot


@dataclasses.dataclass(frozen=True)
class Shrink:
    """Root mean square of the missing torque over all rows [N m]: before, after, and what no model removes."""

    before: float
    after: float
    noise: float

    @property
    def share(self) -> float:
        """1 − after/before, both with the noise taken off."""
        gap = max(self.before**2 - self.noise**2, 1e-300)
        return 1.0 - float(np.sqrt(max(self.after**2 - self.noise**2, 0.0) / gap))


def _rms(x: np.ndarray, rest: np.ndarray) -> float:
    """Over rows in motion: friction at rest is arbitrary, and no model's to predict."""
    return float(np.sqrt(np.mean(x[~rest] ** 2)))


def held_out(prepared, context, pool, chosen, replicas) -> Shrink:
    """Missing torque before and after, each fifth of the log predicted from the other four."""
    rest = context.at_rest[prepared.kept] | ~prepared.valid
    y = prepared.finish_torque(prepared.missing)
    noise = float(np.sqrt(np.mean(np.asarray(replicas)[:, ~rest] ** 2)))
    after = what_is_left(prepared, context, pool, chosen)
    return Shrink(_rms(y, rest), _rms(after, rest), noise)


def what_is_left(prepared, context, pool, chosen, folds: int = 5) -> np.ndarray:
    """Missing torque that remains (R, nv), each fold predicted from the others; a push as it was fitted."""
    y = prepared.finish_torque(prepared.missing)
    after = y.copy()
    if chosen:
        flat = np.repeat(np.arange(len(y)) * folds // len(y), y.shape[1])
        columns = np.concatenate([c.columns for c in chosen], axis=1)
        target = pool.evidence.y - np.sum([c.offset for c in chosen], axis=0)
        full = [prepared.finish_torque(effect_torque(context, c)) for c in chosen]
        own = np.concatenate([c.theta for c in chosen])
        for fold in range(folds):
            train = flat != fold
            theta = np.linalg.lstsq(columns[train], target[train], rcond=None)[0]
            scale = _share_of(theta, own, chosen)
            # What happened once, in this fold, cannot be predicted from the others.
            scale = [1.0 if c.family.passing else s for c, s in zip(chosen, scale, strict=True)]
            rows = np.arange(len(y)) * folds // len(y) == fold
            for part, s in zip(full, scale, strict=True):
                after[rows] -= s * part[rows]
    return after


def _share_of(theta: np.ndarray, own: np.ndarray, chosen: list[Candidate]) -> list[float]:
    """How large each effect comes out of a fold, relative to the whole log's."""
    out, start = [], 0
    for c in chosen:
        part = slice(start, start + len(c.theta))
        # Without θ there is nothing for a fold to scale.
        size = float(own[part] @ own[part])
        out.append(float(theta[part] @ own[part]) / size if size > 0 else 1.0)
        start += len(c.theta)
    return out


@dataclasses.dataclass(frozen=True)
class Trial:
    """The found effects, as they are, on another motion."""

    shrink: Shrink
    misfit: Tried


class OtherMotion:
    """A test log, made ready once, to try effects on; what happened in passing is not expected again."""

    def __init__(self, robot: Robot, log: Log, tolerance: Tolerance, white: Whitener):
        prepared = prepare(robot, log)
        context = Context(prepared)
        own, self._replicas, _ = whitener(prepared, log)
        # The errors that the first log showed beyond its sensors' are there on this one too.
        own = Whitener(own.sigma, (*own.stages, *white.stages[1:]))
        columns = nuisance.columns(context, tolerance, 1.0 / log.rate)
        self._prepared, self._context = prepared, context
        self._evidence = Evidence(prepared, own, columns)
        self._stated = stated(log)

    def trial(self, chosen: list[Candidate]) -> Trial:
        """Missing torque and misfit with and without the effects."""
        prepared, context, evidence = self._prepared, self._context, self._evidence
        rest = context.at_rest[prepared.kept] | ~prepared.valid
        y = prepared.finish_torque(prepared.missing)
        lasting = [c for c in chosen if not c.family.passing]
        effects = [effect_torque(context, c) for c in lasting]
        after = y - sum((prepared.finish_torque(e) for e in effects), np.zeros_like(y))
        noise = float(np.sqrt(np.mean(np.asarray(self._replicas)[:, ~rest] ** 2)))
        charged = [evidence.column(Columns(e[:, :, None]))[:, 0] for e in effects]
        left = evidence.y - sum(charged, np.zeros_like(evidence.y))
        return Trial(
            shrink=Shrink(_rms(y, rest), _rms(after, rest), noise),
            misfit=Tried(
                before=float(evidence.y @ evidence.y),
                after=float(left @ left),
                floor=float(np.mean([evidence.noise_energy(x) for x in self._replicas])),
                allowed=sum(
                    c.family.form_error**2 * float(e @ e)
                    for c, e in zip(lasting, charged, strict=True)
                ),
                stated=self._stated,
            ),
        )


# Chance and the nominal model's own errors may undo a small true effect in N m; more than this is no cause.
WORSE = 1.1


def without_harm(
    search: Search, other: OtherMotion | None
) -> tuple[list[Candidate], Shrink, Trial | None]:
    """The effects but for those that leave more torque missing than the model alone, held out or on another motion.

    With them, the shrink on the log itself and the trial on the other motion.
    """
    pool = search.pool
    prepared, context = pool.context.prepared, pool.context
    chosen = search.chosen

    def shrinks(effects: list[Candidate]) -> tuple[Shrink, Trial | None]:
        own = held_out(prepared, context, pool, effects, search.replicas)
        return own, None if other is None else other.trial(effects)

    def harm(found: tuple[Shrink, Trial | None]) -> float:
        own, trial = found
        ratios = [own.after / own.before]
        if trial is not None:
            ratios.append(trial.shrink.after / trial.shrink.before)
        return max(ratios)

    now = shrinks(chosen)
    while chosen and harm(now) > WORSE:
        fewer = [[x for k, x in enumerate(chosen) if k != i] for i in range(len(chosen))]
        tried = [(rest, shrinks(rest)) for rest in fewer]
        chosen, now = min(tried, key=lambda option: harm(option[1]))
    return chosen, *now
