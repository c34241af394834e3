"""Whether a log's torque is the torque of its model: said in one line, with a number and a way on, before any fit.

Every joint's torque is compared with what the model needs (`torque_parts`), and with `other_readings`: without gravity,
with gravity turned, by one gain for each joint, with joints in another order, and late. A reading is a finding where it
leaves less than a third of what the plain model leaves (a ninth of the energy), and little of the torque itself.
Friction, rotor inertia, offsets and a load at the robot's ends are free in all of them, so that none of these is taken
for another reading; what else is wrong in a model is for a diagnosis.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np

from jax_inertia.logs.findings import Finding, Severity
from jax_inertia.logs.log import Log, TorqueUnit
from jax_inertia.model.robot import Robot
from jax_inertia.preflight import gravity_readings, other_readings, position_readings
from jax_inertia.preflight.column_order import order
from jax_inertia.preflight.compared import Compared, norm
from jax_inertia.preflight.other_readings import FITS, Reading, error
from jax_inertia.preflight.own_numbers import by_own_numbers
from jax_inertia.preflight.torque_parts import LAG, Parts, parts, reach
from jax_inertia.signals.held import with_loop_torque

# Of the energy that the plain model leaves, another reading leaves less than this.
_LEAVES = 1.0 / 9.0
# Where the plain model leaves less than this of the torque's energy, nothing is read otherwise but the unit of all
# positions, in which a rotor's inertia and a load may stand for what the motion is too small for; and below the latter
# not even that.
_SOUND, _TRUE = 0.05, 0.002
# The first of a loop's torque: that is nearly proportional to the motion in any unit, and a plain model leaves less.
_LEAVES_LOOP = 1.0 / 6.0
# One of many readings that were tried leaves less than this share of what the plain model leaves; and any that does may
# leave more than `FITS`.
_FAR = 1.0 / 25.0
# What says more must leave less than this share of what a simpler reading leaves.
_BETTER = 0.25
# A diagnosis looks for delays itself, up to the latter; what is later would be read as forces and frictions [s].
_LATE, _TOO_LATE = 0.03, 0.04
# Targets from another zero are off by more than a wrong mass makes a loop sag [rad, m].
_ELSEWHERE = 0.3
# A body's radius of gyration beyond so many times the robot's reach is a unit's fault.
_SIZES = 10.0
# Friction and rotor inertia that a model lacks are reported from this share of a joint's torque on.
_DRY = 0.03

# From the simplest to what explains most.
_READINGS = (
    other_readings.unlogged,
    other_readings.gains,
    gravity_readings.weightless,
    order,
    other_readings.inertia_unit,
    other_readings.external,
    other_readings.pairs,
    *position_readings.READINGS,
    gravity_readings.mount,
    other_readings.own_gains,
)


def against_model(log: Log, robot: Robot) -> tuple[Finding, ...]:
    """Findings on a log in N m that `preflight` passes, against its model; none where all is as it should be.

    An error is for a log whose estimate would be senseless, a warning for who reads results. Of logs with a floating
    base or contacts, and of those that hardly move, nothing is said. Of a log without torque the torque of its position
    loop is compared, where the log holds targets and gains: by that only its positions are read otherwise.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.preflight.against_model import against_model
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> against_model(swing(), load_model(double_pendulum()))
    ()
    """
    return judged(log, robot)[0]


def judged(log: Log, robot: Robot) -> tuple[tuple[Finding, ...], bool]:
    """`against_model`, and whether a torque shows that positions are what the model takes them for."""
    if found := tuple(bodies(robot)):
        return found, False
    if (split := _split(log, robot)) is None:
        return (), False
    light, compared = gravity_readings.lifted(Compared.of(split))
    if not compared.judged.any():
        return (), False
    late: tuple[Finding, ...] = ()
    if split.kp is None:
        late, compared = in_time(compared)
    other = otherwise(compared) or tuple(by_own_numbers(compared) if split.kp is None else ())
    sound = (
        not (other or light) and compared.left_beside_load(compared.tau - compared.needed) < _SOUND
    )
    if split.kp is not None:
        return (*light, *other) or tuple(from_another_zero(split)), sound
    # What is late by part of a sample still looks like friction.
    return (*light, *other, *late) or tuple(without_friction(compared)), sound


def _split(log: Log, robot: Robot) -> Parts | None:
    """The parts of a log's torque, or of its position loop's; None where neither is known in N m."""
    if log.tau is not None:
        newton_metres = log.tau_unit is TorqueUnit.NEWTON_METRE
        return parts(log, robot) if newton_metres else None
    if log.qpos_target is None or log.kp is None:
        return None
    # Velocities may be in another unit than positions: those of the loop are differences of the latter.
    bare = dataclasses.replace(log, qvel=None)
    return parts(with_loop_torque(bare, log.kp, log.kd), robot, kp=np.asarray(log.kp, float))


def from_another_zero(split: Parts) -> Iterator[Finding]:
    """Targets off by more than the loop sags under the model's weight: its torque has that mean that nothing needs."""
    missing = split.torque[split.index] - split.weight - split.inertia
    rows = np.maximum(split.used.sum(axis=0), 1)
    off = np.sum(np.where(split.used, missing, 0.0), axis=0) / rows / split.kp
    far = np.flatnonzero(np.abs(off) > _ELSEWHERE)
    if len(far):
        text = ", ".join(f"{split.names[j]} {off[j]:+.2f}" for j in far)
        message = (
            f"targets are off what the loop's gains and the model's weight say ({text} rad, m in the mean): another "
            "zero (a policy's default?), or other gains; for the former: jax-inertia convert --target-offset "
            f"{' '.join(f'{split.names[j]}={-off[j]:.3g}' for j in far)}"
        )
        yield Finding(Severity.WARNING, "targets", message)


