"""What is fitted and what is replayed: the loops of logs, their records, and the numbers that a model may be off by."""

from collections.abc import Callable, Sequence

import mujoco
import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.settings import Settings
from jax_inertia.logs.log import Log, LogError, TorqueKind
from jax_inertia.model.joint_inertia import bodies_off_their_axes
from jax_inertia.model.mujoco_types import MjModel
from jax_inertia.replay import checks
from jax_inertia.replay.command import of_the_loop, with_damping
from jax_inertia.replay.loop import (
    NO_JOINT,
    TOLERANCES,
    Loop,
    Parameter,
    ordinary,
    position_loop,
)
from jax_inertia.replay.record import Record, record_of
from jax_inertia.replay.result import OTHER_RUN
from jax_inertia.replay.simulation.plant import Plant

FIT_SHARE = 0.7
"""Of logs without another motion, what is fitted; the rest is replayed."""
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


def loops_of(
    logs: Sequence[Log], test_log: Log | None, model: Callable[[], MjModel], kp, kd
) -> tuple[list[Loop], Loop, bool]:
    """The loop of each log, that of the other run, and whether all logs have the torque of their loop."""
    loops = [position_loop(log, model(), kp, kd) for log in logs]
    test_loop = loops[0] if test_log is None else position_loop(test_log, model(), kp, kd)
    every = [*zip(logs, loops, strict=True), *([] if test_log is None else [(test_log, test_loop)])]
    torque_logged = all(of_the_loop(one, own) for one, own in every)
    if torque_logged:
        loops = [with_damping(own, one) for own, one in zip(loops, logs, strict=True)]
        test_loop = test_loop._replace(kd=loops[0].kd) if not test_loop.kd.any() else test_loop
    return loops, test_loop, torque_logged


def split_records(
    plant: Plant,
    logs: Sequence[Log],
    loops: Sequence[Loop],
    test_log: Log | None,
    test_loop: Loop,
    torque: bool,
) -> tuple[list[Record], list[Record], tuple[Record, ...], str]:
    """Whole records, what is fitted of them, what is replayed, and what the latter is called."""
    records = [record_of(log, loop, torque=torque) for log, loop in zip(logs, loops, strict=True)]
    wholes = records
    for r in records:
        if np.ptp(r.target, axis=0).max() < 1e-3:
            raise LogError("qpos_target never changes: it cannot show how the robot follows")
    if test_log is not None:
        held, of = (record_of(test_log, test_loop, torque=torque),), OTHER_RUN
    else:
        cuts = [int(FIT_SHARE * len(r.time)) for r in records]
        held = tuple(r.between(k, len(r.time)) for r, k in zip(records, cuts, strict=True))
        records = [r.between(0, k) for r, k in zip(records, cuts, strict=True)]
        of = f"the rest of the log{'s' if len(logs) > 1 else ''}"
    longest = max(LONGEST / len(records), SHORTEST)
    wholes = checks.settling(plant, [_first(r, longest) for r in wholes])
    if test_log is not None:
        return wholes, wholes, tuple(checks.settling(plant, held)), of
    records, shown = (
        checks.settling(plant, [_first(r, longest) for r in rs]) for rs in (records, held)
    )
    return wholes, records, tuple(shown), of


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
    own = m.dof_armature[dofs], m.dof_damping[dofs], m.dof_frictionloss[dofs]
    logged = records[0].torque is not None
    period = records[0].period
    commanded = all(one.tau_kind is TorqueKind.COMMANDED for one in logs)
    return ordinary(
        plant.loop, *own, inertia, torque, period, loops, torque_logged=logged, commanded=commanded
    )


def tolerances(plant: Plant) -> tuple[Parameter, ...]:
    """By what a nominal model's masses, inertias and centres of mass are off."""
    sds = dict.fromkeys(TOLERANCES, Settings.com_tolerance)
    sds |= {"mass_share": Settings.mass_tolerance, "inertia_share": Settings.inertia_tolerance}
    return tuple(
        Parameter(f, NO_JOINT, 0.0, sd, -0.5, 0.5, plant.model.body(b).name)
        for b in bodies_off_their_axes(plant.model)
        for f, sd in sds.items()
    )
