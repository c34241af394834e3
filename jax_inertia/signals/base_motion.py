"""Velocity of a floating base that logs an IMU, or attitude alone, and no position.

The equations of motion stay as they are where the whole robot is elsewhere, or moves faster at a constant velocity: of
the base they need attitude, angular velocity and acceleration. A log without `base_pos` gets a velocity that has this
acceleration, and a position that says no more than how high the base stands. There are two sources, each good where the
other is not:

* the accelerometer: v̇ = R f + g, f the specific force at the IMU. Its bias makes v drift;
* feet that bear load do not slip: v = ω_f × (r n) − d/dt (R p_f), ω_f a foot's angular velocity, p_f its centre as seen
  from the base, which is a ball of radius r on ground of normal n, or a sole (r = 0). What gives, or is set down, errs.

With both, v follows the accelerometer above `CROSSOVER` and the feet below it (least squares, both with white errors),
so that a bias of the accelerometer is gone. Without an accelerometer the feet alone close the three linear rows. Where
none stands, v goes straight from what it was to what it will be, as in free fall: left out, such moments would bias
what the robot is found to weigh, for errors of v cancel over a whole log, and not over parts of it.
"""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy import integrate, linalg, ndimage

from jax_inertia.dynamics import rigid_body
from jax_inertia.logs.findings import run_bounds
from jax_inertia.logs.log import Log, LogError
from jax_inertia.maths.finite_difference import derivative
from jax_inertia.maths.over_samples import OverSamples
from jax_inertia.model.robot import Robot
from jax_inertia.signals.filtering import Masked
from jax_inertia.signals.generalised_motion import Motion, body_rates, generalised
from jax_inertia.signals.ground.support import Foot, reported_contact, supported

CROSSOVER = 0.5
"""Below this [Hz] the feet say how fast the base is, above it the accelerometer: slower than any step."""
TOUCHES = 0.15
"""Share of the weight that no foot bears of a robot in the air."""
STANDS = 0.4, 0.8
"""Share of the load of the foot that bears most from which another one may stand, and from which it does."""
UNSURE = 0.25
"""By how much forces are off by which a base moves while no foot stands, and how deep feet sink, in parts of them."""
SETTLES = 0.03
"""A foot stands that has borne load for this long, and will for as long [s]: what sets it down rings."""
RINGS = 3.0
"""Time constants of a soft contact until nothing is left of how fast its foot came down."""


def motion_of(source: Masked, robot: Robot, rng: np.random.Generator | None = None) -> Motion:
    """Generalised coordinates of a log on a uniform grid, of a base that logs an IMU too.

    With `rng` the feet's velocity is off once more, by as much as they contradict each other. Raises LogError as
    `generalised`, and where nothing shows how the base accelerates.
    """
    return generalised(with_base(source, robot, rng), robot)


def unmoved(log: Log) -> Log:
    """A log of an IMU as if its base stayed where it is and only turned: enough for what depends on posture alone."""
    if log.base_pos is not None or log.base_quat is None:
        return log
    none = np.zeros((len(log.time), 3))
    turned = log.base_angvel
    if turned is None:
        turned = body_rates(np.asarray(log.time, float), np.asarray(log.base_quat))
    return dataclasses.replace(log, base_pos=none, base_linvel=none, base_angvel=turned)


def with_base(source: Masked, robot: Robot, rng: np.random.Generator | None = None) -> Masked:
    """A log on a uniform grid with `base_pos` [m], `base_linvel` [m/s] and `base_angvel` [rad/s] of the base it lacks.

    As it is where the robot does not float, or the log knows where it is. Raises LogError where nothing tells how the
    base accelerates.
    """
    log = source.log
    if not robot.has_free_base or log.base_pos is not None or log.base_quat is None:
        return source
    time = np.asarray(log.time, float)
    still = unmoved(log)
    motion = generalised(dataclasses.replace(source, log=still), robot)
    rotation, position = _poses(robot, np.asarray(motion.q))
    felt = None
    if log.base_linacc is not None:
        felt = _accelerations(robot, still, motion, rotation)
    legs = standing(robot, motion, rotation, position, log, felt)
    known = np.zeros(len(time)) if legs is None else legs.stands.max(axis=1)
    walked = None if legs is None else _odometry(robot, motion, rotation, legs, rng)
    if felt is None:
        if walked is None or legs is None:
            raise LogError(
                "the log has neither base_pos nor base_linacc (an accelerometer), and no foot of the model stands on "
                "the ground: nothing shows how the base accelerates; log one of them"
            )
        velocity = _bridged(time, walked, legs.carried, known > 0, rng)
    else:
        velocity = _fused(time, felt, walked, known)
    low = np.zeros(len(time))
    if legs is not None:
        soles = [_centre(rotation, position, f)[:, 2] - f.radius for f in legs.feet]
        low = np.min(soles, axis=0)
    at = np.column_stack([np.zeros((len(time), 2)), -low])
    moved = dataclasses.replace(still, base_pos=at, base_linvel=velocity)
    return dataclasses.replace(source, log=moved)