def bodies(robot: Robot) -> Iterator[Finding]:
    """A body whose inertia is in another unit than its mass, by its radius of gyration against the robot's reach."""
    far = reach(robot)
    pi = np.asarray(robot.pi)
    mass = np.maximum(pi[:, 0], 1e-12)
    centre = np.sum((pi[:, 1:4] / mass[:, None]) ** 2, axis=1)
    square = np.where(pi[:, 0] > 1e-6, 0.5 * pi[:, [4, 7, 9]].sum(axis=1) / mass - centre, 0.0)
    worst = int(np.argmax(square))
    if square[worst] > (_SIZES * far) ** 2:
        moment = 2.0 / 3.0 * mass[worst] * square[worst]
        message = (
            f"{robot.body_names[worst]}: {mass[worst]:.3g} kg with {moment:.2g} kg m² is a "
            f"body of {np.sqrt(square[worst]):.3g} m on a robot of {far:.2g} m: inertia in another unit (g mm², g "
            "cm²)? give kg m² in the model"
        )
        yield error("inertia_unit", message)


def in_time(c: Compared) -> tuple[tuple[Finding, ...], Compared]:
    """What is late by more than a diagnosis looks for, and the torques where they belong."""
    most = min(int(LAG / c.parts.period), int(c.parts.index[0]))
    span = np.arange(-most, most + 1)
    shifts, lags, curves = np.zeros(len(c.judged), int), {}, {}
    for j in np.flatnonzero(c.judged).tolist():
        # By one factor: a delay leaves gravity and inertia in proportion, which friction with a memory does not. Or
        # gravity is out of the torque.
        shifted = np.stack([c.parts.later(int(s), j) for s in span], axis=1)
        energy = np.maximum(np.sum(shifted**2, axis=0), 1e-300)
        both = [1.0 - _along(x, shifted) / energy for x in (c.needed[:, j], c.inertia[:, j])]
        curves[j] = left = min(both, key=np.min)
        best = int(np.argmin(left))
        clear = left[best] < min(_LEAVES * left[most], FITS) and 0 < best < 2 * most
        if not clear:
            continue
        lag = (span[best] + _vertex(left[best - 1 : best + 2])) * c.parts.period
        if abs(lag) > max(_LATE, 1.5 * c.parts.period):
            shifts[j], lags[j] = span[best], lag
    if not lags:
        return (), c
    at = most + round(float(np.median(list(lags.values()))) / c.parts.period)
    # Joints that move too slowly to tell must not speak against it.
    alike = all(left[min(max(at, 0), 2 * most)] <= left[most] for left in curves.values())
    return tuple(_late(c, lags, alike)), c.shifted(shifts)


