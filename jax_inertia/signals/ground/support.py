"""The ground under a floating base whose log has no contact wrenches.

A foot that touches may press as it will: of the torque residual r only what no force at the feet explains says anything
of the model. With Jacobians J of all feet and weights W that trust the legs' torques more than the base's acceleration,

    λ = (J W Jᵀ)⁻¹ J W r,    r − Jᵀ λ = (1 − Jᵀ (J W Jᵀ)⁻¹ J W) r

λ is the ground's force as the legs' motors show it, and on the rows of the base stays what it does not account for. The
own rows of a leg that may stand are used up. While a foot swings (`stance`) its λ is zero, and the rows of its
leg say as much of the leg as those of a robot in the air.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from jax_inertia.dynamics import rigid_body
from jax_inertia.logs.log import Log, LogError
from jax_inertia.maths.finite_difference import derivative
from jax_inertia.maths.over_samples import OverSamples
from jax_inertia.model.robot import Robot
from jax_inertia.signals.generalised_motion import Motion
from jax_inertia.signals.ground.sinking import sunk
from jax_inertia.signals.ground.stance import swinging

BASE = 6
"""Rows of a free joint."""
RIGID = (0.0,) * 9
"""`Surface.soft` of what does not sink."""
# A point is at the ground that is so near to it [m] for this share of the log.
NEAR, OFTEN = 0.02, 0.05
# A robot that nothing carries needs less than this share of its weight.
CARRIED = 0.3
# A sole that is smaller than this [m] presses at one point.
SOLE = 0.04
LIES = 5
"""Joints of a leg that can lay a sole flat on the ground: three for its place, two for its tilt."""
USUAL = 95.0
"""Percentile of a foot's own force that counts as its largest: such sensors have no unit, and ring."""
PIVOTS = 0.1
"""Moments of feet that turn on the ground change within this time [s], as a step does."""
# Trust in what the base needs against what the legs' motors give, each in units of its own size.
TRUST = 1e-2


@dataclasses.dataclass(frozen=True)
class Foot:
    """Where a body meets the ground: at a point that a ball rolls over, or with a whole sole."""

    body: int
    point: tuple[float, float, float]
    """Of a ball, its centre in the body's frame [m]."""
    radius: float
    flat: bool
    pivot: tuple[float, float] = (0.0, 0.0)
    """Moment that it may bear about the ground's normal, and along the ground, per force on it [m]."""
    soft: tuple[float, ...] = RIGID
    """Of a ball, how it sinks (`Surface.soft`); a sole's load is shared by who knows how many points."""


