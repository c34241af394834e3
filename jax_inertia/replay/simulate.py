"""Closed-loop replays: a log's targets through MuJoCo's own dynamics, many variants of a model at once."""

import copy
import os
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float
from mujoco import rollout
from scipy.signal import lfilter

from jax_inertia.logs.log import Log
from jax_inertia.model.mujoco_types import MjModel, MjSpec
from jax_inertia.replay.loop import Loop, Parameter, actuators_on

STEP = 2e-3
"""The longest step [s]; a stiff loop on a light joint gets a shorter one."""
_STEPS_PER_RADIAN = 4.0
_ROLLS = 16
_LOST = 10.0
"""Where a simulation diverges, its error is taken to be this [rad]."""


class Record(NamedTuple):
    """What a replay needs of a log, or of a stretch of it: from 0 s, in the log's order of joints."""

    time: Float[np.ndarray, " T"]
    q: Float[np.ndarray, "T n"]
    start: Float[np.ndarray, " n"]
    """Velocities at the first stamp."""
    told: Float[np.ndarray, " S"]
    """Stamps of all targets, those before the stretch too: who is late still follows them."""
    targets: Float[np.ndarray, "S n"]

    @property
    def period(self) -> float:
        """Median, s."""
        return float(np.median(np.diff(self.time)))

    @property
    def target(self) -> Float[np.ndarray, "T n"]:
        """Those at the stamps of the stretch."""
        first = len(self.told) - len(self.time)
        return self.targets[first:]

    @property
    def settled(self) -> Bool[np.ndarray, " T"]:
        """Samples that count: targets from before the log began, and how fast joints were, is soon forgotten."""
        return self.time >= min(SETTLING, 0.1 * self.time[-1])

    def between(self, first: int, last: int) -> "Record":
        """The samples of a range of rows, as a record of its own."""
        q, time = self.q[first:last], self.time[first:last]
        before = len(self.told) - len(self.time)
        upto = before + first + len(time)
        return Record(
            time - time[0], q, slope(time, q), self.told[:upto] - time[0], self.targets[:upto]
        )


SETTLING = 0.2
"""Of a replay's start, what does not count [s]."""


def record_of(log: Log) -> Record:
    """The record of a log with targets, what is not finite bridged."""
    time = np.asarray(log.time, float)
    time = time - time[0]
    q, target = (_bridged(time, np.asarray(x, float)) for x in (log.qpos, log.qpos_target))
    return Record(time, q, slope(time, q), time, target)


def _bridged(time: np.ndarray, x: np.ndarray) -> np.ndarray:
    out = x.copy()
    for column in out.T:
        good = np.isfinite(column)
        if good.any() and not good.all():
            column[~good] = np.interp(time[~good], time[good], column[good])
    return out


