"""What is never exact and is no finding: the nominal model within its tolerance, and how its friction turns over.

Each nuisance is a column scaled to its prior standard deviation, integrated out with the prior *charged*:

    J = min over z of ‖y − N z − A θ‖² + ‖z‖²

Uncharged, the same columns would swallow payloads. How soon friction turns over, and when within half a period a torque
acted, is stated by no model. How far off its masses are, or its dampings, differs from model to model: the log itself
tells (`scales`).
"""

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from jax_inertia.diagnosis.effects.base import Columns
from jax_inertia.diagnosis.effects.inertial import steiner
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.gap.families.friction import PRESLIDING
from jax_inertia.logs.findings import run_bounds
from jax_inertia.logs.log import Log
from jax_inertia.maths.finite_difference import derivative
from jax_inertia.signals.dry_friction import sign
from jax_inertia.signals.held import lateness, timing_of
from jax_inertia.signals.torque_residual import needed_torques, without_friction


@dataclasses.dataclass(frozen=True)
class Tolerance:
    """One standard deviation of what a nominal model may be off by, everywhere at once."""

    mass: float = 0.01
    """Relative."""
    com: float | None = None
    """m, along each axis. None: 1 mm on a robot with links of 0.15 to 1 m, in proportion on a larger or smaller one."""
    inertia: float = 0.02
    """Relative, about the centre of mass."""
    damping: float = 0.05
    """Relative to the model's own damping, frictionloss and armature."""
    sampled: float = 0.25
    """Of the log's period, when within it a wrench acted."""


CAUSES = {
    "mass": "payload",
    "centre of mass": "com_shift",
    "inertia": "link_inertia",
    "damping": "viscous_friction",
    "frictionloss": "coulomb_friction",
    "armature": "armature",
}
"""The effect that an error beyond the tolerance would be, by kind of number."""


@dataclasses.dataclass(frozen=True)
class Nuisances:
    """Columns on the fast grid, each times its prior standard deviation."""

    fixed: list[Columns]
    """What no model states: friction about a reversal, and when within its period a torque acted."""
    brief: list[Columns]
    """The same of what is over in a moment, one moment to a column: friction as a joint sets off, or is at rest."""
    tolerances: dict[str, list[Columns]]
    """Errors of the model's own numbers, by kind of number."""
    named: dict[str, list[str]]
    """What each column of a kind is an error of."""

    def torque(
        self, fixed: Float[np.ndarray, " f"], tolerances: Float[np.ndarray, " k"]
    ) -> Float[np.ndarray, "T nv"]:
        """Σ columns times their numbers: of `fixed` and then of `brief`, and the tolerances' kind by kind."""
        own = (c for some in self.tolerances.values() for c in some)
        blocks = [*self.fixed, *self.brief, *own]
        numbers = np.concatenate([fixed, tolerances])
        parts = np.split(numbers, np.cumsum([c.values.shape[-1] for c in blocks])[:-1])
        whole = next(c.values for c in blocks if c.row is None)
        out = np.zeros(whole.shape[:2])
        for c, x in zip(blocks, parts, strict=True):
            out[:, slice(None) if c.row is None else c.row] += c.values @ x
        return out


def nuisances(context: Context, tolerance: Tolerance, log: Log) -> Nuisances:
    """All nuisances of a log."""
    fixed, tolerances, named = [], {}, {}
    brief = _holding(context)
    for kind, (x, bodies) in _bodies(context, tolerance).items():
        tolerances[kind] = [Columns(x)]
        named[kind] = [f"{kind} of {context.robot.body_names[i]}" for i in bodies]
    robot, v, a = context.robot, context.v, context.acceleration
    for joint, row in context.joint_dofs.items():
        for kind, own, shape in (
            ("damping", robot.damping, -v[:, row]),
            ("frictionloss", robot.frictionloss, -context.side[:, row]),
            ("armature", robot.armature, -a[:, row]),
        ):
            if float(own[row]) > 0:
                column = Columns(tolerance.damping * float(own[row]) * shape[:, None], row)
                tolerances.setdefault(kind, []).append(column)
                named.setdefault(kind, []).append(f"{kind} of {joint}")
        # How soon the model's own dry friction turns over is not in the model: bristles turn late, MuJoCo's soft
        # constraint early, by about q̈ times its time constant.
        if (friction := float(robot.frictionloss[row])) > 0:
            late = [context.bristle(row, x) for x in PRESLIDING[1:]]
            early = [sign(v[:, row] + x * context.a[:, row]) for x in (0.004, 0.01, 0.02)]
            creeping = [context.creeping(row, friction, band) for band in CREEP_BANDS]
            turned = [z - context.side[:, row] for z in (*late, *early, *creeping)]
            fixed.append(Columns(friction * np.stack(turned, axis=1), row))
            if moments := [*_departures(context, row), *_halts(context, row)]:
                brief.append(Columns(friction * np.stack(moments, axis=1), row))
    when = timing_of(log)
    shifts = _shifts(context.time, context.tau, when.error / log.rate, when.most / log.rate)
    fixed.append(Columns(np.stack(shifts, axis=2)))
    if (loop := context.prepared.loop) is not None:
        rows = list(context.prepared.driven)
        late = np.zeros_like(v)
        late[:, rows] = lateness(loop, log.rate, v[:, rows], a[:, rows])
        fixed.append(Columns(late[:, :, None]))
    if context.wrench is not None and context.prepared.support is None:
        # A foot that is set down changes its force by tens of weights a second.
        late, most = tolerance.sampled / log.rate, 0.5 / log.rate
        shifts = _shifts(context.time, context.wrench, late, most)
        turned = [context.contact_torques(x).sum(axis=1) for x in shifts]
        fixed.append(Columns(np.stack(turned, axis=2)))
    if context.prepared.by_feet:
        fixed.append(_giving(context))
    return Nuisances(fixed, brief, tolerances, named)


