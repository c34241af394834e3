"""Closed-loop replays: a log's targets through MuJoCo's own dynamics, many variants of a model at once."""

import os
from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float
from mujoco import rollout

from jax_inertia.replay.joint_numbers import OF_BODIES, Numbers
from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.plant import Compiled, Plant
from jax_inertia.replay.record import Record, controls

_ROLLS, _STEPPED = 16, 64
_LOST = 10.0
"""Where a simulation diverges, its error is taken to be this [rad]."""
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_A_THREAD = 8
_FRICTION_EVERY = 2e-3
"""Dry friction that varies is set anew this often [s]."""


def replay(
    plant: Plant,
    table: Sequence[Parameter],
    thetas: Float[np.ndarray, "B P"],
    record: Record,
) -> Float[np.ndarray, "B T n"]:
    """Positions as the encoders would log them, of every vector."""
    every = [plant.numbers(table, theta, record.loop) for theta in thetas]
    kinds = [(plant.structure(x), x.varies) for x in every]
    out = np.empty((len(thetas), *record.q.shape))
    for kind in dict.fromkeys(kinds):
        mine = [b for b, k in enumerate(kinds) if k == kind]
        most = _STEPPED if kind[1] else _ROLLS
        for first in range(0, len(mine), most):
            rows = mine[first : first + most]
            out[rows] = _some(plant, kind, [every[b] for b in rows], record)
    return out


def _some(plant: Plant, kind, some: Sequence[Numbers], record: Record) -> np.ndarray:
    structure, varies = kind
    m, h = plant.compiled(structure), plant.step
    steps = int(np.ceil(record.time[-1] / h)) + 1
    models = plant.variants(structure, some)
    state = np.zeros((len(some), mujoco.mj_stateSize(m.model, _STATE)))
    control = np.zeros((len(some), steps, m.model.nu))
    cache: dict[bytes, np.ndarray] = {}
    data = mujoco.MjData(m.model)
    for b, x in enumerate(some):
        key = np.concatenate([x.delay, x.lag, x.kp, x.kd]).tobytes()
        if record.commanded.velocity is None and record.commanded.torque is None:
            key = np.concatenate([x.delay, x.lag]).tobytes()
        if key not in cache:
            cache = dict(list(cache.items())[-2:])
            cache[key] = controls(record, h, steps, x.delay, x.lag, x.kp, x.kd)
        control[b][:, m.act] = (cache[key] - x.offset) * m.gear
        if m.dead is not None:
            control[b][:, m.dead] = control[b][:, m.act]
        mujoco.mj_resetData(models[b], data)
        data.qpos[m.qadr], data.qvel[m.dof] = record.q[0] - x.offset, record.start
        mujoco.mj_getState(models[b], data, state[b], _STATE)
    run = _stepwise if varies else _at_once
    path = run(m, models, some, state, control, h)
    q = np.concatenate([state[:, None, 1 + m.qadr], path[:, :, 1 + m.qadr]], axis=1)
    # A MuJoCo that has diverged starts anew from its reference posture: the clock shows it.
    lost = np.diff(path[:, :, 0], axis=1) <= 0
    where = record.time / h
    k = np.minimum(where.astype(int), steps - 1)
    share = (where - k)[:, None]
    now = q[:, k] + share * (q[:, k + 1] - q[:, k]) + np.stack([x.offset for x in some])[:, None]
    now[lost.any(axis=1)] = record.q + _LOST
    return np.nan_to_num(now, nan=_LOST)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2


def _at_once(m: Compiled, models, some, state, control, h: float) -> np.ndarray:
    data = [mujoco.MjData(m.model) for _ in range(min(_cores(), len(models)))]
    path, _ = rollout.rollout(models, data, state, control, persistent_pool=True)
    return path


def _stepwise(m: Compiled, models, some: Sequence[Numbers], state, control, h: float) -> np.ndarray:
    """The same where dry friction goes by torque or velocity: it is set anew between short rollouts."""
    every = max(round(_FRICTION_EVERY / h), 1)
    steps, nq = control.shape[1], m.model.nq
    path = np.empty((len(models), steps, state.shape[1]))
    fields = [k for k in Numbers._fields if k not in OF_BODIES]
    of_joints = {k: np.stack([getattr(x, k) for x in some]) for k in fields}
    stacked = Numbers(**of_joints, mass={}, centres={})
    # A thread is worth its wake-up for several models, each of a step or two.
    threads = min(_cores() - 1, len(models) // _A_THREAD)
    data, now = [mujoco.MjData(m.model) for _ in range(max(threads, 1))], state
    commanded = control[:, :, m.act] / m.gear
    with rollout.Rollout(nthread=threads) as roll:
        for k in range(0, steps, every):
            q, v = now[:, 1 + m.qadr], now[:, 1 + nq + m.dof]
            # Both sides without the encoders' offset.
            dry = stacked.friction(stacked.torque(commanded[:, k], q, v), q, v)
            for model, own in zip(models, dry, strict=True):
                model.dof_frictionloss[m.dof] = own
            some_control = np.ascontiguousarray(control[:, k : k + every])
            part = np.empty((len(models), some_control.shape[1], state.shape[1]))
            seen = np.empty((*part.shape[:2], m.model.nsensordata))
            roll.rollout(
                models, data, now, some_control, skip_checks=True, nstep=part.shape[1], state=part, sensordata=seen
            )  # fmt: skip
            path[:, k : k + every] = part
            now = np.ascontiguousarray(part[:, -1])
    return path