@dataclasses.dataclass(frozen=True)
class Support:
    """Forces of the ground that are not measured."""

    bodies: tuple[str, ...]
    wrench: Float[np.ndarray, "T C 6"]
    """As the legs' motors show them."""
    torque: Float[np.ndarray, "T nv"]
    """Of these on all rows, Σ Jᵀλ [N m]."""
    seen: Float[np.ndarray, "T nv nv"]
    """The part of a torque on all rows that no force at the feet explains."""
    used_up: Bool[np.ndarray, "T nv"]
    """Rows of the legs whose feet may stand."""
    feet: tuple[Foot, ...]
    sinks: Float[np.ndarray, "T C"]
    """How fast each foot goes into the ground under it [m/s]."""
    hidden: Bool[np.ndarray, " T"]
    """Where forces at the feet could explain every torque."""
    depth: float
    """To which feet sink on average, by the model's law [m]."""
    turned: int | None
    """The row of the base about whose axis balls turn on the spot, and bear who knows what moment; None for none."""

    def pivoting(
        self, robot: Robot, q: Float[np.ndarray, "T nq"], rate: float, rng: np.random.Generator
    ) -> Float[np.ndarray, "T nv"]:
        """Moments by which balls resist to roll, by chance, on all rows [N m]; of soles they are in `torque`.

        All that the model's friction allows, one way or the other, and another one every `PIVOTS` seconds.
        """
        reach = np.array([0.0 if f.flat else f.pivot[1] for f in self.feet])
        if not reach.any():
            return np.zeros((len(q), robot.nv))
        at = np.arange(len(q)) / rate
        nodes = np.arange(0.0, at[-1] + 2 * PIVOTS, PIVOTS)
        drawn = rng.choice([-1.0, 1.0], (len(nodes), len(self.feet), 2)) * reach[:, None]
        share = np.stack(
            [np.interp(at, nodes, column) for column in drawn.reshape(len(nodes), -1).T], axis=1
        ).reshape(len(q), len(self.feet), 2)
        moment = np.zeros_like(self.wrench)
        moment[:, :, 3:5] = share * np.maximum(self.wrench[:, :, 2:3], 0.0)
        bodies = tuple(f.body for f in self.feet)
        return _torques((robot, bodies), (q, moment[:, None]))[:, 0]

    def of_height(
        self, robot: Robot, q: Float[np.ndarray, "T nq"], height: float
    ) -> Float[np.ndarray, "T nv"]:
        """The remainder of the torque by which feet that touch the ground higher than is thought [m] differ [N m]."""
        moment = np.zeros_like(self.wrench)
        moment[:, :, 3:] = np.cross([0.0, 0.0, height], self.wrench[:, :, :3])
        bodies = tuple(f.body for f in self.feet)
        return self.left_of(_torques((robot, bodies), (q, moment[:, None]))[:, 0], None)

    def left_of(self, x: Float[np.ndarray, "T *c"], row: int | None) -> Float[np.ndarray, "T *d"]:
        """What no force at the feet explains of torques on all rows (T, nv, ...), or of those on one row (T, ...)."""
        alive = np.flatnonzero(self.seen.any(axis=(0, 2)))
        if row is not None:
            # Of a leg's row, the remainder of it while the foot swings, and what the base's rows see of it.
            alive = np.flatnonzero(self.seen[:, :, row].any(axis=0))
        seen = self.seen[:, alive]
        if row is not None:
            part = seen[:, :, row].reshape(*seen.shape[:2], *(1 for _ in x.shape[1:])) * x[:, None]
        else:
            part = (seen @ x.reshape(*x.shape[:2], -1)).reshape(len(x), len(alive), *x.shape[2:])
        out = np.zeros((len(x), self.used_up.shape[1], *part.shape[2:]))
        out[:, alive] = part
        return out

    def bears(self, row: int) -> bool:
        """Whether a row is a leg's whose foot stands most of the time."""
        return bool(self.used_up[:, row].mean() > 0.5)


def feet_of(
    robot: Robot,
    rotation: Float[np.ndarray, "T nb 3 3"],
    position: Float[np.ndarray, "T nb 3"],
    bodies: Sequence[str] = (),
) -> list[Foot]:
    """The feet among a robot's bodies (all, or those that are named), by where their lowest points are in a motion.

    Raises LogError for a named body that the model gives no shape to touch with.
    """
    surface = robot.surface
    owner, points, radius = (np.asarray(x) for x in (surface.body, surface.point, surface.radius))
    named = [robot.body_index(name) for name in bodies]
    for name, index in zip(bodies, named, strict=True):
        if index not in owner:
            raise LogError(
                f"contact body {name!r} has no contact_wrench, and no colliding geom in the model: where it touches "
                "is not known; log the wrench or give it a geom"
            )
    if not len(owner):
        return []
    height = np.einsum("tpj,pj->tp", rotation[:, owner, 2], points) + position[:, owner, 2] - radius
    candidates = np.isin(owner, named) if named else np.ones(len(owner), bool)
    ground = np.median(height[:, candidates].min(axis=1))
    feet = []
    for body in sorted(set(owner[candidates].tolist())):
        own = np.flatnonzero(owner == body)
        low = height[:, own].min(axis=1, keepdims=True)
        near = height[:, own] - low < NEAR
        if not named:
            near &= low - ground < NEAR
        at = own[near.mean(axis=0) > OFTEN]
        if len(at):
            extent = np.ptp(points[at], axis=0).max()
            centre = tuple(points[at].mean(axis=0).tolist())
            pivot = tuple(np.asarray(surface.pivot)[at].mean(axis=0).tolist())
            joints = int((robot.topology.body_dof[body][BASE:] > 0).sum())
            flat = bool(extent > SOLE) and joints >= LIES
            soft = RIGID if flat else tuple(np.asarray(surface.soft)[at].mean(axis=0).tolist())
            feet.append(Foot(body, centre, float(radius[at].mean()), flat, pivot, soft))
    return feet if named else _at_ends(robot, feet)