GIVES = 0.05
"""Share of a base's acceleration that feet hide, or feign, which give under the load that it is: 0.01 to 0.06 in trots
of two simulated robots, with contacts of 8 and 12 ms."""


def _giving(context: Context) -> Columns:
    """What an acceleration of the base does that its feet do not show, along each axis."""
    observation = context.prepared.observation
    bare = without_friction(context.robot)
    own = needed_torques(bare, observation)
    columns = []
    for axis in range(3):
        a = np.array(observation.a)
        a[:, axis] *= 1.0 + GIVES
        columns.append(needed_torques(bare, dataclasses.replace(observation, a=a)) - own)
    return Columns(np.stack(columns, axis=2))


def _shifts(
    time: Float[np.ndarray, "T"], x: Float[np.ndarray, "T *c"], late: float, most: float
) -> list[Float[np.ndarray, "T *c"]]:
    """What a delay of a signal by `late` [s] does, and what one by the `most` it can be does beyond its first order.

    The second at as many standard deviations as the first.
    """
    slope = derivative(time, x)
    return [late * slope, 0.5 * late * most * derivative(time, slope)]


# Up to which frequency a joint that creeps shows by its motion how [Hz]: above, that may be the encoders' noise.
CREEP_BANDS = (np.inf, 40.0, 20.0, 10.0)
# Over what displacements bristles straighten, or bend, when a joint sets off [rad].
STRAIGHTENS = (3e-4, 1.5e-3)


def _departures(context: Context, row: int) -> list[Float[np.ndarray, " T"]]:
    """How bristles that were bent by what held a joint at rest straighten as it sets off, one rest after the other.

    At rest friction is whatever balances, so where it begins from is told by nothing.
    """
    path = np.abs(
        np.diff(context.joint_position[:, row], prepend=context.joint_position[0, row])
    ).cumsum()
    departures = [stop for _, stop in run_bounds(context.at_rest[:, row]) if stop < len(path)]
    moved = [np.where(path >= path[k], path - path[k], np.inf) for k in departures]
    return [np.exp(-x / reach) for x in moved for reach in STRAIGHTENS]


# Halts that are no further apart than this [s] are one.
APART = 0.02


def _halts(context: Context, row: int) -> list[Float[np.ndarray, " T"]]:
    """Moments in which friction may hold a joint that turns round, too short to be a rest: shares of samples."""
    share = context.held[:, row] * ~context.at_rest[:, row]
    near = np.ones(round(APART * context.prepared.rate) + 1)
    at = np.arange(len(share))
    halts = run_bounds(ndimage.binary_closing(share > 0, near))
    return [np.where((start <= at) & (at < stop), share, 0.0) for start, stop in halts]


# Friction at rest under a foot may change within this time [s], or as fast as this many numbers in all can tell.
CHANGES, MOST = 0.05, 400


def _holding(context: Context) -> list[Columns]:
    """Whatever friction balances in legs at rest, where their torques tell what the ground gives: hats in time."""
    support = context.prepared.support
    if support is None:
        return []
    held = context.at_rest * (support.used_up & (context.frictionloss > 0))
    total = float(held.sum()) / context.prepared.rate
    every = max(CHANGES, total / MOST)
    nodes = np.arange(0.0, context.time[-1] + every, every)
    hats = np.maximum(1.0 - np.abs(context.time[:, None] - nodes) / every, 0.0)
    out = []
    for row in np.flatnonzero(held.any(axis=0)):
        own = hats * held[:, [row]]
        friction = float(context.frictionloss[row])
        out.append(Columns(friction * own[:, own.any(axis=0)], int(row)))
    return out


# How far a centre of mass of the nominal model is off on a robot of usual size, one standard deviation [m].
OFF_CENTRE = 1e-3


def _bodies(
    context: Context, tolerance: Tolerance
) -> dict[str, tuple[Float[np.ndarray, "T nv k"], list[int]]]:
    """Y ∂π for mass, centre of mass (thrice) and inertia of every body with mass, and the column's body."""
    changes = {"mass": [], "centre of mass": [], "inertia": []}
    com = OFF_CENTRE * context.scale if tolerance.com is None else tolerance.com
    for i, pi in enumerate(context.pi):
        m, h = pi[0], pi[1:4]
        if m <= 0:
            continue
        c = h / m
        central = pi[4:] - steiner(m, c)
        changes["mass"].append((i, tolerance.mass * pi))
        turned = np.concatenate([np.zeros(4), central])
        changes["inertia"].append((i, tolerance.inertia * turned))
        for axis in np.eye(3):
            # The exact derivative, rotational part included: I about the origin moves with the centre of mass.
            turn = m * (2 * c @ axis * np.eye(3) - np.outer(c, axis) - np.outer(axis, c))
            change = np.concatenate([[0.0], m * axis, turn[np.triu_indices(3)]])
            changes["centre of mass"].append((i, com * change))
    return {
        kind: (
            np.stack([context.regressor[:, :, i, :] @ change for i, change in some], axis=-1),
            [i for i, _ in some],
        )
        for kind, some in changes.items()
        if some
    }
