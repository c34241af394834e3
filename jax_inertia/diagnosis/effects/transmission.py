"""Effects of a transmission that ties joints together: a wrist motor that turns with the joint before it."""

import mujoco
import numpy as np

from jax_inertia.diagnosis.effects import advice
from jax_inertia.diagnosis.effects.base import Columns, Edit, Effect, Parameter, Place, peak_of
from jax_inertia.diagnosis.effects.spec_joint import (
    actuators_of,
    add_damping,
    joint_named,
    set_first,
)


class JointCoupling(Effect):
    """The motor of joint j turns by w = q̇ⱼ + c q̇ᵢ: what it gives, less what itself takes, acts on j and c of it on i.

        yⱼ = − I c q̈ᵢ − F (sign w − sign q̇ⱼ) − f q̇ᵢ
        yᵢ = c (tⱼ + d q̇ⱼ) − f q̇ⱼ

    tⱼ: what the link of j needs; I, F, d: the joint's rotor inertia, dry and viscous friction, of which f / c is the
    motor's. The nonlinear number is c, about which dry friction is the secant.
    """

    name, equation, form_error = (
        "joint_coupling",
        "motor of j at q̇ⱼ + c q̇ᵢ, c of its torque on i",
        0.05,
    )
    calibrated, secant = True, True
    source, advice = (
        "belts and bevels through a wrist; Siciliano et al., Robotics, 2009, sec. 5.1",
        advice.ONE_AT_A_TIME,
    )
    units = {"coefficient": "1", "friction_of_other_speed": "N m s/rad"}
    prior = "c: 0.2, below 2; friction: 0.05 of the joint's peak torque at 1 rad/s"
    mjcf = "a fixed tendon over both joints for rotor, friction and actuators of j; torques in qfrc_applied by step law"
    takes_over = True

    def places(self, context):
        rows = context.joint_dofs
        return [
            Place("joint", name, row, other)
            for name, row in rows.items()
            for other in rows
            if other != name
        ]

    def shapes(self, context, place):
        return [(0.0, 0.0)]

    def columns(self, context, place, shape):
        j, i = place.index, context.joint_dofs[place.other]
        out = np.zeros((*context.tau.shape, 2))
        out[:, i, 0] = context.link_torque[:, j] + context.damping[j] * context.v[:, j]
        out[:, j, 0] = -context.armature[j] * context.a[:, i]
        if shape[0]:
            turned = np.sign(context.v[:, j] + shape[0] * context.v[:, i]) - context.side[:, j]
            out[:, j, 0] -= context.frictionloss[j] * turned / shape[0]
        out[:, i, 1], out[:, j, 1] = -context.v[:, j], -context.v[:, i]
        return Columns(out)

    def scale(self, context, place, shape):
        return np.array([0.2, 0.05 * peak_of(context, place.index)])

    def numbers(self, context, place, shape, theta):
        return {
            "coefficient": Parameter(float(theta[0]), "1"),
            "friction_of_other_speed": Parameter(float(theta[1]), "N m s/rad"),
        }

    def possible(self, context: object, place: Place, theta: np.ndarray) -> bool:
        return bool(abs(theta[0]) < 2.0)

    def edit(self, spec, model, found):
        own, other = (joint_named(spec, name) for name in (found.name, found.other))
        c = found.values["coefficient"]
        tendon = spec.add_tendon(name=f"{own.name}_with_{other.name}")
        tendon.wrap_joint(own.name, 1.0)
        tendon.wrap_joint(other.name, c)
        # Of the motor now: what turns and rubs there. Viscous friction that it has not got stays the joint's.
        tendon.armature, own.armature = own.armature, 0.0
        tendon.frictionloss, own.frictionloss = own.frictionloss, 0.0
        of_motor = found.values["friction_of_other_speed"] / c if c else 0.0
        of_motor = float(np.clip(of_motor, 0.0, own.damping[0]))
        add_damping(own, -of_motor)
        tendon.damping = set_first(tendon.damping, of_motor)
        for actuator in actuators_of(spec, found):
            actuator.trntype, actuator.target = mujoco.mjtTrn.mjTRN_TENDON, tendon.name
        remark = (
            f"joint {own.name!r}: its motor, with rotor and friction, is on the tendon {tendon.name!r}, which turns by "
            f"q of {own.name} + {c:.4g} q of {other.name}"
        )
        return Edit(whole=False, remark=remark)

    def step(self, xp, now, at, applied):
        rows = np.arange(len(at.driven))
        drawn = at.values["coefficient"] * now.u[at.index] * (rows == at.other)
        return applied._replace(torque=applied.torque + drawn)