def _at_ends(robot: Robot, feet: list[Foot]) -> list[Foot]:
    """The feet that carry no other foot: of a leg its end, and of a robot that also lies on its trunk its legs."""
    moves = robot.topology.body_dof > 0
    ends = []
    for f in feet:
        further = [g for g in feet if g is not f and np.all(moves[g.body] >= moves[f.body])]
        if not any(moves[g.body].sum() > moves[f.body].sum() or g.body > f.body for g in further):
            ends.append(f)
    return ends


def reported_contact(
    log: Log, names: Sequence[str], time: Float[np.ndarray, " T"]
) -> Float[np.ndarray, "T C"] | None:
    """Loads of the feet by their own sensors at `time` [s], each over its own largest; None where there are none.

    A foot that the log does not name has NaN.
    """
    logged = log.contact_flag
    if logged is None:
        if log.contact_force is None:
            return None
        force = np.asarray(log.contact_force)
        logged = force / np.maximum(np.nanpercentile(force, USUAL, axis=0), 1e-9)
    out = np.full((len(time), len(names)), np.nan)
    for k, name in enumerate(names):
        if name in log.contact_bodies:
            column = np.asarray(logged)[:, log.contact_bodies.index(name)]
            out[:, k] = np.interp(time, np.asarray(log.time), column)
    return out


