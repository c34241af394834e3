"""How far the gap shrinks on the log itself, each stretch of it predicted from the others."""

import dataclasses

import numpy as np
from jaxtyping import Float

from jax_inertia.gap.candidate import Candidate, effect_torque
from jax_inertia.gap.energies import Counted, Energies, Shrink, holding, shares
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.pool import Pool
from jax_inertia.gap.together import solved, stacked


@dataclasses.dataclass(frozen=True)
class Sight:
    """Where a gap is measured: on which rows, and whether in the motion's own band."""

    rows: list[int]
    slow: bool = True

    def on(self, evidence: Evidence) -> Counted:
        """On a log."""
        return Counted(evidence.used[:, self.rows], evidence.slow_modes if self.slow else None)

    def energies(
        self,
        evidence: Evidence,
        before: Float[np.ndarray, "R nv"],
        after: Float[np.ndarray, "R nv"],
        replicas: Float[np.ndarray, "K R nv"],
    ) -> Energies:
        """Of finished torques on a log."""
        excused = evidence.excused(evidence.charged(after))
        torques = (x[..., self.rows] for x in (before, after, excused, replicas))
        return Energies.of(self.on(evidence), *torques)

    def shrink(self, evidence: Evidence, energies: Energies) -> Shrink:
        """Of energies of a log."""
        band = evidence.slow_band if self.slow else None
        return dataclasses.replace(energies.shrink, band=band)


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
) -> tuple[Shrink, Sight]:
    """Missing torque on some rows, `before` and `after` the chosen effects (`what_is_left`), and where it is measured.

    That is in the motion's own band, unless hardly any of the gap is there.
    """
    evidence, prepared = pool.evidence, pool.context.prepared
    sight = Sight(rows)
    sizes = sight.energies(evidence, before, after, replicas)
    if sizes.shrink.share is None:
        sight = Sight(rows, slow=False)
        sizes = sight.energies(evidence, before, after, replicas)
    shrink = sight.shrink(evidence, sizes)
    if not chosen:
        return shrink, sight
    own = 0.0
    for c in (c for c in chosen if not c.family.passing):
        effect = prepared.finish_torque(effect_torque(pool.context, c))[:, rows]
        own += c.family.form_error**2 * float(sight.on(evidence).energy(effect).sum())
    interval = sizes.interval(prepared.bands.rows, own)
    return dataclasses.replace(shrink, interval=interval), sight


def what_is_left(pool: Pool, chosen: list[Candidate], *, foretold: bool = False) -> np.ndarray:
    """Missing torque that remains (R, nv), each fold predicted from the others.

    A push is taken as it was fitted; where only what is `foretold` counts, not at all: nothing foretells it.
    """
    prepared = pool.context.prepared
    y = prepared.finish_torque(prepared.missing)
    parts = [prepared.finish_torque(effect_torque(pool.context, c)) for c in chosen]
    return y - _predicted(pool, chosen, parts, np.zeros_like(y), once=0.0 if foretold else 1.0)


def misfit_held_out(pool: Pool, chosen: list[Candidate]) -> float:
    """Charged misfit J, each fold predicted from the others."""
    unflatten = pool.evidence.unflatten
    y = unflatten(pool.evidence.y)
    parts = [unflatten(c.effect) for c in chosen]
    return float(np.sum((y - _predicted(pool, chosen, parts, np.zeros_like(y))) ** 2))


def _predicted(
    pool: Pool,
    chosen: list[Candidate],
    parts: list[np.ndarray],
    out: np.ndarray,
    once: float = 1.0,
    folds: int = 5,
) -> np.ndarray:
    """Σ effects, each as large on a fifth of the log as the other four say, and `once` as large if it happened once."""
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
            out[fold_of == fold] += (once if c.family.passing else share) * part[fold_of == fold]
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
