"""A log and a model that need not hold the same joints: what is held, what is left out, and a note of each."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from jax_inertia.logs.findings import Finding, Severity
from jax_inertia.logs.log import Log, LogError
from jax_inertia.maths.inertial_parameters import pseudo_inertia
from jax_inertia.model.lock import hinge_motion, locked
from jax_inertia.model.robot import HINGE, SLIDE, Robot
from jax_inertia.text.closest_names import listed, suggestion

# Joints at a robot's ends that the log lacks are held where they move no more than this share of the robot's mass.
_SLIGHT = 0.05
# What is held must not have moved by more than this in the log [rad, m].
_STILL = 0.02
# A wheel's masses lie otherwise by no more than this share, of its mass and its radius of gyration, once it has turned.
_ROUND = 0.01


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
    at the model's reference if the logs lack them, or where their master (URDF mimic) has them; and so are wheels, and
    joints of other branches on a fixed base. Joints that follow one another (mimic, joint equality) are held where they
    stand still, and where they are as light as fingers. What the
    logs have and the model lacks is left out. Joints that are still missing are for `preflight` to report. Raises
    LogError for a joint that neither has, for one that is to be held and moves, and for joints that follow one another
    and move: the constraint's torque is in no log.
    """
    notes: list[str] = []
    held = _asked(robot, logs, fix or {}, joints)
    if held:
        notes.append(f"held by option: {_told(held)}")
    coupled, moving = _coupled(robot, logs, held)
    robot = locked(robot, held | coupled)
    if still := {name: x for name, x in coupled.items() if name not in moving}:
        notes.append(f"held, since they follow one another and stand still: {_told(still)}")
    have = logs[0].joint_names
    light = _light(robot, logs) if any(name in have for name in robot.joint_names) else {}
    if light:
        notes.append(
            f"the log lacks {_told(light)}: light and at the robot's end, so held there; --fix JOINT=VALUE holds it "
            "elsewhere"
        )
        robot = locked(robot, light)
    if aside := _aside(robot, have):
        notes.append(
            f"the log lacks {_told(aside)}: in branches of their own, or turning what is round, so that no "
            "logged torque depends on where they stand"
        )
        robot = locked(robot, aside)
    wanted = set(_scalar(robot))
    out = []
    for log in logs:
        extra = [name for name in log.joint_names if name not in wanted]
        if extra and wanted <= set(log.joint_names):
            log = log.select([name for name in log.joint_names if name in wanted])
            if unknown := [name for name in extra if name not in held and name not in coupled]:
                notes.append(f"left out, not in the model: {listed(unknown)}")
        out.append(log)
    unique = dict.fromkeys(notes)
    findings = [Finding(Severity.NOTE, "joints", note) for note in unique]
    if moving:
        told = _told({name: coupled[name] for name in moving})
        message = (
            f"joints that follow one another move in the log, and are light: held in their middle place ({told}); "
            "their own torques are not looked at"
        )
        findings.append(Finding(Severity.WARNING, "coupled", message))
    return robot, tuple(out), tuple(findings)


def _told(places: Mapping[str, float]) -> str:
    return ", ".join(f"{name} at {value:.4g}" for name, value in places.items())


def _scalar(robot: Robot) -> list[str]:
    kinds = zip(robot.joint_names, robot.joint_type, strict=True)
    return [name for name, kind in kinds if kind in (HINGE, SLIDE)]


def _asked(
    robot: Robot, logs: Sequence[Log], fix: Mapping[str, float], joints: Sequence[str] | None
) -> dict[str, float]:
    """Joints that are to be held, as asked, with their positions; LogError where that cannot be."""
    held, have, scalar = dict(fix), logs[0].joint_names, _scalar(robot)
    for name in [*(joints or ()), *held]:
        if name not in scalar:
            raise LogError(f"the model has no hinge or slide {name!r}; {suggestion(name, scalar)}")
    for name in fix:
        if name in have:
            _still(logs, name)
    if joints is not None:
        if lacking := [name for name in joints if name not in have]:
            raise LogError(f"the log has no joint {lacking[0]!r}; {suggestion(lacking[0], have)}")
        rest = [name for name in have if name in scalar and name not in joints and name not in held]
        held |= {name: _still(logs, name) for name in rest}
    return held


