"""Other ways to read a log's positions than its model's: units, counts, axes turned, zeros off.

The same motion is read in each way, and the model's torque for it compared with the log's, or with the torque of the
position loop behind its targets: of that each reading changes the size, too, as it does of the positions.
"""

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.preflight.compared import Compared
from jax_inertia.preflight.joint_ranges import FAR
from jax_inertia.preflight.other_readings import Reading, error
from jax_inertia.preflight.torque_parts import Parts
from jax_inertia.preflight.units import POSITIONS, conversion, per_joint

# Zeros may be off at so many joints.
_ZEROS = 3
# Encoders' counts a turn: of 8 to 20 bits, from 0 or about the middle.
_COUNTS = tuple(1 << bits for bits in range(8, 21))


def units(c: Compared) -> Iterator[Reading]:
    """Positions of all hinges, all slides or one joint in another unit; of hinges, in counts."""
    parts = c.parts
    kinds, hinge = parts.kinds, parts.hinges
    for kind in (True, False):
        joints = np.flatnonzero(hinge == kind)
        groups = [joints] if len(joints) < 2 else [joints, *joints[:, None]]
        for unit, group in itertools.product(POSITIONS[kind], groups if len(joints) else ()):
            scale = np.ones(len(hinge))
            scale[group] = unit.size
            names = [parts.names[j] for j in group]
            which = f"qpos of {', '.join(names)}" if len(group) < len(hinge) else "qpos"
            message = (
                f"{_fit(c)} if {which} is in {unit.name} (x {unit.size:.5g}); expected {'rad' if kind else 'm'}: "
                f"{conversion(unit, names, parts.names, kinds)}"
            )
            check = "degrees" if unit.name == "degrees" else "unit"
            alone = len(group) < len(joints)
            # One joint's positions are in every joint's torque.
            some = None if alone or not np.any(c.judged[joints]) else c.judged & (hinge == kind)
            left, plain = _left(c, parts.at(scale), some), c.as_it_stands(some)
            if alone and c.judged[group[0]] and not Compared.of(parts.at(scale)).judged[group[0]]:
                # So small that nothing of it is seen.
                continue
            yield Reading(left, error(check, message), plain, searched=alone)
    yield from _counts(c, hinge)


def _counts(c: Compared, hinge: Bool[np.ndarray, " n"]) -> Iterator[Reading]:
    """Counts of an encoder at every hinge, where positions are beyond any angle."""
    q = c.parts.motion[0][:, c.parts.places]
    if not hinge.any() or np.ptp(q[:, hinge], axis=0).max() < FAR:
        return
    names = [name for name, one in zip(c.parts.names, hinge, strict=True) if one]
    for count in _COUNTS:
        for zero in (0, count // 2):
            size = 2.0 * np.pi / count
            scale = np.where(hinge, size, 1.0)
            left = _left(c, c.parts.at(scale, np.where(hinge, -zero * size, 0.0)))
            message = (
                f"{_fit(c)} if qpos of {', '.join(names)} are counts of {count} a turn about {zero}; expected rad: "
                f"jax-inertia convert --position-scale {per_joint(size, names, c.parts.names)} --position-zero "
                f"{per_joint(zero, names, c.parts.names)}"
            )
            yield Reading(left, error("counts", message))


def axes(c: Compared) -> Iterator[Reading]:
    """One joint's axis turned, or the sign of its positions."""
    for j, name in ((j, c.parts.names[j]) for j in c.off.tolist()):
        turned = np.where(np.arange(len(c.parts.names)) == j, -1.0, 1.0)
        other = c.parts.at(turned)
        both = other if c.parts.kp is not None else _turned(other, turned)
        message = (
            f"{_fit(c)} if {name!r} runs the other way: its axis is turned in the model, or qpos and tau in the log; "
            "turn the sign of both"
        )
        yield Reading(_left(c, both), error("axis", message), searched=True)
        if c.parts.kp is None:
            message = f"{_fit(c)} if qpos of {name!r} has the other sign; turn it"
            yield Reading(_left(c, other), error("axis", message), searched=True)


def zeros(c: Compared) -> Iterator[Reading]:
    """Zeros of hinges off by a quarter or half a turn."""
    n, hinge = len(c.parts.names), c.parts.hinges
    ones, offset = np.ones(n), np.zeros(n)
    best = c.left_beside_load(c.tau - c.needed)
    for _ in range(_ZEROS):
        tried = [
            np.where(np.arange(n) == j, turn, offset)
            for j in c.off.tolist()
            if hinge[j] and offset[j] == 0
            for turn in (0.5 * np.pi, -0.5 * np.pi, np.pi)
        ]
        needed = [c.parts.moved(ones, x) for x in tried]
        left = [c.left_beside_load(c.tau - x) for x in needed]
        # One that is off more must help.
        if not left or min(left) > 0.5 * best:
            return
        least = int(np.argmin(left))
        best, offset = left[least], tried[least]
        text = ", ".join(
            f"{np.degrees(offset[j]):+.0f}° ({offset[j]:+.4f} rad) at {c.parts.names[j]}"
            for j in np.flatnonzero(offset)
        )
        message = f"{_fit(c)} if the zero of qpos is elsewhere: add {text}"
        yield Reading(c.left(needed[least]), error("zero", message), searched=True)


READINGS = (units, axes, zeros)
"""From the simplest on."""


def _left(c: Compared, other: Parts, joints: Bool[np.ndarray, " n"] | None = None) -> float:
    """What the same log leaves of its torque, read as `other`, with a load of that motion."""
    read = Compared.of(other).shifted(c.shifts)
    return read.left(read.needed, joints=joints)


def _turned(parts: Parts, sign: Float[np.ndarray, " n"]) -> Parts:
    return dataclasses.replace(parts, torque=parts.torque * sign)


def _fit(c: Compared) -> str:
    of = "torques" if c.parts.kp is None else "torques of the position loop"
    return f"{of} fit the motion"