@dataclasses.dataclass(frozen=True)
class Legs:
    """The feet, and how firmly each stands: 0 in the air, 1 under load."""

    feet: Sequence[Foot]
    stands: Float[np.ndarray, "T C"]
    sinks: Float[np.ndarray, "T C"]
    """How fast each goes into the ground [m/s]."""
    carried: Float[np.ndarray, "T 3"]
    """Acceleration of the base's origin [m/s²] by the forces at the feet, for what they carry in the mean."""


def standing(
    robot: Robot,
    motion: Motion,
    rotation: Float[np.ndarray, "T nb 3 3"],
    position: Float[np.ndarray, "T nb 3"],
    log: Log,
    acceleration: Float[np.ndarray, "T 3"] | None = None,
) -> Legs | None:
    """Which feet stand when: as `contact_flag` or `contact_force` say, else by the loads that the legs' torques show.

    `acceleration` [m/s²] is the base's, where it is known. None for a robot that touches nothing.
    """
    q, v = np.asarray(motion.q), np.asarray(motion.v)
    a = derivative(np.asarray(motion.time), v)
    if acceleration is not None:
        a[:, :3] = acceleration
    missing = _needed(robot, (q, v, a)) - np.asarray(motion.tau)
    support = supported(robot, motion, missing, log, 0.0)
    if support is None:
        return None
    rate, feet = 1.0 / float(np.median(np.diff(motion.time))), support.feet
    mass, gravity = float(jnp.sum(robot.pi[:, 0])), np.asarray(robot.gravity)
    weight = -mass * gravity
    load = support.wrench[:, :, :3] @ weight / (weight @ weight)
    reported = reported_contact(log, support.bodies, np.asarray(motion.time))
    if reported is not None:
        load = np.where(np.isnan(reported), load, reported)
    # Of the foot that bears most, where the robot is not in the air.
    share = load / np.maximum(load.max(axis=1, keepdims=True), TOUCHES)
    firm = np.clip((share - STANDS[0]) / (STANDS[1] - STANDS[0]), 0.0, 1.0)
    force = support.wrench[:, :, :3].sum(axis=1)
    # What the feet carry in the mean is the robot's weight, whatever the model says.
    heavy = max(-force.mean(axis=0) @ gravity / (gravity @ gravity), TOUCHES * mass)
    carried = a[:, :3] + force / heavy - missing[:, :3] / mass
    return Legs(feet, _settled(firm, feet, rate), support.sinks, carried)


