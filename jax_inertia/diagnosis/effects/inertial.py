"""Effects on a body's inertial parameters: e = −Y δπ."""

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.gap.families.base import Columns, Parameter
from jax_inertia.gap.families.body import steiner

REACH = 0.06
"""Standard deviation of a load's lever on links of 0.15 to 1 m [m]."""


class _Inertial(Effect):
    kind = "body"

    def regressor(self, context, place) -> np.ndarray:
        """Y of the body (T, nv, 10)."""
        return context.regressor[:, :, place.index, :]

    def mass(self, context, place) -> float:
        """Nominal, kg."""
        return max(float(context.pi[place.index][0]), 1e-9)


class Payload(_Inertial):
    """All ten numbers free of each other: linear, and a load's own inertia is in them."""

    name, equation, form_error = "payload", "π + [m, m c, J]", 0.02

    def columns(self, context, place, shape):
        return Columns(-self.regressor(context, place))

    def scale(self, context, place, shape):
        mass = max(0.8, 0.3 * self.mass(context, place))
        lever = REACH * context.scale
        return mass * np.array([1.0] + [lever] * 3 + [0.2 * lever] * 6)

    def possible(self, context, place, theta):
        lever = np.linalg.norm(theta[1:4]) / max(float(theta[0]), 1e-9)
        return bool(theta[0] > 0 and lever < context.scale)

    def numbers(self, context, place, shape, theta):
        mass = float(theta[0])
        com = theta[1:4] / (mass if abs(mass) > 1e-9 else 1e-9)
        central = theta[4:] - steiner(mass, com)
        radius = np.sqrt(max((central[0] + central[3] + central[5]) / 3 / max(mass, 1e-9), 0.0))
        return {
            "mass": Parameter(mass, "kg", 0.0),
            **{f"com_{k}": Parameter(float(x), "m") for k, x in zip("xyz", com, strict=True)},
            # No load is a point: MuJoCo has no body without rotational inertia.
            "gyration_radius": Parameter(
                float(np.clip(radius, 1e-3, 0.3 * context.scale)), "m", 0.0
            ),
        }


class ComShift(_Inertial):
    name, equation, secant = "com_shift", "centre of mass + δ, mass and inertia about it kept", True

    def shapes(self, context, place):
        return [(0.0, 0.0, 0.0)]

    def columns(self, context, place, shape):
        pi, m = context.pi[place.index], self.mass(context, place)
        c, shift = pi[1:4] / m, np.asarray(shape)
        change = np.zeros((10, 3))
        for k, axis in enumerate(np.eye(3)):
            change[1 + k, k] = m
            # steiner(c + δ) − steiner(c) is bilinear in δ and 2 c + δ.
            change[4:, k] = _between(m, axis, 2 * c + shift)
        return Columns(-self.regressor(context, place) @ change)

    def scale(self, context, place, shape):
        return np.full(3, 0.015 * context.scale)

    def possible(self, context, place, theta):
        return bool(np.linalg.norm(theta) < 0.15 * context.scale)

    def numbers(self, context, place, shape, theta):
        return {
            f"com_shift_{k}": Parameter(float(x), "m") for k, x in zip("xyz", theta, strict=True)
        }


def _between(m: float, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The six moments of the symmetric form whose diagonal is `steiner`."""
    whole = m * (float(a @ b) * np.eye(3) - 0.5 * (np.outer(a, b) + np.outer(b, a)))
    return whole[np.triu_indices(3)]


class LinkInertia(_Inertial):
    name, equation = "link_inertia", "rotational inertia about the centre of mass scaled by s"

    def columns(self, context, place, shape):
        pi, m = context.pi[place.index], self.mass(context, place)
        central = np.concatenate([np.zeros(4), pi[4:] - steiner(m, pi[1:4] / m)])
        return Columns((-self.regressor(context, place) @ central)[..., None])

    def scale(self, context, place, shape):
        return np.array([0.8])

    def possible(self, context, place, theta):
        return bool(0.1 < 1.0 + theta[0] < 10.0)

    def numbers(self, context, place, shape, theta):
        return {"inertia_scale": Parameter(1.0 + float(theta[0]), "1", factor=True)}
