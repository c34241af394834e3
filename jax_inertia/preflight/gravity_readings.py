"""Readings of a log in which gravity acts otherwise than the model says: taken out, not taken out, turned."""

import dataclasses
from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.logs.findings import Finding, Severity
from jax_inertia.preflight.compared import Compared
from jax_inertia.preflight.other_readings import FITS, Reading, error

# What is in a torque leaves so many times as much where it is left out.
_SEEN = 4.0
# Below this, tilt is an effect of a diagnosis [rad], which tells it from a constant force.
_TURNED = 0.5
# What another cause leaves of what this one does, to be the better of the two: on one link a force is a turned gravity.
_CLEARLY = 0.5
# Gravity may come out this much off 9.81 m/s².
_STRENGTH = 0.15
_DOWN = np.array([0.0, 0.0, -9.81])


def weightless(c: Compared) -> Iterator[Reading]:
    """Gravity taken out of the torque by the controller."""
    if not c.carrying.any():
        return
    left = c.left_beside_load(c.tau - c.inertia, c.carrying)
    # The inertia must be seen, given whatever load is carried: else there is nothing of the robot in it.
    if c.left_beside_load(c.tau, c.carrying) < _SEEN * left:
        return
    gravity, inertia = c.factors(c.inertia + c.carried(c.tau - c.inertia))
    if abs(gravity) < 0.25:
        message = (
            f"tau holds no gravity (factor {gravity:.2f} at the model's gravity torque, {inertia:.2f} at its inertia): "
            "the controller took it out; --gravity-compensated adds the model's gravity to tau"
        )
        plain = c.left_beside_load(c.tau - c.needed, c.carrying)
        yield Reading(left, error("gravity", message), plain)


def lifted(c: Compared) -> tuple[tuple[Finding, ...], Compared]:
    """Gravity that the model takes out, by `gravcomp` or a gravity of 0, and the torque holds; and the model with it.

    Both models are as simple: the one that leaves clearly less, with a load, is right; a warning where neither does.
    """
    robot, direction = c.parts.robot, c.parts.direction
    if robot.compensated is None and np.any(direction):
        return (), c
    down = direction if np.any(direction) else _DOWN
    heavy = dataclasses.replace(robot, gravity=jnp.asarray(down), compensated=None)
    other = Compared.of(dataclasses.replace(c.parts, robot=heavy))
    light, with_it = c.as_it_stands(), other.as_it_stands()
    if light < _CLEARLY * with_it and with_it > FITS:
        return (), c
    what, way = "has a gravity of 0", 'give it <option gravity="0 0 -9.81"/>'
    if np.any(direction):
        what, way = "takes it out (gravcomp)", "take gravcomp out of the model"
    if with_it < _CLEARLY * light:
        message = f"tau holds gravity, and the model {what}, as simulations may; {way}"
        return (error("gravity", message),), other
    message = (
        f"the model {what.replace('it', 'gravity')}, and tau fits with a load on either model, with gravity and "
        f"without; where tau is what motors or sensors give, {way}"
    )
    return (Finding(Severity.WARNING, "gravity", message),), c


def mount(c: Compared) -> Iterator[Reading]:
    """A base that is mounted at another angle than the model's."""
    parts = c.parts
    # Directions of which the robot feels nothing stay the model's.
    gravity = parts.direction + _best(c, parts.less_friction(parts.gravity), c.judged)
    before, after = np.linalg.norm(parts.direction), np.linalg.norm(gravity)
    if before == 0 or abs(after / before - 1.0) > _STRENGTH:
        return
    angle = float(np.arccos(np.clip(gravity @ parts.direction / (before * after), -1, 1)))
    if angle < _TURNED or not c.weighing.any():
        return
    needed = c.inertia + parts.less_friction(parts.gravity @ gravity)
    left = c.left(needed, joints=c.weighing)
    if any(_beside(c, pull) < _CLEARLY * left for pull in parts.forces()):
        # A constant force on one body says it better: that is a diagnosis' to find.
        return
    message = (
        f"torques fit the motion if gravity is turned by {np.degrees(angle):.0f}°, to "
        f"({', '.join(f'{x:.2f}' for x in gravity)}) m/s²: the base is mounted otherwise than in the model; give "
        f"--mount={mounting(gravity)}"
    )
    plain = c.left_beside_load(c.tau - c.needed, c.weighing)
    yield Reading(left, error("mount", message), plain)


def _beside(c: Compared, pull: Float[np.ndarray, "R n 3"]) -> float:
    """What a load and a constant force leave of the joints that weigh; `pull`: torque against the force."""
    force = _best(c, pull, c.weighing)
    return c.left_beside_load(c.tau - c.needed - pull @ force, c.weighing)


def _best(
    c: Compared, pull: Float[np.ndarray, "R n 3"], joints: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, " 3"]:
    """The vector that explains most of what the model misses at some joints; `pull`: torque against its axes."""
    columns = (pull / c.size[:, None])[:, joints].reshape(-1, 3)
    missing = ((c.tau - c.needed) / c.size)[:, joints]
    return np.linalg.lstsq(columns, missing.ravel(), rcond=1e-3)[0]


def mounting(gravity: np.ndarray) -> str:
    """Angles "RX,RY" about x and y [degrees] of a base, upright in the model, in which gravity points so."""
    x, y, z = gravity / np.linalg.norm(gravity)
    angles = np.degrees([np.arctan2(-y, -z), np.arcsin(np.clip(x, -1.0, 1.0))])
    return ",".join(f"{angle:.1f}" for angle in angles + 0.0)
