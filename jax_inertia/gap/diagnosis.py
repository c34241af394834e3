"""Diagnose the sim-to-real gap: where it lies, which unmodelled effect causes it, how far it shrinks with it.

    found = diagnose(load_model("arm.xml"), read_log("run.npz"), test_log=read_log("other.npz"))
    print(found)
    to_report(found)        # the contract's report.json, as a dict (`jax_inertia.gap.report`)

The missing torque (`chain`) is whitened to the sensors' noise (`noise`), the nominal model's tolerances are integrated
out (`nuisance`, `evidence`), and every family at every place competes for what is left (`families`, `select`).
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from jax_inertia.gap import locate, nuisance
from jax_inertia.gap.chain import prepare
from jax_inertia.gap.context import Context
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.families import LIBRARY, NAMES
from jax_inertia.gap.families.base import Parameter, Place
from jax_inertia.gap.intervals import Interval, intervals
from jax_inertia.gap.noise import whitener
from jax_inertia.gap.nuisance import Tolerance
from jax_inertia.gap.select import STOP, Candidate, Pool, misfit, select
from jax_inertia.gap.trace import Trace, collect
from jax_inertia.gap.verdict import Verdict, judge, probabilities, ties
from jax_inertia.log import Log
from jax_inertia.robot import Robot


@dataclasses.dataclass(frozen=True)
class Tie:
    """Another explanation that this log cannot tell from the one given."""

    family: str
    place: Place
    kind: str
    """'exact' where no motion of this robot can, 'motion_limited' where another motion would."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """One effect that the model lacks."""

    family: str
    place: Place
    parameters: dict[str, Interval]
    explained: float
    """Share of the gap's excess energy that goes with it, on held-out stretches of the log."""
    probability: float
    equivalent: tuple[Tie, ...]


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


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found."""

    verdict: Verdict
    confidence: float
    chi2: float
    """Whitened energy per sample before anything is explained; about one without a gap."""
    noise_floor: float
    per_joint_rms: dict[str, float]
    share: dict[str, float]
    findings: tuple[Finding, ...]
    heldout: Shrink
    test: Shrink | None
    when: tuple[tuple[float, float], ...]
    undetectable_below: tuple[tuple[str, Place, Parameter], ...]
    notes: tuple[str, ...]
    trace: Trace

    def __repr__(self) -> str:
        head = f"{self.verdict} (confidence {self.confidence:.2f})"
        rows = [
            f"  {f.family} at {f.place.name}: "
            + ", ".join(
                f"{n} {p.value:.4g} [{p.low:.4g}, {p.high:.4g}] {p.unit}"
                for n, p in f.parameters.items()
            )
            for f in self.findings
        ]
        shrink = (
            f"  held out: {self.heldout.before:.3g} → {self.heldout.after:.3g} N m "
            f"(noise {self.heldout.noise:.3g})"
        )
        return "\n".join([head, *rows, shrink])


def diagnose(
    robot: Robot,
    log: Log,
    *,
    test_log: Log | None = None,
    exclude: Sequence[str] = (),
    max_effects: int = 3,
    nominal_uncertainty: Tolerance | None = None,
    progress: Callable[[str], None] = lambda stage: None,
) -> Diagnosis:
    """Find the effects that the model lacks; see the module's text for the method.

    `exclude` removes families from the library, `nominal_uncertainty` states what the nominal model may be off by.
    `test_log`, another motion, only validates. Raises ValueError for an unknown family and LogError for a log that
    does not fit the robot.
    """
    if unknown := sorted(set(exclude) - set(NAMES)):
        raise ValueError(f"unknown families {unknown}; valid: {', '.join(NAMES)}")
    if max_effects < 1:
        raise ValueError(f"max_effects is {max_effects}; at least one")
    tolerance = Tolerance() if nominal_uncertainty is None else nominal_uncertainty
    progress("filtering the log")
    prepared = prepare(robot, log)
    if len(prepared.kept) < 100:
        raise ValueError(
            f"{log.duration:.2f} s of log leave {len(prepared.kept)} samples after filtering; at least 100 are needed"
        )
    white, replicas = whitener(prepared, log)
    context = Context(prepared)
    progress("tolerances of the nominal model")
    evidence = Evidence(prepared, white, nuisance.columns(context, tolerance, 1.0 / log.rate))
    floor = float(np.mean([evidence.noise_energy(x) for x in replicas]))
    progress("columns of every effect at every place")
    pool = Pool(context, evidence, [f for f in LIBRARY if f.name not in exclude])
    progress("choosing effects")
    chosen, ranking, misfits = select(pool, max_effects, floor)
    verdict = judge(
        misfits, floor, chosen, log.sigma_tau is not None and log.sigma_qpos is not None
    )
    odds = probabilities(ranking, misfits, floor)
    progress("checking on held-out stretches")
    heldout = _held_out(prepared, context, pool, chosen, replicas)
    numbers = intervals(pool, chosen, misfits[-1] / max(floor, 1.0))
    findings = tuple(
        Finding(
            family=c.family.name,
            place=c.place,
            parameters=numbers[i],
            explained=_explained(pool, chosen, i, floor),
            probability=odds.get(c.key, 0.5) if i == 0 else 0.5,
            equivalent=tuple(
                Tie(t.family.name, t.place, _tie_kind(pool, c, t))
                for t in (ties(c, ranking, misfits, floor) if i == 0 else ())
            ),
        )
        for i, c in enumerate(chosen)
    )
    raw = evidence.unflatten(evidence.raw[:, 0])
    names = {dof: name for name, dof in context.joint_dofs.items()}
    rms = np.sqrt(np.mean(prepared.finish(prepared.missing) ** 2, axis=0))
    excess = np.maximum(np.sum(raw**2 - evidence.used, axis=0), 0.0)
    label = [names.get(j, f"base[{j}]") for j in range(robot.nv)]
    return Diagnosis(
        verdict=verdict,
        confidence=float(odds.get(chosen[0].key, 0.5))
        if chosen
        else verdict.confidence(misfits, floor),
        chi2=float(np.sum(raw**2) / evidence.rows),
        noise_floor=float(floor / evidence.rows),
        per_joint_rms=dict(zip(label, rms.tolist(), strict=True)),
        share=dict(zip(label, (excess / max(excess.sum(), 1e-300)).tolist(), strict=True)),
        findings=findings,
        heldout=heldout,
        test=None if test_log is None else _on_other(robot, test_log, chosen),
        when=tuple((a, b) for a, b in locate.intervals(evidence, evidence.y)),
        undetectable_below=_undetectable(pool),
        notes=tuple(log.notes),
        trace=collect(
            pool,
            tuple(prepared.finish(_effect(context, c)) for c in chosen),
            tuple(_left(prepared, context, pool, chosen[: k + 1]) for k in range(len(chosen))),
            replicas,
        ),
    )


def _effect(context: Context, c: Candidate) -> np.ndarray:
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


def _held_out(prepared, context, pool, chosen, replicas) -> Shrink:
    """Missing torque before and after, each fifth of the log predicted from the other four."""
    rest = context.at_rest[prepared.kept]
    y = prepared.finish(prepared.missing)
    noise = float(np.sqrt(np.mean(np.asarray(replicas)[:, ~rest] ** 2)))
    after = _left(prepared, context, pool, chosen)
    return Shrink(_rms(y, rest), _rms(after, rest), noise)


def _left(prepared, context, pool, chosen, folds: int = 5) -> np.ndarray:
    """Missing torque that remains (R, nv), each fold predicted from the others."""
    y = prepared.finish(prepared.missing)
    after = y.copy()
    if chosen:
        flat = np.repeat(np.arange(len(y)) * folds // len(y), y.shape[1])
        columns = np.concatenate([c.columns for c in chosen], axis=1)
        target = pool.evidence.y - np.sum([c.offset for c in chosen], axis=0)
        full = [prepared.finish(_effect(context, c)) for c in chosen]
        own = np.concatenate([c.theta for c in chosen])
        for fold in range(folds):
            train = flat != fold
            theta = np.linalg.lstsq(columns[train], target[train], rcond=None)[0]
            scale = _share_of(theta, own, chosen)
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


def _on_other(robot: Robot, log: Log, chosen: list[Candidate]) -> Shrink:
    """The same effects, as they are, on another motion."""
    prepared = prepare(robot, log)
    context = Context(prepared)
    _, replicas = whitener(prepared, log)
    rest = context.at_rest[prepared.kept]
    y = prepared.finish(prepared.missing)
    lasting = [c for c in chosen if not c.family.passing]
    after = y - sum((prepared.finish(_effect(context, c)) for c in lasting), np.zeros_like(y))
    noise = float(np.sqrt(np.mean(np.asarray(replicas)[:, ~rest] ** 2)))
    return Shrink(_rms(y, rest), _rms(after, rest), noise)


def _explained(pool: Pool, chosen: list[Candidate], i: int, floor: float) -> float:
    """Share of the excess misfit that returns when the effect is left out."""
    rest = [c for k, c in enumerate(chosen) if k != i]
    y = pool.evidence.y
    gap = max(float(y @ y) - floor, 1e-300)
    return float(np.clip((misfit(pool, rest) - misfit(pool, chosen)) / gap, 0.0, 1.0))


def _tie_kind(pool: Pool, a: Candidate, b: Candidate) -> str:
    """'exact' where the two effects are the same torque to within rounding on this log, whatever its motion."""
    gap = np.linalg.norm(a.effect - b.effect) / max(np.linalg.norm(a.effect), 1e-300)
    return "exact" if gap < 1e-6 else "motion_limited"


def _undetectable(pool: Pool) -> tuple[tuple[str, Place, Parameter], ...]:
    """Smallest size of each single-number effect that this log would have shown."""
    out = []
    for family, place, blocks in pool.entries:
        shape, block = blocks[len(blocks) // 2]
        if block.shape[1] != 1 or family.grid(pool.context, place):
            continue
        price = STOP + np.log(pool.evidence.rows)
        theta = np.array([np.sqrt(price) / np.linalg.norm(block)])
        parameter = next(iter(family.parameters(pool.context, place, shape, theta).values()))
        out.append((family.name, place, parameter))
    return tuple(out)
