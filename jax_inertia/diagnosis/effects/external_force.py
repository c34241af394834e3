"""Forces on a body: for good, of the air, and for a short time."""

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.gap.families.base import Columns, Parameter
from jax_inertia.gap.families.force import push_window


def usual_force(context) -> float:
    """Standard deviation of a force on a robot [N]: 10 N, more on one of over 40 kg."""
    weight = 9.81 * float(context.pi[:, 0].sum())
    return max(10.0, 0.025 * weight)


class ConstantForce(Effect):
    name, equation, kind = "constant_force", "Jᵀ f, f fixed in the world", "body"

    def columns(self, context, place, shape):
        return Columns(context.force_rows[:, place.index])

    def scale(self, context, place, shape):
        return np.full(3, usual_force(context))

    def numbers(self, context, place, shape, theta):
        return {f"force_{k}": Parameter(float(x), "N") for k, x in zip("xyz", theta, strict=True)}


class Drag(Effect):
    name, equation, kind, form_error = "drag", "−c |v| v at the centre of mass", "body", 0.05

    def columns(self, context, place, shape):
        v = context.com_velocity[:, place.index]
        f = -np.linalg.norm(v, axis=1, keepdims=True) * v
        return Columns(np.einsum("tjc,tc->tj", context.force_rows[:, place.index], f)[:, :, None])

    def scale(self, context, place, shape):
        return np.array([6.0 * context.scale**2])

    def lower(self, context, place):
        return 0.0

    def numbers(self, context, place, shape, theta):
        return {"coefficient": Parameter(float(theta[0]), "N s²/m²", 0.0)}


class Push(Effect):
    """A force for a short time."""

    name, equation, kind, form_error = "push", "Jᵀ f w(t), w a short plateau", "body", 0.1

    def shapes(self, context, place):
        # Of what happens once, the search finds when.
        return []

    def steps(self, context, place, shape):
        return (0.1, 0.1, 0.0, 0.0)

    def columns(self, context, place, shape):
        window = push_window(np, context.time, *shape)
        return Columns(context.force_rows[:, place.index] * window[:, None, None])

    def scale(self, context, place, shape):
        return np.full(3, 4 * usual_force(context))

    def numbers(self, context, place, shape, theta):
        force = {f"force_{k}": Parameter(float(x), "N") for k, x in zip("xyz", theta, strict=True)}
        return force | {
            "start": Parameter(shape[0], "s"),
            "end": Parameter(shape[1], "s"),
            "flank": Parameter(shape[2], "1", 0.0),
            "skew": Parameter(shape[3], "1"),
        }
