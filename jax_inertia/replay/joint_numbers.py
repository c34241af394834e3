"""A vector of numbers of a fit as physics: of joints, of bodies, and of where gravity points."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.replay.loop import ALL, OFF, SHARES, Loop, Parameter


class Numbers(NamedTuple):
    """One number for each of the log's joints (n,), in SI units at the joint.

        τ = gain · (clip(kp dz(q*(t − d) − q; dead) + I + bias − (kd − back) q̇, ± limit) − back q̇)
        I = clip(integral ∫(q*(t − d) − q) dt, ± windup), the integral held at the clamp
        friction = max(dry + slant (q − middle) + load |τ| + stiction exp(−(q̇ / slow)²), 0) sign(q̇)
                   + damping q̇ + drag |q̇| q̇
        spring torque = wound − spring q
        across torque = (across_torque − across s − across_damping ṡ) ∂s/∂q, s = q_before + ratio q

    of q and q̇ that are `hold` old. dz is 0 within ± dead and parallel to the straight line beyond. `back` is stall
    torque over no-load speed.
    """

    armature: Float[np.ndarray, " n"]
    damping: Float[np.ndarray, " n"]
    dry: Float[np.ndarray, " n"]
    kp: Float[np.ndarray, " n"]
    kd: Float[np.ndarray, " n"]
    bias: Float[np.ndarray, " n"]
    limit: Float[np.ndarray, " n"]
    back: Float[np.ndarray, " n"]
    dead: Float[np.ndarray, " n"]
    play: Float[np.ndarray, " n"]
    """Full width of what a motor-side encoder does not see of the link's motion."""
    load: Float[np.ndarray, " n"]
    stiction: Float[np.ndarray, " n"]
    """What friction at rest has beyond `dry`."""
    slow: Float[np.ndarray, " n"]
    slant: Float[np.ndarray, " n"]
    """By what dry friction grows with position [N m/rad]."""
    middle: Float[np.ndarray, " n"]
    """Of the joint's range, where dry friction is `dry`."""
    offset: Float[np.ndarray, " n"]
    delay: Float[np.ndarray, " n"]
    lag: Float[np.ndarray, " n"]
    lead: Float[np.ndarray, " n"]
    """Of `delay`, what the torque that was logged does not have: it was made of the targets so much earlier."""
    behind: Float[np.ndarray, " n"]
    """Time constant T of the motor's torque; `lag` has it too, of the targets."""
    gain: Float[np.ndarray, " n"]
    """Of the joint's torque over the one that the loop says."""
    drag: Float[np.ndarray, " n"]
    """Quadratic viscous friction [N m s²/rad²]."""
    spring: Float[np.ndarray, " n"]
    """Stiffness beyond the model's own [N m/rad]."""
    wound: Float[np.ndarray, " n"]
    """Torque at the joint's zero of what that spring has beyond the model's own."""
    hold: Float[np.ndarray, " n"]
    """How old, on average, what the loop acts on is [s]."""
    steps: Float[np.ndarray, " n"]
    """Damping times this is no inertia of the joint, and kd times this (`step_of_kd`) [s]: what the model's own steps
    add is undone, and a velocity that is older than the position of its sample takes more."""
    step_of_kd: Float[np.ndarray, " n"]
    """1 where kd is taken implicitly, as damping is, −1 where it is taken explicitly."""
    low_pass: Float[np.ndarray, " n"]
    """Time constant of a low-pass that targets go through once a `low_pass_period` [s]."""
    low_pass_period: Float[np.ndarray, " n"]
    integral: Float[np.ndarray, " n"]
    """Of the drive: torque by one of ∫(q* − q) dt [N m/(rad s)]."""
    windup: Float[np.ndarray, " n"]
    """Largest torque of it, beyond which the drive integrates no more [N m]; infinite where it has no clamp."""
    across: Float[np.ndarray, " n"]
    """Stiffness of a spring across the joint and the one before it in its chain [N m/rad]."""
    across_damping: Float[np.ndarray, " n"]
    ratio: Float[np.ndarray, " n"]
    """Of the joint's turn in the spring's, over that of the one before it."""
    across_torque: Float[np.ndarray, " n"]
    """Of that spring, where both joints are at their zeros [N m]."""
    mass: Mapping[str, float]
    """Added to bodies."""
    centres: Mapping[str, Float[np.ndarray, " 3"]]
    """Where it is, from the body's own centre of mass, in the body's axes."""
    shifts: Mapping[str, Float[np.ndarray, " 3"]]
    """Of bodies' centres of mass, in the body's axes."""
    heavier: Mapping[str, Float[np.ndarray, " 2"]]
    """By what share bodies' masses are larger, of the same shape, and by what share their inertias are beyond that."""
    forces: Mapping[str, Float[np.ndarray, " 3"]]
    """Constant forces at bodies' centres of mass, along the world's axes [N]."""
    tilt: Float[np.ndarray, " 2"]
    """Of gravity, by a rotation vector about world x and y [rad]."""

    @property
    def varies(self) -> bool:
        """Whether dry friction changes along the motion, which no attribute of a model can say."""
        return bool(np.any(self.varies_at))

    @property
    def varies_at(self) -> Bool[np.ndarray, " n"]:
        """At which joints it does."""
        return (self.load > 0) | (self.stiction > 0) | (self.slant != 0)

    @property
    def shares_limit(self) -> Bool[np.ndarray, " n"]:
        """At which joints several actuators have one limit."""
        return (self.dead > 0) | (self.integral > 0)

    @property
    def has_across(self) -> Bool[np.ndarray, " n"]:
        """Which joints have a spring across them and the one before."""
        return (self.across > 0) | (self.across_torque != 0) | (self.across_damping > 0)

    @property
    def at_joint(self) -> "Numbers":
        """The same numbers as the joint feels them: every torque times the gain, by a loop that holds nothing.

        −kp q(t − h) − kd q̇(t − h) = −kp q − (kd − kp h) q̇ + kd h q̈ to the first order in the hold h: so much less
        kd, or damping where there is less kd than that; neither is less than none. And so much less armature: below
        none, it is the link's (`model_edits.lightened`). What the model's own steps do to its inertia (`Plant`), and
        `steps` undoes, is armature too.
        """
        felt = {
            k: self.gain * getattr(self, k)
            for k in ("kp", "kd", "bias", "limit", "back", "integral", "windup")
        }
        lost = felt["kp"] * self.hold
        kd = np.maximum(felt["kd"] - lost, 0.0)
        felt["damping"] = np.maximum(self.damping - (lost - (felt["kd"] - kd)), 0.0)
        held = felt["kd"] * self.hold + self.steps * (self.damping + self.step_of_kd * kd)
        felt["armature"] = self.armature - held
        none = {"hold": np.zeros_like(self.hold), "steps": np.zeros_like(self.hold)}
        return self._replace(**felt | none | {"kd": kd}, gain=np.ones_like(self.gain))

    @property
    def lumped(self) -> "Numbers":
        """Without a motor's lag, which is kp and kd of targets that lag and, to the second order in T, of the joint

        (kp + kd s) / (T s + 1) = kp + (kd − kp T) s − (kd − kp T) T s²
        """
        damping = self.kd - self.kp * self.behind
        return self._replace(
            kd=damping,
            armature=self.armature - damping * self.behind,
            behind=np.zeros_like(self.behind),
        )

    def asked(self, commanded: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """What the loop asks for but for its integral, which the limit cuts, at positions and velocities (..., n)."""
        miss = commanded - q
        if self.dead.any():
            miss = miss - np.minimum(np.maximum(miss, -self.dead), self.dead)
        return self.kp * miss + self.bias - (self.kd - self.back) * v

    def torque(self, commanded: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """What the motors give at positions and velocities (..., n), `commanded` being what `record.controls` makes."""
        return self.given(self.asked(commanded, q, v), v)

    def given(self, asked: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Of what is asked for."""
        within = np.minimum(np.maximum(asked, -self.limit), self.limit)
        return self.gain * (within - self.back * v)

    def friction(self, torque: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Dry friction's size at a torque, a position and a velocity."""
        size = self.dry + self.slant * (q - self.middle) + self.load * np.abs(torque)
        if self.stiction.any():
            size += self.stiction * np.exp(-((v / self.slow) ** 2))
        return np.maximum(size, 0.0)


NOT_OF_JOINTS = "mass", "centres", "shifts", "heavier", "forces", "tilt"
"""Fields that are of bodies or of the whole robot."""
CENTRE = "payload_x", "payload_y", "payload_z"
"""Families of a load's place."""
FORCE = "force_x", "force_y", "force_z"
"""Families of a constant force."""
SHIFT, TILT = ("com_shift_x", "com_shift_y", "com_shift_z"), ("tilt_x", "tilt_y")
"""Families of a centre's shift, and of where gravity points."""
RATIO = "across_ratio"
ACROSS = "across_torque", "across_damping", RATIO
"""Families of a spring across two joints besides its stiffness, which alone says whether there is one."""
COORDINATES = *CENTRE, *SHIFT, *TILT, *FORCE, "spring_torque", "integral_windup", *ACROSS
"""Families of which an effect may need some and not others."""
# Family of a parameter: the field that it is added to, or put in place of.
_ADDED = {
    "encoder_offset": "offset", "torque_bias": "bias", "target_delay": "delay", "target_lag": "lag",
    "actuator_lag": "behind", "torque_lead": "lead", "spring_torque": "wound", "loop_hold": "hold",
    "own_steps": "steps",
}  # fmt: skip
_REPLACED = {
    "armature": "armature", "coulomb_friction": "dry", "dead_band": "dead", "backlash": "play",
    "load_friction": "load", "stribeck_friction": "stiction", "stribeck_velocity": "slow",
    "torque_speed": "back", "position_friction": "slant", "quadratic_viscous": "drag",
    "joint_spring": "spring", "target_low_pass": "low_pass", "drive_integral": "integral",
    "spring_across": "across", "across_ratio": "ratio", "across_torque": "across_torque",
    "across_damping": "across_damping",
}  # fmt: skip


def nominal_numbers(
    loop: Loop,
    armature: Float[np.ndarray, " n"],
    damping: Float[np.ndarray, " n"],
    dry: Float[np.ndarray, " n"],
    bias: Float[np.ndarray, " n"],
    delay: Float[np.ndarray, " n"],
    lag: Float[np.ndarray, " n"],
    middle: Float[np.ndarray, " n"],
    period: float = 0.02,
) -> Numbers:
    """Those of a model and its loop: nothing is lacking. `period` [s]: of a low-pass of targets, were there one."""
    none = np.zeros(len(loop.kp))
    return Numbers(
        armature, damping, dry, loop.kp, loop.kd, bias, loop.limit, none, none, none, none, none,
        none + 0.1, none, middle, none, delay, lag, none, none, none + 1.0, none, none, none, none,
        none, none + 1.0, none, none + period, none, none + np.inf, none, none,
        none, none, {}, {}, {}, {}, {}, np.zeros(2),
    )  # fmt: skip


def decoded(
    base: Numbers, table: Sequence[Parameter], theta: Float[np.ndarray, " P"], loop: Loop
) -> Numbers:
    """The numbers of a vector, those that it does not hold as in `base`; `loop`: while the record was made.

    `target_delay` is what torques have too, where these are logged, and `torque_lead` what motion has beyond that, so
    that torque tells the one alone. `viscous_friction` is of loop and joint in one, at `base`'s kd; what exceeds the
    loop's part is the joint's, and a sum below it is less kd.
    """
    new = {k: np.array(x) for k, x in base._asdict().items() if k not in NOT_OF_JOINTS}
    new["kp"], new["kd"] = loop.kp.copy(), loop.kd.copy()
    mass, centres, shifts, heavier, forces, tilt = {}, {}, {}, {}, {}, np.zeros(2)
    whole = base.damping + base.kd
    for i, (p, x) in enumerate(zip(table, theta, strict=True)):
        # A ratio, whose nominal value is of either sign, is of the spring whose numbers are before it.
        of_spring = p.family == RATIO and np.any(theta[max(i - 3, 0) : i])
        if x == p.nominal and not of_spring:
            # Not there: another number may say something of the same place.
            continue
        at = slice(None) if p.joint == ALL else p.joint
        if p.family in _ADDED:
            new[_ADDED[p.family]][at] += max(x, 0.0) if p.family == "target_lag" else x
        elif p.family in _REPLACED:
            new[_REPLACED[p.family]][at] = x
        elif p.family == "asymmetric_coulomb":
            # Of F + d one way and F − d the other, d is a constant torque.
            new["wound"][at] -= x
        elif p.family in ("kp_scale", "kd_scale"):
            new[p.family[:2]][at] *= np.exp(x)
        elif p.family == "viscous_friction":
            whole[p.joint] = x
        elif p.family == "torque_saturation":
            new["limit"][at] = np.exp(x)
        elif p.family == "integral_windup":
            new["windup"][at] = 1.0 / x
        elif p.family == "torque_gain":
            new["gain"][at] = np.exp(x)
        elif p.family == "payload":
            mass[p.body] = x
        elif p.family in CENTRE:
            centres.setdefault(p.body, np.zeros(3))[CENTRE.index(p.family)] = x
        elif p.family in SHIFT:
            shifts.setdefault(p.body, np.zeros(3))[SHIFT.index(p.family)] += x
        elif p.family in OFF:
            shifts.setdefault(p.body, np.zeros(3))[OFF.index(p.family)] += x
        elif p.family in SHARES:
            heavier.setdefault(p.body, np.zeros(2))[SHARES.index(p.family)] = x
        elif p.family in FORCE:
            forces.setdefault(p.body, np.zeros(3))[FORCE.index(p.family)] = x
        elif p.family in TILT:
            tilt[TILT.index(p.family)] = x
    new["delay"] += new["lead"]
    new["lag"] += new["behind"]
    rest = whole - base.kd
    new["kd"] = np.maximum(np.minimum(new["kd"], rest + new["kd"]), 0.0)
    new["damping"] = np.maximum(rest, 0.0)
    return Numbers(
        **new, mass=mass, centres=centres, shifts=shifts, heavier=heavier, forces=forces, tilt=tilt
    )
