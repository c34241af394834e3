"""How far the gap shrinks: held out on the log itself, and on another motion."""

import dataclasses

import numpy as np
from jaxtyping import Float

from jax_inertia.gap.candidate import Candidate, effect_torque
from jax_inertia.gap.chain import prepare
from jax_inertia.gap.context import Context
from jax_inertia.gap.energies import Energies, Shrink, holding, shares
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.motors import with_motors
from jax_inertia.gap.noise import Whitener, motion_band, whitener
from jax_inertia.gap.nuisance import Tolerance, nuisances
from jax_inertia.gap.pool import Pool
from jax_inertia.gap.search import Search
from jax_inertia.gap.select import STOP, solved, stacked
from jax_inertia.gap.verdict import Tried
from jax_inertia.log import Log
from jax_inertia.robot import Robot


def _energies(
    evidence: Evidence,
    rows: list[int],
    before: Float[np.ndarray, "R nv"],
    after: Float[np.ndarray, "R nv"],
    replicas: Float[np.ndarray, "K R nv"],
) -> Energies:
    """Of finished torques on a log, over some rows."""
    excused = evidence.excused(evidence.charged(after))
    torques = (x[..., rows] for x in (before, after, excused, replicas))
    return Energies.of(evidence.used[:, rows], *torques)


def rows_of_gap(evidence: Evidence, replicas: Float[np.ndarray, "K R nv"]) -> list[int]:
    """Rows that hold the gap, in units of their noise or in N m: a faint sensor hides neither the one nor the other."""
    prepared = evidence.prepared
    missing = prepared.finish_torque(prepared.missing)
    excess = np.where(evidence.used, missing**2 - np.mean(replicas**2, axis=0), 0.0).sum(axis=0)
    return sorted({*holding(evidence.share), *holding(shares(excess))})


def held_out(
    pool: Pool,
    rows: list[int],
    chosen: list[Candidate],
    before: Float[np.ndarray, "R nv"],
    after: Float[np.ndarray, "R nv"],
    replicas: Float[np.ndarray, "K R nv"],
) -> Shrink:
    """Missing torque on some rows, `before` and `after` the chosen effects (`what_is_left`)."""
    context, prepared = pool.context, pool.context.prepared
    energies = _energies(pool.evidence, rows, before, after, replicas)
    if not chosen:
        return energies.shrink
    own = 0.0
    for c in (c for c in chosen if not c.family.passing):
        effect = prepared.finish_torque(effect_torque(context, c))
        counted = effect[:, rows][pool.evidence.used[:, rows]]
        own += c.family.form_error**2 * float(counted @ counted)
    interval = energies.interval(prepared.settings.decimated, own)
    return dataclasses.replace(energies.shrink, interval=interval)


def what_is_left(pool: Pool, chosen: list[Candidate]) -> np.ndarray:
    """Missing torque that remains (R, nv), each fold predicted from the others; a push as it was fitted."""
    prepared = pool.context.prepared
    y = prepared.finish_torque(prepared.missing)
    parts = [prepared.finish_torque(effect_torque(pool.context, c)) for c in chosen]
    return y - _predicted(pool, chosen, parts, np.zeros_like(y))


def misfit_held_out(pool: Pool, chosen: list[Candidate]) -> float:
    """Charged misfit J, each fold predicted from the others."""
    unflatten = pool.evidence.unflatten
    y = unflatten(pool.evidence.y)
    parts = [unflatten(c.effect) for c in chosen]
    return float(np.sum((y - _predicted(pool, chosen, parts, np.zeros_like(y))) ** 2))


def _predicted(
    pool: Pool, chosen: list[Candidate], parts: list[np.ndarray], out: np.ndarray, folds: int = 5
) -> np.ndarray:
    """Σ effects, each as large on a fifth of the log as the other four say."""
    if not chosen:
        return out
    columns, target = stacked(pool, chosen)
    fold_of = np.arange(len(out)) * folds // len(out)
    flat = pool.evidence.part(folds)
    own = np.concatenate([c.theta for c in chosen])
    for fold in range(folds):
        train = flat != fold
        theta = solved(columns[train], target[train], own)
        for part, c, share in zip(parts, chosen, _share_of(theta, own, chosen), strict=True):
            # What happened once, in this fold, cannot be predicted from the others.
            out[fold_of == fold] += (1.0 if c.family.passing else share) * part[fold_of == fold]
    return out


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
    grown: float
    """Missing torque of all rows with the effects, over that without."""


