"""How far the gap shrinks: held out on the log itself, and on another motion."""

import dataclasses

import numpy as np

from jax_inertia.gap import nuisance
from jax_inertia.gap.chain import prepare
from jax_inertia.gap.context import Context
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.families.base import Columns
from jax_inertia.gap.noise import whitener
from jax_inertia.gap.nuisance import Tolerance
from jax_inertia.gap.select import Candidate
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


def effect_torque(context: Context, c: Candidate) -> np.ndarray:
    """A found effect's torque on the fast grid of any log (T, nv)."""
    columns = c.family.columns(context, c.place, c.shape)
    change = c.family.change(context, c.place, c.theta)
    weights = c.theta if change is None else change
    values = columns.values @ weights
    if columns.row is None:
        return values
    out = np.zeros((len(values), context.robot.nv))
    out[:, columns.row] = values
    return out


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
        out.append(float(theta[part] @ own[part] / max(own[part] @ own[part], 1e-300)))
        start += len(c.theta)
    return out


@dataclasses.dataclass(frozen=True)
class Trial:
    """The found effects, as they are, on another motion."""

    shrink: Shrink
    before: float
    """Charged misfit J of the model alone, as the diagnosis judges its own log."""
    after: float
    floor: float
    allowed: float
    """J that the equations' own errors may leave."""


def try_on(robot: Robot, log: Log, chosen: list[Candidate], tolerance: Tolerance) -> Trial:
    """The same effects, as they are, on another motion; what happened in passing is not expected again."""
    prepared = prepare(robot, log)
    context = Context(prepared)
    white, replicas = whitener(prepared, log)
    rest = context.at_rest[prepared.kept] | ~prepared.valid
    y = prepared.finish_torque(prepared.missing)
    lasting = [c for c in chosen if not c.family.passing]
    effects = [effect_torque(context, c) for c in lasting]
    after = y - sum((prepared.finish_torque(e) for e in effects), np.zeros_like(y))
    noise = float(np.sqrt(np.mean(np.asarray(replicas)[:, ~rest] ** 2)))
    evidence = Evidence(prepared, white, nuisance.columns(context, tolerance, 1.0 / log.rate))
    charged = [evidence.column(Columns(e[:, :, None]))[:, 0] for e in effects]
    left = evidence.y - sum(charged, np.zeros_like(evidence.y))
    return Trial(
        shrink=Shrink(_rms(y, rest), _rms(after, rest), noise),
        before=float(evidence.y @ evidence.y),
        after=float(left @ left),
        floor=float(np.mean([evidence.noise_energy(x) for x in replicas])),
        allowed=sum(
            c.family.form_error**2 * float(e @ e) for c, e in zip(lasting, charged, strict=True)
        ),
    )
