"""A log and a model that need not hold the same joints: what is held, what is left out, and a note of each."""

from collections.abc import Mapping, Sequence

import numpy as np

from jax_inertia.logs.findings import Finding, Severity
from jax_inertia.logs.log import Log, LogError
from jax_inertia.model.lock import locked
from jax_inertia.model.robot import HINGE, SLIDE, Robot
from jax_inertia.text.closest_names import listed, suggestion

# Joints at a robot's ends that the log lacks are held where they move no more than this share of the robot's mass.
_SLIGHT = 0.05
# What is held must not have moved by more than this in the log [rad, m].
_STILL = 0.02


def same_joints(
    robot: Robot,
    logs: Sequence[Log],
    *,
    fix: Mapping[str, float] | None = None,
    joints: Sequence[str] | None = None,
) -> tuple[Robot, tuple[Log, ...], tuple[Finding, ...]]:
    """Robot and logs with the same hinges and slides where that can be, and a note of what was done.

    `fix` holds joints of the model at positions [rad, m]; `joints` are those of the logs that count: the others are
    held where the first log has them, if it has. Fingers and the like, at a robot's ends and light against it, are held
    at the model's reference if the logs lack them, or where their master (URDF mimic) has them. What the logs have and
    the model lacks is left out. Joints that are still missing are for `preflight` to report. Raises LogError for a
    joint that neither has, and for one that is to be held and moves.
    """
    notes: list[str] = []
    held = dict(fix or {})
    have = logs[0].joint_names
    scalar = [
        n for n, k in zip(robot.joint_names, robot.joint_type, strict=True) if k in (HINGE, SLIDE)
    ]
    for name in [*(joints or ()), *held]:
        if name not in scalar:
            raise LogError(f"the model has no hinge or slide {name!r}; {suggestion(name, scalar)}")
    if joints is not None:
        if lacking := [name for name in joints if name not in have]:
            raise LogError(f"the log has no joint {lacking[0]!r}; {suggestion(lacking[0], have)}")
        rest = [name for name in have if name in scalar and name not in joints and name not in held]
        held |= {name: _still(logs, name) for name in rest}
    for name in held:
        if fix is not None and name in fix and name in have:
            _still(logs, name)
    if held:
        told = ", ".join(f"{name} at {value:.4g}" for name, value in held.items())
        notes.append(f"held, as asked: {told}")
    robot = locked(robot, held)
    light = _light(robot, logs) if any(name in have for name in robot.joint_names) else {}
    if light:
        told = ", ".join(f"{name} at {value:.4g}" for name, value in light.items())
        notes.append(
            f"the log lacks {told}: light and at the robot's end, so held there; --fix JOINT=VALUE holds it elsewhere"
        )
        robot = locked(robot, light)
    wanted = {
        n for n, k in zip(robot.joint_names, robot.joint_type, strict=True) if k in (HINGE, SLIDE)
    }
    out = []
    for log in logs:
        extra = [name for name in log.joint_names if name not in wanted]
        if extra and wanted <= set(log.joint_names):
            log = log.select([name for name in log.joint_names if name in wanted])
            if unknown := [name for name in extra if name not in held]:
                notes.append(f"left out, not in the model: {listed(unknown)}")
        out.append(log)
    unique = dict.fromkeys(notes)
    return robot, tuple(out), tuple(Finding(Severity.NOTE, "joints", note) for note in unique)


def _still(logs: Sequence[Log], name: str) -> float:
    """Where a joint stands in logs [rad, m]; LogError if it moves."""
    columns = [
        np.asarray(log.qpos)[:, log.joint_names.index(name)]
        for log in logs
        if name in log.joint_names
    ]
    values = np.concatenate([x[np.isfinite(x)] for x in columns])
    if not values.size or np.ptp(values) > _STILL:
        moved = np.ptp(values) if values.size else np.nan
        raise LogError(
            f"joint {name!r} is to be held and moves by {moved:.3g} in the log; keep it among the joints"
        )
    return float(np.median(values))


def _light(robot: Robot, logs: Sequence[Log]) -> dict[str, float]:
    """Joints that the logs lack and that may be held, with their positions."""
    top, mass = robot.topology, np.asarray(robot.pi)[:, 0]
    dof = dict(zip(robot.joint_names, robot.joint_dofadr, strict=True))
    kinds = zip(robot.joint_names, robot.joint_type, strict=True)
    scalar = [name for name, kind in kinds if kind in (HINGE, SLIDE)]
    have = {name: log for log in reversed(logs) for name in log.joint_names}
    node = {name: int(top.dof_node[dof[name]]) for name in scalar}
    masters = {d.joint: d for d in robot.driven}
    out = {}
    for name in scalar:
        if name in have:
            continue
        carries = any(top.ancestors[node[other], node[name]] for other in scalar if other in have)
        moved = mass[top.body_dof[:, dof[name]] > 0].sum()
        if carries or moved > _SLIGHT * mass.sum():
            continue
        out[name] = float(robot.joint_reference[node[name]])
        driven = masters.get(name)
        if driven is not None and (log := have.get(driven.master)) is not None:
            column = np.asarray(log.qpos)[:, log.joint_names.index(driven.master)]
            out[name] = driven.factor * float(np.nanmedian(column)) + driven.offset
    return out
