"""What is fitted and what is replayed: the loops of logs, their records, and the numbers that a model may be off by."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.settings import Settings
from jax_inertia.logs.log import Log, LogError, TorqueKind
from jax_inertia.maths.sample_weight import autocorrelation_time
from jax_inertia.model.joint_inertia import bodies_off_their_axes
from jax_inertia.model.mujoco_types import MjModel
from jax_inertia.replay import checks
from jax_inertia.replay.command import of_the_loop, with_damping
from jax_inertia.replay.loop import (
    NO_JOINT,
    OFF,
    Loop,
    Parameter,
    ordinary,
    position_loop,
)
from jax_inertia.replay.record import SETTLING, Record, record_of
from jax_inertia.replay.result import OTHER_RUN
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import replay

VALIDATION_SHARE, TEST_SHARE = 0.25, 0.2
"""Of each log, its last part, which is the test where no test log is given; of the rest, what effects are chosen by."""
GUARD_SHARE = 0.25
"""Of a held-out stretch, what the guard band before it takes at most."""
LONGEST, SHORTEST = 60.0, 8.0
"""Of all logs together what is fitted at most, and replayed as gate; of each at least [s]."""

FLOATS = (
    "the model's base floats, and a replay needs to know what carries it; log a robot that hangs "
    "with its base fixed, and give --fix-base"
)


def check_base(model: MjModel) -> None:
    """Raise `LogError` for a base that floats."""
    free = model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)
    if free.any():
        raise LogError(FLOATS)


class Parts(NamedTuple):
    """Rows of the logs by what they are for."""

    fit: list[Record]
    """Numbers are fitted to them."""
    validation: tuple[Record, ...]
    """Effects are chosen by them."""
    whole: list[Record]
    """Both: the numbers that are chosen are fitted to all of it."""
    test: tuple[Record, ...]
    """Read once, at the end."""
    of: str
    """What the test is called."""


class Loops(NamedTuple):
    """The loop of each log, and whether torques are an output of the replays."""

    fit: list[Loop]
    validation: Loop
    test: Loop
    torque: bool
    """Whether all logs but the test have the torque of their loop."""
    test_torque: bool


def loops_of(
    logs: Sequence[Log],
    validation_log: Log | None,
    test_log: Log | None,
    model: Callable[[], MjModel],
    kp,
    kd,
) -> Loops:
    """The loops of all logs; what the test log holds changes nothing of the others."""
    loops = [position_loop(log, model(), kp, kd) for log in logs]
    others = [
        loops[0] if one is None else position_loop(one, model(), kp, kd)
        for one in (validation_log, test_log)
    ]
    every = [*zip(logs, loops, strict=True)]
    if validation_log is not None:
        every.append((validation_log, others[0]))
    torque = all(of_the_loop(one, own) for one, own in every)
    if torque:
        loops = [with_damping(own, one) for own, one in zip(loops, logs, strict=True)]
        others = [x if x.kd.any() else x._replace(kd=loops[0].kd) for x in others]
    also = torque and (test_log is None or of_the_loop(test_log, others[1]))
    return Loops(loops, others[0], others[1], torque, also)


def split_records(
    plant: Plant,
    logs: Sequence[Log],
    loops: Loops,
    validation_log: Log | None,
    test_log: Log | None,
) -> Parts:
    """Rows to fit, to choose by, and to quote; stretches of one log are parted by guard bands (`_memory`).

    Without other logs each log's last part is the test, and a part before it the validation; of several logs, whole
    ones.
    """
    torque = loops.torque
    records = [record_of(log, x, torque=torque) for log, x in zip(logs, loops.fit, strict=True)]
    for r in records:
        if np.ptp(r.target, axis=0).max() < 1e-3:
            raise LogError("qpos_target never changes: it cannot show how the robot follows")
    test, validation, of = (), (), OTHER_RUN
    longest = max(LONGEST / len(records), SHORTEST)
    if test_log is not None:
        test = (record_of(test_log, loops.test, torque=loops.test_torque),)
    else:
        records, test = _cut(plant, records, TEST_SHARE)
        of = "the last part of the log" if len(logs) == 1 else "the last parts of the logs"
        if len(records) < len(logs):
            of = f"{len(test)} of the {len(logs)} logs"
    records = [_first(r, longest) for r in records]
    whole: Sequence[Record] = records
    if validation_log is not None:
        validation = (record_of(validation_log, loops.validation, torque=torque),)
        whole = [*records, *validation]
    else:
        records, validation = _cut(plant, records, VALIDATION_SHARE)
        if len(records) < len(whole):
            whole = [*records, *validation]
    records, validation, whole, test = (
        checks.settling(plant, [_first(r, longest) for r in rs])
        for rs in (records, validation, whole, test)
    )
    return Parts(records, tuple(validation), whole, tuple(test), of)


def _cut(
    plant: Plant, records: Sequence[Record], share: float
) -> tuple[list[Record], tuple[Record, ...]]:
    """(what is kept, what is held out): whole records where that is the share of them, else their last parts.

    Whole runs need no guard, and are no stretch of a motion that was fitted. Last parts follow a guard band; how long
    it is, the first parts say.
    """
    count = round(share * len(records))
    if count and len(records) - count > 1:
        # Evenly over the order in which they are given, which often goes by gain or by motion.
        held = {int((k + 0.5) * len(records) / count) for k in range(count)}
        kept, out = ([r for k, r in enumerate(records) if (k in held) == o] for o in (False, True))
        return kept, tuple(out)
    rows = [round((1.0 - share) * len(r.time)) for r in records]
    first = [r.between(0, k) for r, k in zip(records, rows, strict=True)]
    guard = _memory(plant, first)
    last = []
    for r, k in zip(records, rows, strict=True):
        band = min(guard, GUARD_SHARE * (r.time[-1] - r.time[k]))
        last.append(r.between(int(np.searchsorted(r.time, r.time[k] + band)), len(r.time)))
    return first, tuple(last)


def _memory(plant: Plant, records: Sequence[Record]) -> float:
    """How long what the nominal model lacks is remembered [s]: the longest autocorrelation time of its errors."""
    errors = [replay(plant.quick, (), np.zeros((1, 0)), r)[0] - r.q for r in records]
    times = [
        autocorrelation_time(x) * r.period
        for e, r in zip(errors, records, strict=True)
        for x in e[r.settled].T
    ]
    return max(max(times), SETTLING)


def _first(r: Record, seconds: float) -> Record:
    return r.between(0, int(np.searchsorted(r.time, seconds, side="right")))


def typical_torque(plant: Plant, records: Sequence[Record]) -> Float[np.ndarray, " n"]:
    """What gravity and inertia ask of each joint along the logs, rms [N m]."""
    data, parts = mujoco.MjData(plant.model), []
    for r in records:
        wide = max(int(0.05 / r.period), 1)
        rows = np.arange(2 * wide, len(r.q) - 2 * wide, max(len(r.q) // 200, 1))
        # Curvature over ten hundredths of a second: of the encoders' counts nothing is left.
        bend = (r.q[rows + 2 * wide] - 2 * r.q[rows] + r.q[rows - 2 * wide]) / (
            2 * wide * r.period
        ) ** 2
        for k, a in zip(rows, bend, strict=True):
            mujoco.mj_resetData(plant.model, data)
            data.qpos[plant.qadr] = r.q[k]
            mujoco.mj_forward(plant.model, data)
            weight = data.qfrc_bias[plant.dof].copy()
            parts.append(np.abs(weight) + plant.inertia(r.q[k]) * np.abs(a))
    return np.maximum(np.sqrt(np.mean(np.square(parts), axis=0)), 1e-3)


def ordinary_numbers(
    plant: Plant,
    records: Sequence[Record],
    torque: Float[np.ndarray, " n"],
    loops: Sequence[Loop],
    logs: Sequence[Log],
) -> tuple[Parameter, ...]:
    """The ordinary numbers about those of the plant's model."""
    m, dofs = plant.model, plant.dof
    inertia = np.mean([plant.inertia(r.q[k]) for r in records for k in (0, len(r.q) // 2)], axis=0)
    kind = m.jnt_type[m.dof_jntid[dofs]]
    heaviest = np.array([inertia[kind == k].max() for k in kind])
    own = m.dof_armature[dofs], m.dof_damping[dofs], m.dof_frictionloss[dofs]
    logged = records[0].torque is not None
    commanded = all(one.tau_kind is TorqueKind.COMMANDED for one in logs)
    kinds = {"torque_logged": logged, "commanded": commanded, "early": plant.own.early}
    return ordinary(plant.loop, *own, inertia, heaviest, torque, loops, **kinds)


def tolerances(plant: Plant) -> tuple[Parameter, ...]:
    """By what a nominal model's masses, inertias and centres of mass are off."""
    sds = dict.fromkeys(OFF, Settings.com_tolerance)
    sds |= {"mass_share": Settings.mass_tolerance, "inertia_share": Settings.inertia_tolerance}
    return tuple(
        Parameter(f, NO_JOINT, 0.0, sd, -0.5, 0.5, plant.model.body(b).name)
        for b in bodies_off_their_axes(plant.model)
        for f, sd in sds.items()
    )