def supported(
    robot: Robot, motion: Motion, residual: Float[np.ndarray, "T nv"], log: Log, reach: float
) -> Support | None:
    """What holds a floating base up, where the torque residual lacks all forces of the ground; None where nothing does.

    Feet sink under their loads, which then act nearer to their centres: at half the depth. `contact_bodies` of the log
    may touch; without them, all that come near the lowest points of the motion of a robot that does not fly, one at the
    end of each leg. `contact_flag` or `contact_force` sharpen when they stand. `reach` [s]: how far a low-pass carries
    a foot's load into the swing before and after.
    """
    q, tau, bodies = np.asarray(motion.q), np.asarray(motion.tau), log.contact_bodies
    time = np.asarray(motion.time)
    rate = 1.0 / float(np.median(np.diff(time)))
    gravity = np.asarray(robot.gravity)
    weight = float(jnp.sum(robot.pi[:, 0])) * float(np.linalg.norm(gravity))
    # The linear rows of a free joint are forces in world axes.
    carried = -residual[:, :3].mean(axis=0) @ gravity / max(float(np.linalg.norm(gravity)), 1e-9)
    if (not bodies and carried < CARRIED * weight) or not weight:
        return None
    rotation, position = _poses(robot, q)
    # Feet move slowly compared with the grid.
    some = slice(None, None, max(1, len(q) // 500))
    feet = feet_of(robot, rotation[some], position[some], bodies)
    if not feet:
        return None
    names, index = tuple(robot.body_names[f.body] for f in feet), tuple(f.body for f in feet)
    size = np.maximum(np.percentile(np.abs(tau), 99.5, axis=0), 1e-3)
    size[:BASE] = np.array([1, 1, 1, 0.3, 0.3, 0.3]) * weight / TRUST
    ways = _ways(rotation, feet, np.zeros((len(q), len(feet))))
    rows = _torques((robot, index), (q, ways))
    force = np.einsum("tmj,tj->tm", _solved(rows, size), residual)
    load = np.einsum("tm,tmc->tc", force, ways[..., 2])
    told = reported_contact(log, names, time)
    share = load * len(feet) / weight
    swings = swinging(share, _speeds(rotation, position, feet, share, rate), rate, told)
    around = 2 * round(reach * rate) + 1
    stands = np.asarray(ndimage.maximum_filter1d(~swings, around, axis=0, mode="nearest"), bool)
    of_foot = np.repeat(np.arange(len(feet)), [6 if f.flat else 3 for f in feet])
    depth, sinks = sunk(np.array([f.soft for f in feet]), np.where(stands, load, 0.0), rate)
    if depth.any():
        ways = _ways(rotation, feet, 0.5 * depth)
        rows = _torques((robot, index), (q, ways))
    rows = rows * stands[:, of_foot, None]
    used_up = np.abs(rows).max(axis=1) > 1e-9
    used_up[:, :BASE] = False
    solved = _solved(rows, size)
    seen = np.eye(robot.nv) - rows.transpose(0, 2, 1) @ solved
    seen[used_up] = 0.0
    # Trust in the base is finite, and so is what one leg hears of another: nothing.
    seen[np.abs(seen) < 1e3 * TRUST**4] = 0.0
    hidden = np.trace(seen[:, :BASE, :BASE], axis1=1, axis2=2) < 0.5
    if hidden.all():
        raise LogError(
            f"no contact_wrench: forces and moments at {', '.join(names)} could explain every torque of their legs and "
            "of the base at all times; log the wrenches, or give contact_bodies of those that touch"
        )
    force = np.einsum("tmj,tj->tm", solved, residual)
    wrench = np.einsum("tm,tmcw->tcw", force, ways)
    torque = np.einsum("tmj,tm->tj", rows, force)
    turns = any(f.pivot[0] > 0 and not f.flat for f in feet)
    upright = int(np.argmax(np.abs(rotation[:, 0, 2]).mean(axis=0)))
    turned = BASE - 3 + upright if turns else None
    stood = float(np.mean(depth, where=stands)) if stands.any() else 0.0
    return Support(names, wrench, torque, seen, used_up, tuple(feet), sinks, hidden, stood, turned)


def _speeds(
    rotation: Float[np.ndarray, "T nb 3 3"],
    position: Float[np.ndarray, "T nb 3"],
    feet: Sequence[Foot],
    share: Float[np.ndarray, "T C"],
    rate: float,
) -> Float[np.ndarray, "T C"]:
    """How fast each foot moves [m/s] as seen from those that bear most: the base's own velocity plays no part."""
    at = np.stack([position[:, f.body] + rotation[:, f.body] @ np.array(f.point) for f in feet], 1)
    velocity = derivative(np.arange(len(at)) / rate, at)
    firm = np.maximum(share, 1e-3) ** 2
    ground = np.einsum("tk,tkc->tc", firm, velocity) / firm.sum(axis=1, keepdims=True)
    return np.linalg.norm(velocity - ground[:, None], axis=2)


def _solved(
    rows: Float[np.ndarray, "T m nv"], size: Float[np.ndarray, " nv"]
) -> Float[np.ndarray, "T m nv"]:
    """(J W Jᵀ)⁺ J W, W = diag(1 / size²): forces that no torque tells from none are none."""
    weighted = rows / size**2
    gram = weighted @ rows.transpose(0, 2, 1)
    return np.linalg.pinv(gram, rcond=SINGULAR, hermitian=True) @ weighted


SINGULAR = 1e-9
"""Of its largest eigenvalue: below that a direction of forces moves no joint."""


def _ways(
    rotation: Float[np.ndarray, "T nb 3 3"], feet: list[Foot], above: Float[np.ndarray, "T C"]
) -> Float[np.ndarray, "T m C 6"]:
    """The unit wrenches that the ground may give, so far above the lowest point of each foot [m]."""
    ways = []
    for k, foot in enumerate(feet):
        arm = rotation[:, foot.body] @ np.array(foot.point) - [0.0, 0.0, foot.radius]
        arm[:, 2] += above[:, k]
        for axis in np.eye(6)[: 6 if foot.flat else 3]:
            way = np.zeros((len(rotation), len(feet), 6))
            way[:, k] = axis
            if not foot.flat:
                way[:, k, 3:] = np.cross(arm, axis[:3])
            ways.append(way)
    return np.stack(ways, axis=1)


_poses = OverSamples(rigid_body.body_poses)


@OverSamples
def _torques(shared, x):
    robot, bodies = shared
    q, ways = x
    return jax.vmap(lambda w: rigid_body.contact_torque(robot, q, w, bodies))(ways)
