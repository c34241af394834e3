"""Replays that prove or disprove the numbers of a fit, and what is to be said of them."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.replay import checks
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.joint_numbers import Numbers
from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.record import Record, step_means
from jax_inertia.replay.result import Replayed, Torques, rms, total
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import misses, replay

Numbered = tuple[Sequence[Parameter], np.ndarray]
_DRAWN = 32
_CREEPS = 1.1


def paths(plant: Plant, table, theta, records: Sequence[Record]) -> tuple[np.ndarray, ...]:
    """Positions (T, n) of each record, replayed."""
    return tuple(replay(plant, table, theta[None], r)[0] for r in records)


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


def fan(plant: Plant, found: Fit, record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Between which positions (T, n) nine tenths of replays lie, of numbers drawn as the fit knows them."""
    low, high = (np.array([getattr(p, side) for p in found.table]) for side in ("low", "high"))
    size, way = np.linalg.eigh(found.covariance)
    rng = np.random.default_rng(0)
    off = rng.normal(size=(_DRAWN, len(size))) * np.sqrt(np.maximum(size, 0.0)) @ way.T
    away = found.theta != np.array([p.nominal for p in found.table])
    thetas = np.clip(np.where(away, found.theta + off, found.theta), low, high)
    lower, upper = np.percentile(replay(plant, found.table, thetas, record), (5.0, 95.0), axis=0)
    return lower, upper


def worse(r: Replayed, names: Sequence[str]) -> tuple[str, ...]:
    """Joints that the corrected model replays worse than the nominal one."""
    limits = np.maximum(1.05 * r.before, 1.5 * r.floor)
    return tuple(n for n, a, top in zip(names, r.after, limits, strict=True) if a > top)


def creeping(bare: Plant, found: Fit, r: Replayed) -> list[str]:
    """What is to be said where friction has to hold joints at rest."""
    creeping = total(r.error(paths(bare, found.table, found.theta, r.records)))
    if creeping <= _CREEPS * total(r.after):
        return []
    return [
        "friction that holds a joint at rest (solimpfriction in corrected.xml) matters: with MuJoCo's own, which "
        f"creeps, the same numbers err by {creeping:.2g} rad"
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
