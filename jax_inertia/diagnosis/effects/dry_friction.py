"""Dry friction at a joint: its level, and how that depends on direction, speed and load.

All act through one direction state z in [−1, 1], which turns over a presliding displacement after a reversal (Dahl
1968), the first nonlinear number [rad]; below zero it is the level [N m] at which MuJoCo's friction loss creeps. Extra
forms are columns beside the constant level, so that levels add.
"""

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect, Shape, of_row, peak_of
from jax_inertia.gap.families.base import Parameter

PRESLIDING = (0.0, 5e-5, 1e-4, 2e-4, 4e-4, 8e-4, 1.6e-3, 3e-3, 6e-3)
"""Displacements searched [rad]: 1e-4 to 3e-3 in geared joints (Armstrong-Hélouvry et al. 1994)."""
STRIBECK_SPEEDS = (0.02, 0.035, 0.06, 0.1, 0.17, 0.3)
"""Speeds searched [rad/s]."""


def direction(context, row: int, presliding: float) -> np.ndarray:
    """z(t) of a joint (T,)."""
    if presliding < 0:
        return context.creeping(row, -presliding)
    return context.bristle(row, presliding) if presliding else context.side[:, row]


class DryFriction(Effect):
    """A form of a joint's dry friction; the first nonlinear number is its presliding displacement [rad]."""

    form_error = 0.03

    def shapes(self, context, place) -> list[Shape]:
        peak = peak_of(context, place.index)
        return [(x,) for x in (*PRESLIDING, *(-peak * s for s in (0.3, 0.1, 0.03)))]


class CoulombFriction(DryFriction):
    name, equation, ordinary = "coulomb_friction", "−F z, z → sign(q̇)", True

    def columns(self, context, place, shape):
        return of_row(-direction(context, place.index, shape[0]), place)

    def scale(self, context, place, shape):
        return np.array([0.15 * peak_of(context, place.index)])

    def numbers(self, context, place, shape, theta):
        return {"coulomb": Parameter(float(theta[0]), "N m")}

    def lower(self, context, place):
        return -float(context.frictionloss[place.index])


class AsymmetricCoulomb(DryFriction):
    name, equation, refines = "asymmetric_coulomb", "−½ (F⁺ − F⁻) |z|", True

    def columns(self, context, place, shape):
        return of_row(-np.abs(direction(context, place.index, shape[0])), place)

    def scale(self, context, place, shape):
        return np.array([0.03 * peak_of(context, place.index)])

    def numbers(self, context, place, shape, theta):
        return {
            "positive": Parameter(float(theta[0]), "N m"),
            "negative": Parameter(-float(theta[0]), "N m"),
        }


class StribeckFriction(DryFriction):
    name, equation, refines = "stribeck_friction", "−(Fs − Fc) exp(−(q̇/vs)²) z", True

    def shapes(self, context, place) -> list[Shape]:
        return [(x[0], v) for x in super().shapes(context, place) for v in STRIBECK_SPEEDS]

    def steps(self, context, place, shape):
        return (0.0, 0.3 * shape[1])

    def columns(self, context, place, shape):
        z = direction(context, place.index, shape[0])
        slow = np.exp(-((context.v[:, place.index] / shape[1]) ** 2))
        return of_row(-z * slow, place)

    def scale(self, context, place, shape):
        return np.array([0.08 * peak_of(context, place.index)])

    def numbers(self, context, place, shape, theta):
        return {
            "coulomb": Parameter(0.0, "N m"),
            "stiction": Parameter(float(theta[0]), "N m"),
            "stribeck_velocity": Parameter(shape[1], "rad/s", 0.0),
            "exponent": Parameter(2.0, "1"),
        }

    def lower(self, context, place):
        return 0.0


class LoadFriction(DryFriction):
    name, equation, refines = "load_friction", "−μ |τ| z", True

    def columns(self, context, place, shape):
        z = direction(context, place.index, shape[0])
        return of_row(-z * np.abs(context.inverse[:, place.index]), place)

    def scale(self, context, place, shape):
        return np.array([0.1])

    def numbers(self, context, place, shape, theta):
        return {
            "coulomb": Parameter(0.0, "N m"),
            "load_coefficient": Parameter(float(theta[0]), "1"),
            "of_motor": Parameter(0.0, "1"),
        }

    def lower(self, context, place):
        return 0.0


FORM_TOLERANCE = 0.05
"""How far from level plus viscous a joint's friction is on ordinary robots, each form, relative to its rms: mild
Stribeck curves and loads of a few per cent are no finding (Armstrong-Hélouvry et al. 1994, sec. 2)."""


TURNING_TOLERANCE = 0.5
"""How much of a joint's friction may turn round over another displacement: bristle laws differ in no other way."""


def _beside(presliding: float) -> tuple[float, ...]:
    """Displacements below and above one [rad]."""
    base = presliding if presliding > 0 else 1e-4
    return base / 2.5, base * 2.5


class FrictionForms(Effect):
    """Mild forms of an ordinary joint's friction, marginalised: Stribeck at two speeds, load, |q̇| q̇, direction.

    Shape: presliding displacement [rad], and the rms of the joint's ordinary friction torque [N m].
    """

    name, equation, named, marginal = "friction_forms", "level (1 + a mild form)", False, True
    form_error = 0.0

    def shapes(self, context, place):
        return []

    def columns(self, context, place, shape):
        row = place.index
        z, v = direction(context, row, shape[0]), context.v[:, row]
        load = np.abs(context.inverse[:, row])
        forms = [
            *(z * np.exp(-((v / speed) ** 2)) for speed in (0.05, 0.2)),
            z * load,
            np.abs(v) * v,
            np.abs(z),
            np.abs(v),
            # How it turns round after a reversal.
            *(direction(context, row, x) - z for x in _beside(shape[0])),
        ]
        return of_row(-np.stack(forms, 1), place)

    def scale(self, context, place, shape):
        size = np.sqrt(np.mean(self.columns(context, place, shape).values ** 2, axis=0))
        out = FORM_TOLERANCE * shape[1] / np.maximum(size, 1e-12)
        out[6:] = TURNING_TOLERANCE * shape[1]
        return out

    def numbers(self, context, place, shape, theta):
        return {}