def _along(x: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Energy of columns along x."""
    return (x @ columns) ** 2 / max(x @ x, 1e-300)


def _vertex(y: np.ndarray) -> float:
    """Where a parabola through three equal steps is least, from the middle one."""
    bend = y[0] - 2.0 * y[1] + y[2]
    return float(0.5 * (y[0] - y[2]) / bend) if bend > 0 else 0.0


def _late(c: Compared, lags: dict[int, float], alike: bool) -> Iterator[Finding]:
    values = np.array(list(lags.values()))
    several = len(lags) > 1 or c.judged.sum() == 1
    if alike and several and np.ptp(values) < 2.0 * c.parts.period:
        lag = float(np.median(values))
        which, way = "every joint", f"give --shift-torque {-lag:.3f}"
    else:
        lag, which = float(values[0]), repr(c.parts.names[next(iter(lags))])
        way = "put each in time"
        if len(lags) > 1:
            rest = ", ".join(f"{c.parts.names[j]} {1e3 * x:.0f} ms" for j, x in lags.items())
            which = f"{which} (all: {rest})"
    side = "behind" if lag > 0 else "ahead of"
    grave = np.abs(values).max() > _TOO_LATE
    yield Finding(
        Severity.ERROR if grave else Severity.WARNING,
        "late",
        f"tau of {which} runs {1e3 * abs(lag):.0f} ms {side} qpos, which were stamped at different ends; {way}",
    )


def otherwise(c: Compared) -> tuple[Finding, ...]:
    """The reading of the log that leaves least, where the plain one leaves far more."""
    loop, whole = c.parts.kp is not None, c.as_it_stands()
    if whole < _TRUE:
        return ()
    doubtful = loop or whole < _SOUND
    if loop:
        readings, sound, least = position_readings.READINGS, _TRUE, _LEAVES_LOOP
    elif doubtful:
        readings, sound, least = (position_readings.units,), _TRUE, _FAR
    else:
        readings, sound, least = _READINGS, _SOUND, _LEAVES
    fitting: list[Reading] = []
    best = None
    for reading in readings:
        for one in reading(c):
            plain = whole if one.plain is None else one.plain
            leaves = _FAR if one.searched else least
            if plain < sound or not one.left < min(leaves * plain, max(FITS, _FAR * plain)):
                continue
            fitting.append(one)
            if best is None or one.left < _BETTER * best.left:
                best = one
    if best is None:
        return () if doubtful else tuple(other_readings.nothing(c))
    # What says more and fits no better is not said, unless it is about something else altogether.
    alike = [x for x in fitting if x.left < best.left / _BETTER and _places(x, best)]
    if not alike:
        return (best.finding,)
    other = alike[0].finding.message
    return (best.finding._replace(message=f"{best.finding.message}; or else {other}"),)


def _places(one: Reading, best: Reading) -> bool:
    """Whether a turned mount and a joint's zero are the two readings: about the first joint they are the same."""
    return {one.finding.check, best.finding.check} == {"mount", "zero"}


def without_friction(c: Compared) -> Iterator[Finding]:
    """A model without friction, damping and armature at any joint, where the log shows them at most of its joints."""
    robot = c.parts.robot
    if any(np.any(np.asarray(x)) for x in (robot.frictionloss, robot.damping, robot.armature)):
        return
    if c.left(c.needed) > FITS:
        return
    parts, load = c.parts, c.masses(c.tau - c.needed)
    missing = c.raw - parts.weight - parts.inertia
    # A load may look like friction, and be taken for one.
    lost = np.minimum(parts.lost(missing), parts.lost(missing - parts.load @ load))
    unknown = norm(c.tau - c.needed - c.load @ load)
    # Sums over the rows that are used, as root mean squares.
    rows = np.sqrt(np.maximum(parts.used.sum(axis=0), 1))
    clear = np.flatnonzero(c.judged & (lost * rows > np.maximum(_DRY * c.size, unknown)))
    if 2 * len(clear) <= c.judged.sum():
        return
    text = ", ".join(f"{parts.names[j]} {lost[j]:.2g}" for j in clear)
    message = (
        "the model has no friction, damping or armature at any joint, and tau holds them (rms in N m: "
        f"{text}); diagnose fits all three at every joint, estimate does with --calibrate"
    )
    yield Finding(Severity.WARNING, "no_friction", message)


__all__ = ["Reading", "against_model"]