def _settled(
    firm: Float[np.ndarray, "T C"], feet: Sequence[Foot], rate: float
) -> Float[np.ndarray, "T C"]:
    """Of feet that stand, those that have for a while, and will: a soft one needs longer to come to rest."""
    out = np.zeros_like(firm)
    after = round(SETTLES * rate)
    for k, foot in enumerate(feet):
        time = 1.0 / np.sqrt(foot.soft[0]) if foot.soft[0] > 0 else 0.0
        before = max(after, round(RINGS * time * rate))
        own = firm[:, k]
        past = ndimage.minimum_filter1d(own, before + 1, mode="nearest", origin=before // 2)
        ahead = -((after + 1) // 2)
        future = ndimage.minimum_filter1d(own, after + 1, mode="nearest", origin=ahead)
        out[:, k] = np.minimum(past, future)
    return out


def _odometry(
    robot: Robot,
    motion: Motion,
    rotation: Float[np.ndarray, "T nb 3 3"],
    legs: Legs,
    rng: np.random.Generator | None,
) -> Float[np.ndarray, "T 3"]:
    """Velocity of the base [m/s] by which the standing feet roll on the ground; their mean by load.

    With `rng` it has an error as large as its own: how far each foot is off that mean, at another moment and with a
    sign by chance, and grounds softer or harder than the model's by `UNSURE`.
    """
    bodies = tuple(f.body for f in legs.feet)
    moves = _moves((robot, bodies), (np.asarray(motion.q), np.asarray(motion.v)))
    each = np.zeros((len(rotation), len(bodies), 3))
    known = 1.0 if rng is None else 1.0 + UNSURE * rng.choice([-1.0, 1.0])
    for k, foot in enumerate(legs.feet):
        arm = rotation[:, foot.body] @ np.array(foot.point) - [0.0, 0.0, foot.radius]
        each[:, k] = -moves[:, k, :3] - np.cross(moves[:, k, 3:], arm)
        each[:, k, 2] -= legs.sinks[:, k] * known
    share = legs.stands / np.maximum(legs.stands.sum(axis=1, keepdims=True), 1e-9)
    velocity = np.einsum("tk,tkc->tc", share, each)
    if rng is None:
        return velocity
    # Of n feet each is off their mean by (n - 1) / n of its own error, in variance; a foot alone shows nothing.
    alone = np.clip(1.0 - np.sum(share**2, axis=1), 0.25, 1.0)
    off = share[:, :, None] * (each - velocity[:, None]) / np.sqrt(alone)[:, None, None]
    error = np.einsum("k,tkc->tc", rng.choice([-1.0, 1.0], len(bodies)), off)
    return velocity + np.roll(error, rng.integers(len(error)), axis=0)


def _accelerations(
    robot: Robot, log: Log, motion: Motion, rotation: Float[np.ndarray, "T nb 3 3"]
) -> Float[np.ndarray, "T 3"]:
    """Acceleration of the base's origin [m/s²], world axes, by the specific force at the IMU."""
    body = robot.body_index(log.imu_body or robot.body_names[0])
    at = np.zeros(3) if log.imu_pos is None else np.asarray(log.imu_pos)
    moves = _moves((robot, (body,)), (np.asarray(motion.q), np.asarray(motion.v)))[:, 0]
    # Of the IMU, as seen from the base's origin.
    around = moves[:, :3] + np.cross(moves[:, 3:], rotation[:, body] @ at)
    felt = np.einsum("tij,tj->ti", rotation[:, body], np.asarray(log.base_linacc))
    return felt + np.asarray(robot.gravity) - derivative(np.asarray(motion.time), around)


def _fused(
    time: Float[np.ndarray, " T"],
    acceleration: Float[np.ndarray, "T 3"],
    walked: Float[np.ndarray, "T 3"] | None,
    known: Float[np.ndarray, " T"],
) -> Float[np.ndarray, "T 3"]:
    """The velocity v that least squares take for the right one,

        min Σ h (Δv/h − a)² + Σ h ω² k (v − w)²,    ω = 2π `CROSSOVER`,

    a the accelerometer's, w the feet's where they are known (k), h the grid's period.
    """
    h = float(np.median(np.diff(time)))
    feet = np.zeros_like(acceleration) if walked is None else walked
    trust = h * (2.0 * np.pi * CROSSOVER) ** 2 * known
    # A robot that nothing touches is as fast as one likes, in the mean.
    trust = trust + 1e-9 * h
    band = np.zeros((2, len(time)))
    band[0, 1:] = -1.0 / h
    band[1] = trust
    band[1, :-1] += 1.0 / h
    band[1, 1:] += 1.0 / h
    mean = 0.5 * (acceleration[1:] + acceleration[:-1])
    right = trust[:, None] * feet
    right[:-1] -= mean
    right[1:] += mean
    return linalg.solveh_banded(band, right)


def _bridged(
    time: Float[np.ndarray, " T"],
    x: Float[np.ndarray, "T 3"],
    acceleration: Float[np.ndarray, "T 3"],
    known: np.ndarray,
    rng: np.random.Generator | None,
) -> Float[np.ndarray, "T 3"]:
    """A velocity where no foot stands: as it was before and will be, between as an acceleration has it.

    Of the acceleration its mean over a gap plays no part: what the robot weighs is not assumed. With `rng` what it adds
    to a straight line is off by `UNSURE` of it, one way or the other.
    """
    summed = integrate.cumulative_trapezoid(acceleration, time, axis=0, initial=0.0)
    straight, detour = _across(x, known), summed - _across(summed, known)
    if rng is not None:
        for start, stop in run_bounds(~known):
            detour[start:stop] *= 1.0 + UNSURE * rng.choice([-1.0, 1.0], 3)
    return straight + detour


def _across(x: Float[np.ndarray, "T 3"], known: np.ndarray) -> Float[np.ndarray, "T 3"]:
    at = np.arange(len(x))
    return np.stack([np.interp(at, at[known], column[known]) for column in x.T], axis=1)


def _centre(rotation, position, foot: Foot) -> Float[np.ndarray, "T 3"]:
    return position[:, foot.body] + rotation[:, foot.body] @ np.array(foot.point)


_poses = OverSamples(rigid_body.body_poses)


@OverSamples
def _needed(robot: Robot, x):
    q, v, a = x
    return rigid_body.inverse_dynamics(robot, q, v, a) - rigid_body.passive_torque(robot, q, v)


@OverSamples
def _moves(shared, x):
    robot, bodies = shared
    q, v = x
    return jnp.stack([rigid_body.body_jacobian(robot, q, b) @ v for b in bodies])
