"""Replays that prove or disprove the numbers of a fit, the verdict of them, and what is to be said."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.certainty.doubts import Doubts, odds_of_verdict
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.diagnosis.verdict import Errors, Left, judged
from jax_inertia.maths.sample_weight import odds_within
from jax_inertia.replay import checks
from jax_inertia.replay.fitting.draws import Draws
from jax_inertia.replay.fitting.errors import replay_errors
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.joint_numbers import Numbers
from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.record import Record, step_means
from jax_inertia.replay.result import Fan, Replayed, Resemblance, Torques, rms, total
from jax_inertia.replay.search.choice import Chosen
from jax_inertia.replay.search.probability import Sure
from jax_inertia.replay.search.tries import LOG_ODDS
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import misses, replay

Numbered = tuple[Sequence[Parameter], np.ndarray]
_REPLAYED = 32
"""Of the draws: a decision; the band's ends are the second and the 31st."""
_CREEPS = 1.1


def with_torques(r: Replayed, plant: Plant, nominal: Numbered, corrected: Numbered) -> Replayed:
    """With what torques err by, where they are logged; `nominal` and `corrected`: table and vector of each."""
    if r.records[0].torque is None:
        return r
    said, fitted = (_torque_error(plant, of, r.records) for of in (nominal, corrected))
    before, after = [
        _torque_error(plant, of, [x._replace(q=q, velocity=None) for x, q in zip(r.records, paths, strict=True)])
        for of, paths in ((nominal, r.nominal), (corrected, r.corrected))
    ]  # fmt: skip
    floor = checks.torque_floor(r.records, plant.loop)
    along = np.hypot(floor, plant.loop.kp * r.floor)
    return dataclasses.replace(r, torques=Torques(said, fitted, before, after, floor, along))


def _torque_error(plant: Plant, of: Numbered, records: Sequence[Record]) -> np.ndarray:
    table, theta = of
    parts = [misses(plant, table, theta[None], x)[0][x.settled] for x in records]
    return rms(np.concatenate(parts))


def fan(plant: Plant, found: Fit, draws: Draws, record: Record) -> Fan:
    """Where replays of draws lie, and by how much each errs."""
    paths = replay(plant, found.table, draws.vectors[:_REPLAYED], record)
    low, high = np.percentile(paths, (5.0, 95.0), axis=0)
    off = (paths - record.q)[:, record.settled]
    return Fan(low, high, np.sqrt(np.mean(off**2, axis=(1, 2))))


def worse(r: Replayed, names: Sequence[str]) -> tuple[str, ...]:
    """Joints that the corrected model replays worse than the nominal one."""
    limits = np.maximum(1.05 * r.before, 1.5 * r.floor)
    return tuple(n for n, a, top in zip(names, r.after, limits, strict=True) if a > top)


def creeping(plant: Plant, bare: Plant, found: Fit, records: Sequence[Record]) -> list[str]:
    """What is to be said where friction has to hold joints at rest."""
    holds, creeps = (
        float(
            np.sqrt(np.mean(rms(replay_errors(p, found.table, found.theta[None], records)[0]) ** 2))
        )
        for p in (plant, bare)
    )
    if creeps <= _CREEPS * holds:
        return []
    return [
        "friction that holds a joint at rest (solimpfriction in corrected.xml) matters: with MuJoCo's own, which "
        f"creeps, the same numbers err by {creeps:.2g} rad"
    ]


def mean_friction(x: Numbers, records: Sequence[Record]) -> Float[np.ndarray, " n"]:
    """Dry friction's mean along runs, at the positions that were measured."""
    sizes = []
    for r in records:
        steps = len(r.time)
        commanded = (
            step_means(r.commanded.time, r.commanded.position, r.period, steps, x.delay, x.lag)
            - x.offset
        )
        v = np.gradient(r.q, r.time, axis=0)
        q = r.q - x.offset
        sizes.append(x.friction(x.torque(commanded, q, v), q, v))
    return np.mean(np.concatenate(sizes), axis=0)


class Told(NamedTuple):
    """A verdict, log odds that it is right [nats], and what stands against a better one."""

    verdict: Verdict
    log_odds: float
    left: tuple[Left, ...]
    impossible: tuple[str, ...]


def judgement(
    r: Replayed,
    effects: Sequence[Sure],
    discrepancy: Float[np.ndarray, " n"],
    done: Chosen,
    in_tolerance: bool,
) -> Told:
    """By the test rows, every joint's position and logged torque (`diagnosis.verdict`).

    `effects`: how sure those are that are listed. Where nothing but a clock was found, and numbers within the model's
    tolerances (`in_tolerance`), the model as given is the one with these: no gap is forgiven for them, and none is seen
    in them.
    """
    errors = _errors(r, discrepancy, done.plant.names)
    errors = errors.as_given() if in_tolerance else errors
    found = judged(errors, bool(effects), done.impossible)
    # A number that is asked beyond its bound is so by 20 to 1 at least.
    doubts = Doubts(unnamed=LOG_ODDS if done.impossible else None)
    odds = odds_of_verdict(_within(r, errors), found.verdict, effects, doubts)
    return Told(found.verdict, odds, found.left, found.against)


def _errors(r: Replayed, stated: Float[np.ndarray, " n"], names: tuple[str, ...]) -> Errors:
    moves = checks.moving(r.records)
    rows = [np.stack([r.floor, r.before, r.after, moves, stated])]
    if (x := r.torques) is not None:
        names = (*names, *(f"torque of {n}" for n in names))
        # What clocks do to a torque is in its floor; as said is within twice that.
        rows.append(
            np.stack([x.floor, x.loop_before, x.loop_after, moves, np.sqrt(0.78) * x.floor])
        )
    floor, before, after, moves, stated = np.concatenate(rows, axis=1)
    return Errors(names, floor, before, after, moves > 0, stated)


def _within(r: Replayed, errors: Errors) -> Float[np.ndarray, " m"]:
    """Log odds that the error of each joint that moves is within its limit [nats]."""
    pairs = zip(r.corrected, r.records, strict=True)
    e = np.concatenate([(p - x.q)[x.settled] for p, x in pairs])
    moves = errors.moves[: e.shape[1]]
    return odds_within(e, errors.limit[: e.shape[1]])[moves]


def headline(told: Told, r: Replayed, resembles: Sequence[Resemblance] = ()) -> str:
    """One line; the remainder at the worst joint with the shape that most of it goes with."""
    before, after, floor = (total(x) for x in (r.before, r.after, r.floor))
    if told.verdict is Verdict.NO_GAP:
        clock = (
            f", {after:.2g} rad with the loop's clock and in tolerance"
            if np.any(r.before != r.after)
            else ""
        )
        return f"replay error on {r.of}: {before:.2g} rad{clock}, no more than encoders leave ({floor:.2g} rad)"
    torque = ""
    if r.torques is not None:
        was, now = total(r.torques.before), total(r.torques.after)
        torque = f", of torque {was:.2g} → {now:.2g} N m"
    left = ""
    if told.left:
        x = told.left[0]
        left = f"; {x.name} is left with {x.after:.2g} ({x.floors:.2g} floors)"
        like = next((y for y in resembles if y.joint == x.name and y.share > 0.5), None)
        left += f", which goes with the {like.shape} (R² {like.share:.2f})" if like else ""
    elif told.impossible:
        left = f"; not possible together: {told.impossible[0]}"
    return f"replay error on {r.of}: {before:.2g} → {after:.2g} rad (floor {floor:.1g}: encoders){torque}{left}"