class OtherMotion:
    """A test log, made ready once, to try effects on; what happened in passing is not expected again."""

    def __init__(
        self, robot: Robot, log: Log, tolerance: Tolerance, search: Search, rows: list[int]
    ):
        prepared = prepare(robot, log)
        log = with_motors(log, robot, search.motors)
        own, replicas, _ = whitener(prepared, log)
        context = Context(prepared, motion_band(prepared, own, replicas))
        # The errors that the first log showed beyond its sensors' are there on this one too.
        own = Whitener(own.sigma, (*own.stages, *search.white.stages[1:]))
        doubts = nuisances(context, tolerance, log)
        self._prepared, self._context = prepared, context
        first = search.pool.evidence
        self._evidence = Evidence(prepared, own, doubts, first.scales).pinning(first.pinned)
        self._known, self._rows, self._replicas = search.known, rows, replicas

    def trial(self, chosen: list[Candidate]) -> Trial:
        """Missing torque and misfit with and without the effects."""
        prepared, context, evidence = self._prepared, self._context, self._evidence
        lasting = [c for c in chosen if not c.family.passing]
        effects = [prepared.finish_torque(effect_torque(context, c)) for c in lasting]
        charged = [evidence.charged(e) for e in effects]
        y = prepared.finish_torque(prepared.missing)
        left = evidence.y - sum(charged, np.zeros_like(evidence.y))
        after = y - sum(effects, np.zeros_like(y))
        return Trial(
            shrink=_energies(evidence, self._rows, y, after, self._replicas).shrink,
            misfit=Tried(
                before=float(evidence.y @ evidence.y),
                after=float(left @ left),
                floor=evidence.noise_energy(self._replicas),
                allowed=sum((c.excuses(e) for c, e in zip(lasting, charged, strict=True)), 0.0),
                known=self._known,
            ),
            grown=_grown(evidence, y, after),
        )


def _grown(
    evidence: Evidence, before: Float[np.ndarray, "R nv"], after: Float[np.ndarray, "R nv"]
) -> float:
    """Finished torques' rms over all rows, after over before."""
    sizes = [float(np.linalg.norm(x[evidence.used])) for x in (after, before)]
    return sizes[0] / max(sizes[1], 1e-300)


# A share of the gap, and of the missing torque, that the nominal model's own errors may add on another motion: an
# effect may be true and yet undo some of them. More is no cause.
WORSE, WORSE_TORQUE = 0.1, 1.3


def _harm_of(grown: float, before: float, after: float, floor: float) -> float:
    """Harm of torques that have grown, beside the misfit before and after.

    None where the most of the misfit is gone: noise of columns that hold accelerations is no harm in the noise's units.
    """
    return 0.0 if after - floor < 0.5 * (before - floor) else grown / WORSE_TORQUE


def without_harm(
    search: Search, other: OtherMotion | None, rows: list[int]
) -> tuple[list[Candidate], Shrink, Trial | None]:
    """The effects but for those that fit worse than the model alone, held out or on another motion.

    With them, the shrink on the log itself, each fifth of it predicted from the other four, and the trial on the other
    motion.
    """
    pool, chosen, prepared = search.pool, search.chosen, search.pool.context.prepared
    before = prepared.finish_torque(prepared.missing)
    alone = float(pool.evidence.y @ pool.evidence.y)

    def tried(effects: list[Candidate]) -> tuple[float, Shrink, Trial | None]:
        after = what_is_left(pool, effects)
        own = held_out(pool, rows, effects, before, after, search.replicas)
        trial = None if other is None else other.trial(effects)
        left = misfit_held_out(pool, effects)
        harm = [
            # On stretches that it was not fitted to, an effect has to bring half of what it had to on all of them.
            left / max(alone - 0.5 * STOP, 1.0),
            _harm_of(_grown(pool.evidence, before, after), alone, left, search.floor),
        ]
        if trial is not None:
            j = trial.misfit
            chance = STOP * max(1.0, j.before / max(j.floor, 1.0))
            harm += [
                j.after / (j.before + chance + j.allowed + WORSE * max(j.before - j.floor, 0.0)),
                _harm_of(trial.grown, j.before, j.after, j.floor),
            ]
        return max(harm), own, trial

    now = tried(chosen)
    while chosen and now[0] > 1.0:
        fewer = [[x for k, x in enumerate(chosen) if k != i] for i in range(len(chosen))]
        chosen, now = min(((rest, tried(rest)) for rest in fewer), key=lambda x: x[1][0])
    return chosen, *now[1:]
