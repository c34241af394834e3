"""Effects at a joint's own axis: viscous friction and its forms, springs, rotor inertia, teeth of the motor."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from jax_inertia.diagnosis.effects import advice
from jax_inertia.diagnosis.effects.base import Edit, Effect, Parameter, Term, of_row, peak_of
from jax_inertia.diagnosis.effects.spec_joint import add_damping, joint_of, wind

ARMSTRONG = "Armstrong-Hélouvry, Dupont and Canudas de Wit, Automatica 30(7), 1994"


class _AlongTheJoint(Effect):
    """A column of the joint's motion; θ scales with the joint's peak torque by `share`.

    At the joint's usual speed, where the torque grows with that to the power `of_speed`.
    """

    share, of_speed = 0.1, 0
    advice = advice.WIDE

    def scale(self, context, place, shape):
        row = place.index
        usual = context.usual_speed[row] ** self.of_speed
        return np.array([self.share * peak_of(context, row) / usual])

    def numbers(self, context, place, shape, theta):
        ((name, unit),) = self.units.items()
        return {name: Parameter(float(theta[0]), unit)}


class ViscousFriction(_AlongTheJoint):
    name, equation, ordinary, form_error = "viscous_friction", "−d q̇", True, 0.02
    source, units, share = ARMSTRONG, {"damping": "N m s/rad"}, 0.15
    of_speed = 1
    prior = "0.15 of the joint's peak torque at top speed, 1 rad/s at most; not below minus the model's own"
    mjcf = "joint damping"

    def friction_terms(self, context, place, shape):
        return ({Term("viscous"): 1.0},)

    def columns(self, context, place, shape):
        return of_row(-context.v[:, place.index], place)

    def lower(self, context, place):
        return -float(context.damping[place.index])

    def edit(self, spec, model, found):
        add_damping(joint_of(spec, found), found.values["damping"])
        return Edit(whole=True)


class Armature(_AlongTheJoint):
    name, equation, ordinary = "armature", "−I q̈", True
    source = "Featherstone, Rigid Body Dynamics Algorithms, 2008, sec. 9.6: a rotor's inertia times gear ratio squared"
    units, advice = {"armature": "kg m²"}, advice.STARTS_AND_STOPS
    prior = (
        "0.3 of the joint's peak torque over its peak acceleration; not below minus the model's own"
    )
    mjcf = "joint armature"

    def columns(self, context, place, shape):
        return of_row(-context.a[:, place.index], place)

    def scale(self, context, place, shape):
        top = np.percentile(np.abs(context.a[:, place.index]), 99.5)
        return np.array([0.3 * peak_of(context, place.index) / max(float(top), 1e-6)])

    def lower(self, context, place):
        return -float(context.armature[place.index])

    def edit(self, spec, model, found):
        joint = joint_of(spec, found)
        joint.armature = max(joint.armature + found.values["armature"], 0.0)
        return Edit(whole=True)


class TorqueBias(_AlongTheJoint):
    name, equation, ordinary, constant = "torque_bias", "+ b", True, True
    source = "a current sensor's or a torque sensor's zero"
    units, share, advice = {"bias": "N m"}, 0.05, advice.BOTH_WAYS
    prior = "0.05 of the joint's peak torque"
    mjcf = "joint stiffness of a thousandth of it a radian, wound up by springref"

    def columns(self, context, place, shape):
        return of_row(np.ones(len(context.time)), place)

    def edit(self, spec, model, found):
        wind(spec, joint_of(spec, found), 0.0, 0.0, found.values["bias"])
        return Edit(whole=True)


class AsymmetricViscous(_AlongTheJoint):
    name, equation, refines = "asymmetric_viscous", "−½ (d⁺ − d⁻) |q̇|", True
    source = ARMSTRONG
    units, share, of_speed, form_error = {"difference": "N m s/rad"}, 0.1, 1, 0.05
    prior = "0.1 of the joint's peak torque at top speed, 1 rad/s at most"
    mjcf = "none: step law"

    def friction_terms(self, context, place, shape):
        return ({Term("slope_by_direction"): 1.0},)

    def columns(self, context, place, shape):
        return of_row(-0.5 * np.abs(context.v[:, place.index]), place)

    def torque(self, xp, now, at):
        return -0.5 * at.values["difference"] * xp.abs(now.v)


class QuadraticViscous(_AlongTheJoint):
    name, equation, refines = "quadratic_viscous", "−c |q̇| q̇", True
    source = "churning of oil; " + ARMSTRONG
    units, share, of_speed, form_error = {"coefficient": "N m s²/rad²"}, 0.05, 2, 0.05
    prior = "0.05 of the joint's peak torque at top speed, 1 rad/s at most"
    mjcf = "joint damping, its second coefficient; MJX by step law"
    unread_by_mjx = True

    def friction_terms(self, context, place, shape):
        return ({Term("quadratic"): 1.0},)

    def columns(self, context, place, shape):
        v = context.v[:, place.index]
        return of_row(-np.abs(v) * v, place)

    def edit(self, spec, model, found):
        add_damping(joint_of(spec, found), found.values["coefficient"], power=1)
        return Edit(whole=True)

    def torque(self, xp, now, at):
        return -at.values["coefficient"] * xp.abs(now.v) * now.v


class FrictionDrift(_AlongTheJoint):
    name, equation, refines = "friction_drift", "−(d∞ + d₁ exp(−t/T)) q̇", True
    source = "a lubricant that warms up; Simoni, Beschi, Legnani and Visioli, Robotica 37(5), 2019"
    units = {"damping": "N m s/rad", "damping_final": "N m s/rad", "time_constant": "s"}
    share, of_speed, form_error, advice = 0.1, 1, 0.05, advice.FROM_COLD
    level, level_in = "viscous_friction", ("damping", "damping_final")
    prior = "d₁: 0.1 of the joint's peak torque at top speed, 1 rad/s at most; not below zero; T from 0.5 to 24 s"
    mjcf = "joint damping for d∞; the rest by step law"

    def shapes(self, context, place):
        return [(T,) for T in (1.0, 2.0, 3.0, 5.0, 8.0, 12.0) if 2 * context.time[-1] > T]

    def steps(self, context, place, shape):
        return (0.3 * shape[0],)

    def within(self, context, place, shape):
        # What takes longer than such a log is no drift in it but a joint's damping.
        return 0.5 <= shape[0] <= 24.0

    def lower(self, context, place):
        # A lubricant gets thinner as it warms.
        return 0.0

    def friction_terms(self, context, place, shape):
        return ({Term("drift", float(shape[0])): 1.0},)

    def columns(self, context, place, shape):
        return of_row(-context.v[:, place.index] * np.exp(-context.time / shape[0]), place)

    def numbers(self, context, place, shape, theta):
        # d∞ before d₁ where both are fitted at once.
        *final, more = (float(x) for x in theta)
        return {
            "damping": Parameter(sum(final) + more, "N m s/rad"),
            "damping_final": Parameter(float(sum(final)), "N m s/rad"),
            "time_constant": Parameter(shape[0], "s", 0.0),
        }

    def edit(self, spec, model, found):
        add_damping(joint_of(spec, found), found.values["damping_final"])
        return Edit(whole=False)

    def torque(self, xp, now, at):
        more = at.values["damping"] - at.values["damping_final"]
        return -more * xp.exp(-now.t / at.values["time_constant"]) * now.v


RESTS_WITHIN = 1.5
"""Of the model's zero [rad], one standard deviation: half a usual joint's range."""
FURTHEST_REST = 4 * RESTS_WITHIN
"""What rests further away is a constant torque."""


class JointSpring(_AlongTheJoint):
    """θ is k q₀ and k: where a spring rests is as wide as its joint, so its constant part is no zero of a sensor."""

    name, equation = "joint_spring", "−k (q − q₀)"
    source = "a hose, a cable, a balancing spring: Hooke"
    units = {"stiffness": "N m/rad", "rest_angle": "rad"}
    prior = "0.1 of the joint's peak torque at 1 rad, at rest within 1.5 rad, 6 at most; the sum not below zero"
    mjcf = "joint stiffness and springref"

    def columns(self, context, place, shape):
        q = context.joint_position[:, place.index]
        return of_row(np.stack([np.ones_like(q), -q], axis=1), place)

    def scale(self, context, place, shape):
        return super().scale(context, place, shape) * np.array(
            [RESTS_WITHIN, 1.0 / context.radian[place.index]]
        )

    def numbers(self, context, place, shape, theta):
        moment, stiffness = (float(x) for x in theta)
        return {
            "stiffness": Parameter(stiffness, "N m/rad"),
            "rest_angle": Parameter(moment / stiffness if stiffness else 0.0, "rad"),
        }

    def possible(self, context, place, theta):
        whole = theta[1] >= -float(context.stiffness[place.index]) - 1e-12
        furthest = FURTHEST_REST * context.radian[place.index]
        return bool(whole and abs(theta[0]) <= furthest * abs(theta[1]))

    def edit(self, spec, model, found):
        values = found.values
        wind(spec, joint_of(spec, found), values["stiffness"], values["rest_angle"], 0.0)
        return Edit(whole=True)


FEWEST_WAVES = 4.0
"""Least N [1/rad]: a motor has four teeth or more a turn. Of a slide [1/m]: an eccentric pulley of a quarter metre."""


class Cogging(_AlongTheJoint):
    """θ: sine and cosine of the wave, then those of its second harmonic."""

    name, equation, form_error = "cogging", "A sin(N q + φ) + B sin(2 N q + ψ), B ≤ A", 0.05
    source = "a motor's teeth; Zhu and Howe, IEEE Trans. Energy Conversion 15(4), 2000"
    units: ClassVar[Mapping[str, str]] = {
        "amplitude": "N m",
        "frequency": "1/rad",
        "phase": "rad",
        "harmonic": "N m",
        "harmonic_phase": "rad",
    }
    advice = advice.SLOW_SWEEP
    prior = "0.05 of the joint's peak torque, below 0.3 of it; of the harmonic a fifth of that"
    mjcf = "none: step law"

    def shapes(self, context, place):
        radian = context.radian[place.index]
        v, span = context.v[:, place.index], self._span(context, place)
        # Faster than the analysis band lets through at half the moments, teeth are not seen.
        fastest = 0.7 * context.prepared.bands.cutoff * 2 * np.pi
        highest = min(60.0 / radian, fastest / max(float(np.percentile(np.abs(v), 50)), 1e-3))
        lowest = self._lowest(context, place)
        step = max(0.5 / radian, 1.5 / span)
        return [(float(n),) for n in np.arange(lowest, max(highest, lowest), step)]

    def steps(self, context, place, shape):
        return (0.2 / context.radian[place.index],)

    def within(self, context, place, shape):
        return shape[0] >= self._lowest(context, place)

    def _lowest(self, context, place) -> float:
        """Of half a wave along the path: of less, a spring says the same. Wheels that drive a slide are of any size."""
        return max(FEWEST_WAVES, np.pi / self._span(context, place))

    @staticmethod
    def _span(context, place) -> float:
        """Length of the joint's path [rad, of a slide m]."""
        return max(float(np.ptp(context.joint_position[:, place.index])), 1e-3)

    many = True

    def apart(self, context, place, one, other):
        # Waves that are a whole one apart over the joint's path, as a Fourier series' are.
        span = float(np.ptp(context.joint_position[:, place.index]))
        return abs(one[0] - other[0]) * span >= 2 * np.pi

    def columns(self, context, place, shape):
        angle = shape[0] * context.joint_position[:, place.index]
        waves = [f(k * angle) for k in (1, 2) for f in (np.sin, np.cos)]
        return of_row(np.stack(waves, 1), place)

    def scale(self, context, place, shape):
        return 0.05 * peak_of(context, place.index) * np.array([1.0, 1.0, 0.2, 0.2])

    def numbers(self, context, place, shape, theta):
        return {
            "amplitude": Parameter(float(np.hypot(*theta[:2])), "N m", 0.0),
            "frequency": Parameter(shape[0], "1/rad", 0.0),
            "phase": Parameter(float(np.arctan2(theta[1], theta[0])), "rad"),
            "harmonic": Parameter(float(np.hypot(*theta[2:])), "N m", 0.0),
            "harmonic_phase": Parameter(float(np.arctan2(theta[3], theta[2])), "rad"),
        }

    def possible(self, context, place, theta):
        wave, harmonic = np.hypot(*theta[:2]), np.hypot(*theta[2:])
        return bool(harmonic <= wave < 0.3 * peak_of(context, place.index))

    def torque(self, xp, now, at):
        angle = at.values["frequency"] * now.q
        wave = at.values["amplitude"] * xp.sin(angle + at.values["phase"])
        # Who states the wave alone states no harmonic.
        harmonic, phase = (at.values.get(k, 0.0) for k in ("harmonic", "harmonic_phase"))
        return wave + harmonic * xp.sin(2.0 * angle + phase)
