"""What a missing torque may come from that is no family: free functions, hysteresis, encoders, clocks, lengths.

None of these is ever reported as the cause. They stand beside what was found: where one of them fits better, the cause
is not in the library, and the log itself says what it depends on (`doubt`).
"""

import dataclasses
from collections.abc import Iterator

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Columns
from jax_inertia.diagnosis.effects.encoder import off_path
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.gap.pool import Pool
from jax_inertia.maths.finite_difference import derivative
from jax_inertia.signals.torque_residual import needed_torques, without_friction

KNOTS = 24
# Angles over which a hose or a cable yields [rad]: dry friction turns within a hundredth of them.
YIELDS = (0.15, 0.3, 0.6)
# Of a joint's range, how much may be on rubber; and the speed at which that has lost what it loses [rad/s].
DEPTHS = (0.03, 0.05, 0.075, *(0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4))
SLOW = 0.1
# Of a joint's angle, what its encoder may read wrong.
WARPS = 6
# Samples of the fast grid by which a sensor of wrenches may be late: its filter's and its bus's milliseconds.
LATE = (1, 3, 9)
# By how much a link is made longer to see what that does [m].
LONGER = 1e-3


@dataclasses.dataclass(frozen=True)
class Outsider:
    """Something that no family is."""

    name: str
    columns: Float[np.ndarray, "n k"]
    """An orthonormal basis of its torques, in the charged metric."""
    beyond: Float[np.ndarray, "n j"]
    """The same of what no family and no tolerance has of it."""


def outsiders(pool: Pool) -> list[Outsider]:
    """All of them that do something in this log."""
    context, out = pool.context, []
    held = not context.robot.has_free_base

    def add(name: str, columns: Columns, alone: bool = True) -> None:
        basis = _basis(pool.evidence.column(columns))
        if basis.shape[1]:
            out.append(Outsider(name, basis, basis if alone else basis[:, :0]))

    for name, columns in _at_joints(context):
        add(name, columns)
    for name, columns in _at_ends(context):
        # At the ends joints turn round, and friction there errs by itself: that is no cause where nothing else is.
        add(name, columns, alone=False)
    for joint, row in context.joint_dofs.items():
        gain = _hats(context.joint_position[:, row]) * context.inverse[:, row, None]
        # What a floating base's legs need holds the noise of the wrenches under them.
        add(f"a gain at {joint} that changes with its angle", Columns(gain, row), alone=held)
    for name, columns in _of_poses(context):
        # A floating base's sensors put their noise into these columns: little of it where the motion is.
        add(name, columns if held else Columns(context.below(context.slow_band, columns.values)))
    # Where no base holds the robot, errors of its feet's sensors and of its whole mass come to the same.
    add("another gravity (a force on every body by its mass)", _weights(context), alone=held)
    if context.wrench is not None and context.prepared.support is None:
        add("contact wrenches that come late", _late_wrenches(context, context.wrench))
    if held:
        # A lateness that stays is a delay, and one within a period a tolerance: the clock's own is what drifts.
        late, drifting = np.hsplit(pool.evidence.column(Columns(_clocks(context))), 2)
        both, own = _basis(np.hstack([late, drifting])), _basis(late)
        name = "a clock of the encoders that runs apart from the drives'"
        out.append(Outsider(name, both, _basis(drifting - own @ (own.T @ drifting))))
    return out


def _basis(columns: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n s"]:
    """An orthonormal basis of columns, of those that do something."""
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, size > max(1e-3 * float(size[0]), 1e-9)]


def _at_joints(context: Context) -> Iterator[tuple[str, Columns]]:
    for joint, row in context.joint_dofs.items():
        q, v = context.joint_position[:, row], context.v[:, row]
        yield f"a free function of {joint}'s position", Columns(_hats(q), row)
        yield f"a free function of {joint}'s speed", Columns(_hats(v), row)
        yields = np.stack([context.bristle(row, reach) for reach in YIELDS], axis=1)
        yield f"a hysteresis at {joint} that yields over tenths of a radian", Columns(yields, row)


def _at_ends(context: Context) -> Iterator[tuple[str, Columns]]:
    for joint, row in context.joint_dofs.items():
        for columns in _stops(context.joint_position[:, row], context.v[:, row]):
            yield f"a soft stop that {joint} runs into", Columns(columns, row)


def _of_poses(context: Context) -> Iterator[tuple[str, Columns]]:
    """What the model takes to be elsewhere than it is."""
    for joint, row in context.joint_dofs.items():
        warp = _waves(context.joint_position[:, row])
        yield f"an encoder at {joint} that errs with its angle", off_path(context, row, warp)
    yield from _lengths(context)


def _hats(x: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T k"]:
    """Hat functions over the range of x."""
    place = (x - x.min()) / max(float(np.ptp(x)), 1e-12) * (KNOTS - 1)
    return np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(KNOTS)))


def _stops(
    q: Float[np.ndarray, " T"], v: Float[np.ndarray, " T"]
) -> Iterator[Float[np.ndarray, "T 4"]]:
    """A progressive spring with losses, dry and by its speed, before either end of a joint's range."""
    low, high = q.min(), q.max()
    for share in DEPTHS:
        depth = share * (high - low)
        for into in (q - high + depth, low + depth - q):
            x = np.maximum(into, 0.0) / max(depth, 1e-12)
            yield np.stack([x, x**2, x * np.tanh(v / SLOW), x * v], axis=1)


def _waves(x: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T k"]:
    """Legendre's polynomials over the range of x, the constant apart: smooth, since they are differentiated twice."""
    place = 2 * (x - x.min()) / max(float(np.ptp(x)), 1e-12) - 1
    return np.polynomial.legendre.legvander(place, WARPS)[:, 1:]


def _weights(context: Context) -> Columns:
    """A unit acceleration of all bodies along each axis of the world."""
    return Columns(np.einsum("b,tbjc->tjc", context.pi[:, 0], context.force_rows))


def _clocks(context: Context) -> Float[np.ndarray, "T nv 2"]:
    """A path read at (1 + r) t + d instead of t: (d + r t) times the needed torque's derivative."""
    slope = derivative(context.time, context.below(context.slow_band, context.inverse))
    return np.stack([slope, slope * context.time[:, None]], axis=2)


def _late_wrenches(context: Context, wrench: Float[np.ndarray, "T C 6"]) -> Columns:
    """Wrenches of `LATE` samples before less those of as many after; within a period, lateness is a tolerance.

    Less those of the moment itself, they would hold its noise, and fit that.
    """
    at = np.arange(len(wrench))
    changes = [wrench[np.maximum(at - k, 0)] - wrench[np.minimum(at + k, at[-1])] for k in LATE]
    return Columns(np.stack([context.contact_torques(x).sum(axis=1) for x in changes], axis=2))


def _lengths(context: Context) -> Iterator[tuple[str, Columns]]:
    """A joint that sits elsewhere on what carries it: ∂(needed torque)/∂(its place), by differences."""
    robot, observation = without_friction(context.robot), context.prepared.observation
    names = dict(zip(robot.topology.body_node, robot.body_names, strict=True))
    base = context.inverse - context.prepared.dry
    for node, parent in enumerate(robot.topology.parent):
        if parent < 0 or node not in names:
            continue
        moved = []
        for axis in range(3):
            longer = robot.placement_position.at[node, axis].add(LONGER)
            other = eqx.tree_at(lambda r: r.placement_position, robot, longer)
            moved.append((needed_torques(other, observation) - base) / LONGER)
        yield (
            f"another length from {names.get(parent, 'its base')} to {names[node]}",
            Columns(np.stack(moved, axis=2)),
        )
