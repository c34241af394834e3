"""Positions against what a model's joints can do: their ranges, and how fast links of that mass can be moved."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from jax_inertia.logs.findings import Finding, Severity, run_bounds
from jax_inertia.logs.log import Log, TorqueUnit
from jax_inertia.model.robot import HINGE, Robot
from jax_inertia.preflight.torque_parts import parts, reach
from jax_inertia.preflight.units import POSITIONS, Unit, conversion

# Positions of hinges beyond so much are no angle, unless they turn on: two turns [rad].
FAR = 4.0 * np.pi
# No drive moves its own links with so many times their weight at the robot's whole reach: an arm that throws, 20 rad/s
# at 1 m, needs 40 in its own plane.
_HARDEST = 50.0
# Samples of a log that are no more than stray ones.
_HARDLY = 0.05
# A range is stated to a tenth of itself.
_ROOM = 0.1
# What moves by more than so many of its ranges is in another unit, wherever its zero is.
_TWICE = 2.0
# A stop is within this share of the range, of a joint that moves by so much of it, and is felt for so long [s].
_AT, _MOVES, _STANDS = 1e-3, 0.1, 0.2


def joint_ranges(log: Log, robot: Robot) -> Iterator[Finding]:
    """Joints out of the model's range as logged, and in it with the other sign, in another unit, or in none."""
    ranges = dict(zip(robot.joint_names, robot.joint_range, strict=True))
    kinds = [robot.joint_kinds[name] for name in log.joint_names]
    for j, (name, kind) in enumerate(zip(log.joint_names, kinds, strict=True)):
        low, high = ranges[name]
        q = np.asarray(log.qpos, float)[:, j]
        q = q[np.isfinite(q)]
        if not np.isfinite(high - low) or not q.size or _inside(q, low, high) > _HARDLY:
            continue
        hinge = kind == HINGE
        for unit in (_TURNED, *POSITIONS[hinge]):
            if _inside(unit.size * q, low, high) > 1.0 - _HARDLY:
                said = f"read as {unit.name}"
                if unit is _TURNED:
                    said = unit.name
                    way = "turn the sign of its qpos, qvel and qpos_target in the log, or the joint in the model"
                else:
                    names = log.joint_names if hinge and set(kinds) == {HINGE} else (name,)
                    way = conversion(unit, names, log.joint_names, kinds)
                message = (
                    f"qpos of {name!r} goes from {q.min():.3g} to {q.max():.3g}, out of the model's range "
                    f"[{low:.3g}, {high:.3g}] {'rad' if hinge else 'm'}, and {said} it is in it: {way}"
                )
                yield Finding(Severity.ERROR, "range", message)
                break
        else:
            if np.ptp(q) > _TWICE * (high - low):
                message = (
                    f"qpos of {name!r} moves by {np.ptp(q):.3g}, and the model's range is {high - low:.3g} "
                    f"{'rad' if hinge else 'm'} in all, [{low:.3g}, {high:.3g}]: in no unit that is known here; per "
                    f"cent? jax-inertia convert --position-scale {name}={(high - low) / 100:.3g} (the range of one per "
                    f"cent) --position-zero {name}=(its zero)"
                )
                yield Finding(Severity.ERROR, "range", message)


def end_stops(log: Log, robot: Robot) -> Iterator[Finding]:
    """Joints that move, and for a while stand where the model's range ends: the stop may carry part of their torque."""
    ranges = dict(zip(robot.joint_names, robot.joint_range, strict=True))
    time = np.asarray(log.time, float)
    for j, name in enumerate(log.joint_names):
        q, (low, high) = np.asarray(log.qpos, float)[:, j], ranges[name]
        room = _AT * (high - low)
        if not np.isfinite(room) or not np.nanmax(q) - np.nanmin(q) > _MOVES * (high - low):
            continue
        at = (np.abs(q - low) < room) | (np.abs(q - high) < room)
        stands = [(a, b) for a, b in run_bounds(at) if time[b - 1] - time[a] > _STANDS]
        if stands:
            longest = max(stands, key=lambda one: time[one[1] - 1] - time[one[0]])
            total = sum(time[b - 1] - time[a] for a, b in stands)
            message = (
                f"{name!r} stands at an end of the model's range for {total:.2g} s (from {time[longest[0]]:.4g} s on): "
                "its stop may carry part of its torque there; cut these stretches out"
            )
            yield Finding(Severity.WARNING, "stop", message)


def impossible_motion(log: Log, robot: Robot) -> Iterator[Finding]:
    """Hinges beyond two turns whose links would need torques that no drive has."""
    q = np.asarray(log.qpos, float)
    none = np.zeros_like(q)
    bare = dataclasses.replace(
        log, qvel=None, tau=none, tau_unit=TorqueUnit.NEWTON_METRE, tau_unit_text=""
    )
    if (
        not np.nanmax(np.abs(q), initial=0.0) > FAR
        or (p := parts(bare, robot, kp=np.ones(q.shape[1]))) is None
    ):
        return
    # Friction is free, and with it a rotor's inertia: what turns about its own axis may turn fast.
    needed = np.sqrt(np.mean(p.less_friction(p.weight + p.inertia) ** 2, axis=0)).max()
    times = float(needed) / (9.81 * float(np.asarray(robot.pi)[:, 0].sum()) * reach(robot))
    if times > _HARDEST:
        message = (
            f"qpos cannot be rad: to move so, the robot would need {times:.2g} times its weight at its whole reach. "
            "Degrees: jax-inertia convert --degrees; counts of an encoder: jax-inertia convert --position-scale (rad "
            "of one) --position-zero (its zero)"
        )
        yield Finding(Severity.ERROR, "unit", message)


_TURNED = Unit("with its sign turned", -1.0)


def _inside(q: Float[np.ndarray, " T"], low: float, high: float) -> float:
    """Share of positions that are in a range, give or take a tenth of it."""
    room = _ROOM * (high - low)
    return float(np.mean((q > low - room) & (q < high + room)))
