"""Diagnose the sim-to-real gap: where it lies, which unmodelled effect causes it, how far it shrinks with it.

    found = diagnose(load_model("arm.xml"), read_log("run.npz"), test_log=read_log("other.npz"))
    print(found)
    to_report(found)        # the contract's report.json, as a dict (`jax_inertia.gap.report`)

The missing torque (`signals.torque_residual`) is whitened to the sensors' noise (`noise`), the nominal model's
tolerances are integrated out (`nuisance`, `evidence`), and every family at every place competes for what is left
(`families`, `select`).
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.diagnosis.effects.registry import NAMES
from jax_inertia.diagnosis.report.gap_stretches import gap_stretches
from jax_inertia.gap.candidate import Candidate, effect_torque
from jax_inertia.gap.conventions import require_conventions
from jax_inertia.gap.doubt import better_than
from jax_inertia.gap.families import LIBRARY
from jax_inertia.gap.families.base import Plain
from jax_inertia.gap.finder import finder
from jax_inertia.gap.finding import Diagnosis, Finding, Tie
from jax_inertia.gap.harm import without_harm
from jax_inertia.gap.intervals import Interval, intervals
from jax_inertia.gap.locate import times
from jax_inertia.gap.motors import by_samples
from jax_inertia.gap.nuisance import Tolerance
from jax_inertia.gap.objections import objections
from jax_inertia.gap.other_motion import OtherMotion
from jax_inertia.gap.outcome import Search
from jax_inertia.gap.search import charged, find
from jax_inertia.gap.shrink import held_out, rows_of_gap, what_is_left
from jax_inertia.gap.tied import kind_of_tie, rivals, tied
from jax_inertia.gap.together import misfit, remaining
from jax_inertia.gap.trace import collect
from jax_inertia.gap.turning import turning
from jax_inertia.gap.undetectable import undetectable
from jax_inertia.gap.verdict import Verdict, probabilities
from jax_inertia.logs.log import Log
from jax_inertia.model.robot import Robot
from jax_inertia.preflight.preflight import require_usable
from jax_inertia.signals.sensor_noise import stated
from jax_inertia.signals.torque_residual import Prepared, prepare
from jax_inertia.text.words import number

# Samples that a diagnosis takes.
LEAST = 100


def diagnose(
    robot: Robot,
    log: Log,
    *,
    test_log: Log | None = None,
    exclude: Sequence[str] = (),
    extra: Sequence[Effect] = (),
    max_effects: int = 3,
    nominal_uncertainty: Tolerance | None = None,
    progress: Callable[[str], None] = lambda stage: None,
) -> Diagnosis:
    """Find the effects that the model lacks; see the module's text for the method.

    `exclude` removes families from the library, `extra` adds effects of your own, `nominal_uncertainty` states what the
    nominal model may be off by. `test_log`, another motion, only validates. Raises ValueError for an unknown family,
    or one that the library has already, and LogError for a log that is not of this robot, not in N m or not measured
    (`preflight.require_usable`).

    >>> from jax_inertia import load_model
    >>> from jax_inertia.gap import diagnose
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> found = diagnose(load_model(double_pendulum()), swing(load=0.5, seconds=8.0))
    >>> found.findings[0].family, found.findings[0].place.name
    ('payload', 'lower')
    """
    if unknown := sorted(set(exclude) - set(NAMES)):
        raise ValueError(f"unknown families {unknown}; valid: {', '.join(NAMES)}")
    if taken := sorted({f.name for f in extra} & set(NAMES)):
        raise ValueError(f"the library has families {taken} already; give yours another name")
    if max_effects < 1:
        raise ValueError(f"max_effects is {max_effects}; at least one")
    for one in (log, *(() if test_log is None else (test_log,))):
        require_usable(one, robot)
    tolerance = Tolerance() if nominal_uncertainty is None else nominal_uncertainty
    progress("filtering the log")
    prepared = prepare(robot, log)
    if len(prepared.kept) < LEAST:
        raise ValueError(
            f"{log.duration:.2f} s of log leave {len(prepared.kept)} samples after filtering, and at least {LEAST} are "
            f"needed; at its rate record {2 * prepared.bands.margin + (LEAST + 2) / prepared.bands.rows:.3g} s or more"
        )
    _require_newton_metres(prepared)
    require_conventions(prepared)
    library = [*(f for f in LIBRARY if f.name not in exclude), *(Plain(e) for e in extra)]
    progress("columns of every effect at every place, and which of them fit")
    first, search = find(finder(prepared, log, tolerance, library, max_effects))
    pool, verdict = search.pool, search.verdict
    context = pool.context
    progress("checking on held-out stretches and on the other motion")
    # How large the gap is, where and when, is told in units of the sensors' noise.
    evidence = first.pool.evidence
    rows = rows_of_gap(evidence, search.replicas)
    other = None if test_log is None else OtherMotion(robot, test_log, tolerance, search)
    checked = without_harm(search, other, rows)
    chosen, trial = checked.chosen, checked.trial
    beside: list[str] = []
    if len(chosen) < len(search.chosen):
        verdict = Verdict.UNKNOWN
        if not chosen:
            stands_out = better_than(first.pool, [], first.noise) is not None
            verdict = Verdict.of_nothing(first.bare, stands_out)
    elif other is not None and trial is not None and chosen:
        # A wrong cause may fit one motion; it seldom fits two, whatever happened in passing.
        verdict, beside = other.second_look(verdict, trial, chosen)
    # The most important first.
    brings = _brought(first, search, chosen)
    order = np.argsort(-brings, kind="stable")
    chosen, brings = [chosen[k] for k in order], brings[order]
    # A force in passing that is not known for the cause foretells nothing: each stretch is predicted without it.
    foretold = verdict is Verdict.UNKNOWN
    steps = tuple(
        what_is_left(pool, chosen[: k + 1], foretold=foretold) for k in range(len(chosen))
    )
    heldout = checked.heldout
    if foretold and any(c.family.passing for c in chosen):
        before = prepared.finish_torque(prepared.missing)
        heldout, _ = held_out(pool, rows, chosen, before, steps[-1], search.replicas)
    numbers = intervals(pool, chosen, search.misfits[-1] / max(search.noise, 1.0))
    findings = tuple(_finding(search, chosen, i, numbers[i], brings[i]) for i in range(len(chosen)))
    reaches, turned = turning(pool, chosen)
    rms = np.sqrt(np.mean(prepared.finish_torque(prepared.missing) ** 2, axis=0))
    return Diagnosis(
        verdict=verdict,
        confidence=(
            findings[0].probability
            if findings and verdict is not Verdict.UNKNOWN
            else verdict.confidence(first.bare)
        ),
        chi2=float(np.sum(evidence.raw**2) / evidence.rows),
        noise_floor=float(first.floor / evidence.rows),
        per_joint_rms=dict(zip(context.row_names, rms.tolist(), strict=True)),
        share=dict(zip(context.row_names, evidence.share.tolist(), strict=True)),
        findings=findings,
        heldout=heldout,
        test=None if trial is None else trial.shrink,
        when=gap_stretches(times(evidence), evidence.unflatten(evidence.y)),
        undetectable_below=undetectable(pool),
        notes=(*log.notes, *_unmeasured(prepared), *_unstated(search, log), *checked.notes),
        doubts=objections(search, chosen, verdict, trial, beside, max_effects),
        trace=collect(
            first.pool,
            tuple(prepared.finish_torque(effect_torque(context, c)) for c in chosen),
            steps,
            pool.evidence.excused(remaining(pool, chosen)),
            pool.evidence.excused(pool.evidence.charged(turned)),
            reaches,
            search.torque_noise,
            search.replicas,
            checked.sight,
        ),
    )


# No joint's friction or load is this many times what the model needs, or it needs so many times more, everywhere.
OTHER_UNITS = 100.0


def _require_newton_metres(prepared: Prepared) -> None:
    """ValueError where torques are far too large or too small for the model at every joint."""
    needed, logged = (
        np.sqrt(np.mean(prepared.finish_torque(x) ** 2, axis=0))
        for x in (prepared.inverse, prepared.tau)
    )
    told = (needed > 0) & (logged > 0)
    ratios = logged[told] / needed[told]
    if len(ratios) and (ratios.min() > OTHER_UNITS or ratios.max() < 1 / OTHER_UNITS):
        raise ValueError(
            f"the log's torques are {np.median(ratios):.3g} times what the model needs, and at every joint far from "
            "it: expected N m (N mm are 1000 times as many)"
        )


def _finding(
    search: Search,
    chosen: list[Candidate],
    i: int,
    numbers: dict[str, Interval],
    brings: float,
) -> Finding:
    """The i-th effect, which brings such a share of the gap, beside its rivals, given the others."""
    pool, c = search.pool, chosen[i]
    others = rivals(search, chosen, i)
    equivalent = {
        t.key: Tie(t.family.name, t.place, kind_of_tie(pool, c, t)) for t in tied(search, c, others)
    }
    # The same torque under another name takes nothing from the odds.
    others = [r for r in others if r.key not in equivalent or equivalent[r.key].kind != "exact"]
    return Finding(
        family=c.family.name,
        place=c.place,
        parameters=numbers,
        explained=float(np.clip(brings, 0.0, 1.0)),
        probability=probabilities(others).get(c.key, 0.5),
        equivalent=tuple(equivalent.values()),
        equation=c.family.equation,
    )


def _unmeasured(prepared: Prepared) -> list[str]:
    """What a log without contact wrenches can tell."""
    if prepared.support is None:
        return []
    return [
        f"no contact wrench is measured: forces at {', '.join(prepared.support.bodies)} are taken from their legs' own "
        "torques, so that an effect is seen by what it does to the base's balance alone"
    ]


def _unstated(search: Search, log: Log) -> list[str]:
    """What was learned of noise that the log does not state, or more than it states, joint by joint."""
    noise = search.torque_noise
    if noise is None:
        return []
    context = search.pool.context
    rough = by_samples(log, context.robot)
    listed = ", ".join(
        f"{name} {number(noise[row]) if noise[row] > 0.01 * rough[row] else 0} (not {number(rough[row])})"
        for name, row in context.joint_dofs.items()
        if abs(noise[row] - rough[row]) > 0.1 * rough[row]
    )
    off = f"torques are taken to be off at random by {listed} N m from sample to sample"
    if stated(log):
        return [
            "what is left is at random, louder than the noise that the log states and no louder than its torques are "
            f"rough: {off}"
        ]
    return [
        f"the log states no noise; from what is left, and not from how rough its samples are, {off}"
    ]


def _brought(
    first: Search, search: Search, chosen: list[Candidate]
) -> Float[np.ndarray, " effects"]:
    """Share of the gap that returns when one of the effects is left out, for each.

    After a second pass in the first one's measure: whitened to what effects leave, a gap that stays is small.
    """
    evidence = first.pool.evidence
    if search is first:
        whole = misfit(first.pool, chosen)
        without = [misfit(first.pool, [x for x in chosen if x is not c]) for c in chosen]
        before = misfit(first.pool, [])
    else:
        drawn = [charged(first.pool.context, evidence, c) for c in chosen]
        left = evidence.y - sum(drawn, np.zeros_like(evidence.y))
        whole, before = float(left @ left), float(evidence.y @ evidence.y)
        without = [float(np.sum((left + x) ** 2)) for x in drawn]
    return (np.array(without) - whole) / max(before - first.floor, 1e-300)