def slope(time: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Velocity at the start, by a parabola through the first 50 ms or five samples."""
    k = max(5, int(np.searchsorted(time - time[0], 0.05)))
    k = min(k, len(time))
    t = time[:k] - time[0]
    return np.linalg.lstsq(np.stack([t**0, t, t**2], 1), q[:k], rcond=None)[0][1]


def with_loop(spec: MjSpec, names: Sequence[str], loop: Loop) -> None:
    """Give every named joint one position actuator with the loop's gains, in place of whatever acts on it.

    Actuators keep the name of the one that they replace; those of other joints stay.
    """
    for j, name in enumerate(names):
        old = [
            a for a in spec.actuators if a.trntype == mujoco.mjtTrn.mjTRN_JOINT and a.target == name
        ]
        label = old[0].name if old else ""
        for a in old:
            spec.delete(a)
        new = spec.add_actuator(name=label or f"{name}_position", target=name)
        new.trntype = mujoco.mjtTrn.mjTRN_JOINT
        set_gains(new, loop.kp[j], loop.kd[j], loop.limit[j])


def set_gains(actuator, kp: float, kd: float, limit: float) -> None:
    """Make an actuator of a spec the position actuator of these gains and this limit."""
    actuator.set_to_position(kp=kp, kv=kd)
    if np.isfinite(limit):
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = np.array([-limit, limit])


def fixed_base(spec: MjSpec) -> None:
    """Take the free joints out of a spec, and contacts: of a robot that hangs in the air."""
    free = [j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_FREE]
    for joint in free:
        spec.delete(joint)
    for key in list(spec.keys):
        spec.delete(key)
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)


_FILTERS = mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT


def actuator_of(spec: MjSpec, joint: str):
    """The last actuator on a joint of a spec."""
    on_joint = [
        a for a in spec.actuators if a.trntype == mujoco.mjtTrn.mjTRN_JOINT and a.target == joint
    ]
    return on_joint[-1]


class Plant:
    """A model with position actuators at a log's joints, to be replayed with other numbers than its own.

    The spec is changed. `holds`: dry friction holds a joint at rest, which MuJoCo's own figures let creep.
    """

    def __init__(self, spec: MjSpec, names: Sequence[str], loop: Loop, *, holds: bool = False):
        if loop.source != "model":
            with_loop(spec, names, loop)
        # Delay and lag of the model are of the targets, which get them before they get there.
        self.delay, self.lag = np.zeros((2, len(names)))
        for j, name in enumerate(names):
            a = actuator_of(spec, name)
            self.delay[j] = a.delay
            a.delay, a.nsample = 0.0, 0
            if a.dyntype in _FILTERS:
                self.lag[j] = a.dynprm[0]
                a.dyntype = mujoco.mjtDyn.mjDYN_NONE
        self.model: MjModel = spec.compile()
        self.names, self.loop = tuple(names), loop
        joints = [self.model.joint(name).id for name in names]
        self.qadr = self.model.jnt_qposadr[joints]
        self.dof = self.model.jnt_dofadr[joints]
        self.act = np.array([actuators_on(self.model, j)[-1] for j in joints])
        self.gear = self.model.actuator_gear[self.act, 0]
        self.model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        if holds:
            self.model.dof_solimp[self.dof] = HOLD
        own = self.inertia(np.zeros(len(names)))
        stiff = float(np.sqrt(np.max(loop.kp / own)))
        self.model.opt.timestep = min(STEP, 1.0 / (_STEPS_PER_RADIAN * stiff))
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2
        self.data = [mujoco.MjData(self.model) for _ in range(min(cores, _ROLLS))]

    def inertia(self, q: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Each joint's own inertia at a posture, rotor included [kg m²]."""
        data, full = mujoco.MjData(self.model), np.zeros((self.model.nv,) * 2)
        data.qpos[self.qadr] = q
        mujoco.mj_forward(self.model, data)
        mujoco.mj_fullM(self.model, full, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(
            self.model, data, full
        )
        return np.diagonal(full)[self.dof].copy()

    def variant(self, table: Sequence[Parameter], theta: Float[np.ndarray, " P"]) -> MjModel:
        """The model with the numbers of a vector."""
        m = copy.copy(self.model)
        for p, x in zip(table, theta, strict=True):
            d, a = self.dof[p.joint], self.act[p.joint]
            if p.family == "armature":
                m.dof_armature[d] = x
            elif p.family == "viscous_friction":
                m.dof_damping[d] = max(x - self.loop.kd[p.joint], 0.0)
                kd = min(x, self.loop.kd[p.joint])
                m.actuator_biasprm[a, 2] = -kd / self.gear[p.joint] ** 2
            elif p.family == "coulomb_friction":
                m.dof_frictionloss[d] = x
            elif p.family == "kp_scale":
                m.actuator_gainprm[a, 0] *= np.exp(x)
                m.actuator_biasprm[a, 1] *= np.exp(x)
            elif p.family == "torque_bias":
                m.actuator_biasprm[a, 0] += x / self.gear[p.joint]
            elif p.family == "torque_saturation":
                m.actuator_forcelimited[a] = 1
                m.actuator_forcerange[a] = (
                    np.exp(x) / abs(self.gear[p.joint]) * np.array([-1.0, 1.0])
                )
            elif p.family == "payload":
                b = m.body(p.body).id
                # More of the same body: its centre and its shape are kept.
                share = max(1.0 + x / m.body_mass[b], 0.05)
                m.body_inertia[b] *= share
                m.body_mass[b] *= share
        return m

    def replay(
        self, table: Sequence[Parameter], thetas: Float[np.ndarray, "B P"], record: Record
    ) -> Float[np.ndarray, "B T n"]:
        """Positions as the encoders would log them, of every vector."""
        h = self.model.opt.timestep
        steps = int(np.ceil(record.time[-1] / h)) + 1
        where = record.time / h
        k = np.minimum(where.astype(int), steps - 1)
        share = (where - k)[:, None]
        size = mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        out = np.empty((len(thetas), *record.q.shape))
        cache: dict[bytes, np.ndarray] = {}
        for first in range(0, len(thetas), _ROLLS):
            some = thetas[first : first + _ROLLS]
            models = [self.variant(table, x) for x in some]
            control = np.zeros((len(some), steps, self.model.nu))
            state = np.zeros((len(some), size))
            offset = np.zeros((len(some), len(self.names)))
            for b, theta in enumerate(some):
                delay, lag, offset[b] = timing(table, theta, len(self.names))
                delay, lag = delay + self.delay, lag + self.lag
                key = np.concatenate([delay, lag]).tobytes()
                if key not in cache:
                    cache = {
                        key: controls(record, h, steps, delay, lag),
                        **dict(list(cache.items())[:2]),
                    }
                control[b][:, self.act] = (cache[key] - offset[b]) * self.gear
                data = self.data[0]
                mujoco.mj_resetData(models[b], data)
                data.qpos[self.qadr], data.qvel[self.dof] = record.q[0] - offset[b], record.start
                mujoco.mj_getState(models[b], data, state[b], mujoco.mjtState.mjSTATE_FULLPHYSICS)
            path, _ = rollout.rollout(models, self.data, state, control)
            q = np.concatenate([state[:, None, 1 + self.qadr], path[:, :, 1 + self.qadr]], axis=1)
            # A MuJoCo that has diverged starts anew from its reference posture: the clock shows it.
            lost = np.diff(path[:, :, 0], axis=1) <= 0
            now = q[:, k] + share * (q[:, k + 1] - q[:, k]) + offset[:, None]
            now[lost.any(axis=1)] = record.q + _LOST
            out[first : first + len(some)] = np.nan_to_num(now, nan=_LOST)
        return out


HOLD = np.array([0.9999, 0.9999, 0.001, 0.5, 2.0])
"""solimp of dry friction that holds a joint at rest.

With MuJoCo's own (0.9) friction creeps under load f at R f / b, R = (1 − 0.9)/0.9 / M and b ≈ 100 / s: 0.3 N m on
0.03 kg m² at 10 mrad/s, so that a joint which its friction stops short of a target gets there within seconds. On a real
arm replays of slow motions erred by 41 mrad so, and by 16 mrad with this figure.
"""


def timing(table, theta, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Delay and lag of the targets, and encoder offset, of each joint."""
    delay, lag, offset = np.zeros((3, n))
    for p, x in zip(table, theta, strict=True):
        at = slice(None) if p.joint < 0 else p.joint
        if p.family == "target_delay":
            delay[at] += x
        elif p.family == "target_lag":
            lag[at] += max(x, 0.0)
        elif p.family == "encoder_offset":
            offset[at] += x
    return delay, lag, offset


def controls(
    record: Record,
    h: float,
    steps: int,
    delay: Float[np.ndarray, " n"],
    lag: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "S n"]:
    """The mean over each step of the targets, held from stamp to stamp, delayed and behind a first-order lag.

    Means, not samples: a delay of a part of a step counts, and replays are smooth in it.
    """
    edges = np.append(record.told, record.told[-1] + record.period)
    area_of = record.targets * np.diff(edges)[:, None]
    whole = np.concatenate([np.zeros((1, record.q.shape[1])), np.cumsum(area_of, axis=0)])
    at = np.arange(steps + 1) * h
    out = np.empty((steps, record.q.shape[1]))
    for j, (d, late) in enumerate(zip(delay, lag, strict=True)):
        t = at - d
        area = np.interp(t, edges, whole[:, j])
        # Before the first target and after the last it is held.
        area += np.minimum(t - edges[0], 0.0) * record.targets[0, j]
        area += np.maximum(t - edges[-1], 0.0) * record.targets[-1, j]
        out[:, j] = np.diff(area) / h
        if late > 1e-4:
            keep = np.exp(-h / late)
            out[:, j] = lfilter([1 - keep], [1, -keep], out[:, j], zi=[keep * out[0, j]])[0]
    return out