def _coupled(
    robot: Robot, logs: Sequence[Log], held: Mapping[str, float]
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Joints that follow one another and are to be held, with their positions, and which of them move.

    At rest the constraint between them only adds to torques that are not looked at any more. LogError where they move
    and are no trifle: its torque is in none of their rows alone.
    """
    have = {name for log in logs for name in log.joint_names}
    out: dict[str, float] = {}
    moving: tuple[str, ...] = ()
    for group in _groups(robot):
        known = {d.joint: d.offset for d in robot.driven if d.joint in group and not d.master}
        asked = {name: held[name] for name in group if name in held}
        logged = [name for name in group if name in have]
        restless = [name for name in logged if _travel(logs, name) > _STILL]
        if not (logged or asked or known):
            continue
        if restless and (asked or known or not _is_light(robot, group, have)):
            rest = [name for name in group if name not in logged]
            if not asked and len(logged) == 1 and rest and _is_light(robot, rest, have):
                continue
            how = "follow one another" if len(group) > 1 else "is kept in its place"
            raise LogError(
                f"{listed(group)} {how} in the model (joint equality, mimic), and {restless[0]!r} moves by "
                f"{_travel(logs, restless[0]):.3g} in the log: the constraint carries torque that no log of joints "
                "tells; record them at rest, or take the constraint out if the real robot has none"
            )
        places = known | {name: _middle(logs, name) for name in logged} | asked
        # From what is known to what hangs on it, and back.
        for _ in group:
            for d in robot.driven:
                if d.master in places and d.joint in group:
                    places.setdefault(d.joint, d.factor * places[d.master] + d.offset)
                elif d.joint in places and d.master in group and d.factor:
                    places.setdefault(d.master, (places[d.joint] - d.offset) / d.factor)
        out |= {name: places[name] for name in group if name in places and name not in asked}
        moving += tuple(group) if restless else ()
    return out, moving


def _groups(robot: Robot) -> list[list[str]]:
    """Joints that follow one another, those of a group in the robot's order."""
    groups: list[set[str]] = []
    for d in robot.driven:
        one = {d.joint, d.master} - {""}
        joined = [g for g in groups if g & one]
        groups = [g for g in groups if not g & one] + [one.union(*joined)]
    return [[name for name in robot.joint_names if name in g] for g in groups]


def _values(logs: Sequence[Log], name: str) -> np.ndarray:
    """A joint's positions in all logs that have it, as far as they are finite [rad, m]."""
    columns = [
        np.asarray(log.qpos)[:, log.joint_names.index(name)]
        for log in logs
        if name in log.joint_names
    ]
    return np.concatenate([x[np.isfinite(x)] for x in columns])


def _travel(logs: Sequence[Log], name: str) -> float:
    """How far a joint moves in logs that have it [rad, m]; NaN where nothing is known."""
    values = _values(logs, name)
    return float(np.ptp(values)) if values.size else np.nan


def _middle(logs: Sequence[Log], name: str) -> float:
    values = _values(logs, name)
    return float(np.median(values)) if values.size else 0.0


def _is_light(robot: Robot, names: Sequence[str], have: Collection[str]) -> bool:
    """Whether joints at a robot's ends move no more than a trifle of its mass, and none that the logs have."""
    top, mass = robot.topology, np.asarray(robot.pi)[:, 0]
    dof = dict(zip(robot.joint_names, robot.joint_dofadr, strict=True))
    node = {name: int(top.dof_node[adr]) for name, adr in dof.items()}
    others = [name for name in robot.joint_names if name in have and name not in names]
    carries = any(top.ancestors[node[other], node[name]] for other in others for name in names)
    moved = np.any(top.body_dof[:, [dof[name] for name in names]] > 0, axis=1)
    return not carries and bool(mass[moved].sum() <= _SLIGHT * mass.sum())


def _still(logs: Sequence[Log], name: str) -> float:
    """Where a joint stands in logs [rad, m]; LogError if it moves."""
    if not (moved := _travel(logs, name)) <= _STILL:
        raise LogError(
            f"joint {name!r} is to be held and moves by {moved:.3g} in the log; keep it among the joints"
        )
    return _middle(logs, name)


def _light(robot: Robot, logs: Sequence[Log]) -> dict[str, float]:
    """Joints that the logs lack and that may be held, with their positions."""
    scalar = _scalar(robot)
    have = {name: log for log in reversed(logs) for name in log.joint_names}
    masters = {d.joint: d for d in robot.driven}
    out = {}
    for name in scalar:
        if name in have or not _is_light(robot, [name], have):
            continue
        node = robot.topology.dof_node[robot.joint_dofadr[robot.joint_index(name)]]
        out[name] = float(robot.joint_reference[node])
        driven = masters.get(name)
        if driven is not None and (log := have.get(driven.master)) is not None:
            column = np.asarray(log.qpos)[:, log.joint_names.index(driven.master)]
            out[name] = driven.factor * float(np.nanmedian(column)) + driven.offset
    return out


def _aside(robot: Robot, have: Collection[str]) -> dict[str, float]:
    """Joints that the logs lack and on whose positions no torque of theirs depends, at the model's reference."""
    node = {
        name: int(robot.topology.dof_node[robot.joint_dofadr[robot.joint_index(name)]])
        for name in _scalar(robot)
    }
    moves = robot.topology.ancestors.astype(bool)
    logged = [node[name] for name in have if name in node]
    out = {}
    for name in (name for name in node if name not in have and logged):
        k = node[name]
        # What a joint that is logged hangs on tells how it lies.
        if any(moves[other, k] for other in logged):
            continue
        carried = robot.has_free_base or any(moves[k, other] for other in logged)
        if not carried or _round(robot, k):
            out[name] = float(robot.joint_reference[k])
    return out


def _round(robot: Robot, node: int) -> bool:
    """Whether the bodies that a hinge turns have the same mass distribution at every angle, as a wheel has."""
    top = robot.topology
    if top.kind[node] != HINGE:
        return False
    anchor = np.asarray(robot.joint_position[node])
    whole = np.zeros((4, 4))
    for body in np.flatnonzero(top.ancestors[list(top.body_node), node]).tolist():
        pose, k = np.eye(4), top.body_node[body]
        while k != node:
            pose = _placed(robot, k) @ pose
            k = top.parent[k]
        pose[:3, 3] -= anchor
        whole += pose @ np.asarray(pseudo_inertia(robot.pi[body])) @ pose.T
    turned, _ = hinge_motion(np.asarray(robot.joint_axis[node]), anchor, 1.0)
    other = np.eye(4)
    other[:3, :3] = turned
    size = np.sqrt(max(np.trace(whole[:3, :3]), 1e-300) / max(whole[3, 3], 1e-300))
    scale = np.array([size, size, size, 1.0])
    off = (other @ whole @ other.T - whole) / np.outer(scale, scale)
    return bool(np.linalg.norm(off) <= _ROUND * whole[3, 3])


def _placed(robot: Robot, node: int) -> np.ndarray:
    """Pose of a node in its parent at the model's reference (4, 4)."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = robot.placement_rotation[node], robot.placement_position[node]
    return out
