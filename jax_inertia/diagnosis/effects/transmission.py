"""Effects of a transmission that ties joints together: a wrist motor that turns with the joint before it."""

import mujoco
import numpy as np

from jax_inertia.diagnosis.effects import advice
from jax_inertia.diagnosis.effects.base import Columns, Edit, Effect, Parameter, Place, peak_of
from jax_inertia.diagnosis.effects.spec_joint import actuators_of, joint_named


class JointCoupling(Effect):
    """The motor of joint j turns by q̇ⱼ + c q̇ᵢ: its torque acts on i too, c τⱼ, and its friction feels i's speed."""

    name, equation, form_error = "joint_coupling", "τᵢ + c τⱼ, friction of j by q̇ⱼ + c q̇ᵢ", 0.05
    source, advice = (
        "belts and bevels through a wrist; Siciliano et al., Robotics, 2009, sec. 5.1",
        advice.ONE_AT_A_TIME,
    )
    units = {"coefficient": "1", "friction_of_other_speed": "N m s/rad"}
    prior = "c: 0.2, below 2; friction: 0.05 of the joint's peak torque at 1 rad/s"
    mjcf = "a fixed tendon over both joints for the actuators of j; torques in qfrc_applied and friction by step law"

    def places(self, context):
        rows = context.joint_dofs
        return [
            Place("joint", name, row, other)
            for name, row in rows.items()
            for other in rows
            if other != name
        ]

    def columns(self, context, place, shape):
        out = np.zeros((*context.tau.shape, 2))
        other = context.joint_dofs[place.other]
        out[:, other, 0] = context.tau[:, place.index]
        out[:, place.index, 1] = -context.v[:, other]
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
        actuators = actuators_of(spec, found)
        if not actuators:
            return Edit(whole=False)
        tendon = spec.add_tendon(name=f"{own.name}_with_{other.name}")
        tendon.wrap_joint(own.name, 1.0)
        tendon.wrap_joint(other.name, found.values["coefficient"])
        for actuator in actuators:
            actuator.trntype, actuator.target = mujoco.mjtTrn.mjTRN_TENDON, tendon.name
        remark = (
            f"joint {own.name!r}: its actuators pull the tendon {tendon.name!r}, which turns by q of {own.name} + "
            f"{found.values['coefficient']:.4g} q of {other.name}"
        )
        return Edit(whole=False, remark=remark)

    def step(self, xp, now, at, applied):
        rows = np.arange(len(at.driven))
        asked = now.u[at.index]
        drawn = at.values["coefficient"] * asked * (rows == at.other)
        slowed = at.values["friction_of_other_speed"] * now.v[at.other] * at.rows
        return applied._replace(torque=applied.torque + drawn - slowed)
