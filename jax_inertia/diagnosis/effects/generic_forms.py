"""Generic alternatives of one form each: what robots have, and no effect of the library is; they name no cause."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Columns, Effect, of_row, peak_of
from jax_inertia.diagnosis.effects.encoder import off_path
from jax_inertia.diagnosis.effects.joint import Cogging
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.maths.finite_difference import derivative
from jax_inertia.signals.torque_residual import needed_torques, without_friction


class _Generic(Effect):
    named, form_error = False, 0.1

    def numbers(self, context, place, shape, theta):
        return {}


LONGER = 1e-3
"""By how much a link is made longer to see what that does [m]."""


class OtherLength(_Generic):
    """A joint that sits elsewhere on what carries it: ∂(needed torque)/∂(its place), by differences."""

    name, equation, kind = (
        "a link of another length",
        "∂τ/∂p δp, p of the body on its parent",
        "body",
    )

    def places(self, context):
        return [p for p in super().places(context) if _node(context, p.name) is not None]

    def columns(self, context, place, shape):
        robot, node = without_friction(context.robot), _node(context, place.name)
        observation = context.prepared.observation
        base, moved = context.inverse - context.prepared.dry, []
        for axis in range(3):
            longer = np.array(robot.placement_position)
            longer[node, axis] += LONGER
            other = eqx.tree_at(lambda r: r.placement_position, robot, jnp.asarray(longer))
            moved.append((needed_torques(other, observation) - base) / LONGER)
        return Columns(-np.stack(moved, axis=2))

    def scale(self, context, place, shape):
        return np.full(3, 0.01 * context.scale)


def _node(context: Context, name: str) -> int | None:
    """Of a body that a joint moves on another, its index among the moving ones."""
    topology = context.robot.topology
    at = dict(zip(context.robot.body_names, topology.body_node, strict=True)).get(name)
    return None if at is None or topology.parent[at] < 0 else int(at)


WARPS = 6
"""Polynomials of a joint's angle, of what its encoder may read wrong."""


class WarpedEncoder(_Generic):
    """A disk that is eccentric, a magnet that is off: a smooth function of the angle."""

    name, equation = "an encoder that errs with its angle", "q_logged = q + Σ θₖ Pₖ(q), Legendre's"

    def columns(self, context, place, shape):
        q = context.joint_position[:, place.index]
        at = 2 * (q - q.min()) / max(float(np.ptp(q)), 1e-12) - 1
        return off_path(context, place.index, np.polynomial.legendre.legvander(at, WARPS)[:, 2:])

    def scale(self, context, place, shape):
        return np.full(WARPS - 1, 0.005)


DEPTHS = (0.03, 0.06, 0.1, 0.2, 0.35)
"""Of a joint's range, how much may be on rubber."""
SLOW = 0.1
"""Speed at which rubber has lost what it loses [rad/s]."""


class SoftStop(_Generic):
    """A progressive spring with losses, dry and by its speed; shape: depth of the joint's range, and at which end."""

    name, equation = "a soft stop", "−(k₁ x + k₂ x² + F x sign(q̇) + d x q̇), x into the stop"

    def shapes(self, context, place):
        return [(depth, end) for depth in DEPTHS for end in (-1.0, 1.0)]

    def steps(self, context, place, shape):
        return (0.3 * shape[0], 0.0)

    def within(self, context, place, shape):
        return 0.01 <= shape[0] <= 0.5

    def columns(self, context, place, shape):
        q, v = context.joint_position[:, place.index], context.v[:, place.index]
        depth = shape[0] * max(float(np.ptp(q)), 1e-9)
        into = q - q.max() + depth if shape[1] > 0 else q.min() + depth - q
        x = np.maximum(into, 0.0) / depth
        return of_row(np.stack([x, x**2, x * np.tanh(v / SLOW), x * v], axis=1), place)

    def scale(self, context, place, shape):
        return np.full(4, 0.1 * peak_of(context, place.index))


KNOTS = 8


class GainOfPosition(_Generic):
    """A gear whose play, or a motor whose magnets, differ around a turn."""

    name, equation = "a gain that changes with its angle", "f(q) τ"

    def columns(self, context, place, shape):
        q = context.joint_position[:, place.index]
        at = (q - q.min()) / max(float(np.ptp(q)), 1e-12) * (KNOTS - 1)
        hats = np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(KNOTS)))
        return of_row(hats * context.inverse[:, place.index, None], place)

    def scale(self, context, place, shape):
        return np.full(KNOTS, 0.1)


DRIFTS = 0.005
"""By which a clock is off at either end of a log [s], one standard deviation."""


class DriftingClock(_Generic):
    """Encoders read by another clock than the drives': a delay that grows along the log, from none at any moment."""

    name, equation, kind = "a clock that runs apart", "(c + r t) τ̇", "global"

    def columns(self, context, place, shape):
        slope = derivative(context.time, context.below(context.slow_band, context.inverse))
        ahead = 2.0 * (context.time / context.time[-1]) - 1.0
        return Columns(slope[:, :, None] * np.stack([np.ones_like(ahead), ahead], axis=1)[:, None])

    def scale(self, context, place, shape):
        return np.full(2, DRIFTS)


class LoadRipple(_Generic):
    """Teeth of a gear that carries; shape: waves a radian, as of cogging."""

    name, equation = "a ripple that grows with the load", "|τ| (a sin N q + b cos N q)"

    def shapes(self, context, place):
        return Cogging().shapes(context, place)

    def steps(self, context, place, shape):
        return Cogging().steps(context, place, shape)

    def within(self, context, place, shape):
        return Cogging().within(context, place, shape)

    def columns(self, context, place, shape) -> Columns:
        angle = shape[0] * context.joint_position[:, place.index]
        waves: Float[np.ndarray, "T 2"] = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        return of_row(np.abs(context.inverse[:, [place.index]]) * waves, place)

    def scale(self, context, place, shape):
        return np.full(2, 0.05)
