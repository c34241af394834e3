"""A stand-in for the real robot: the plant with what the estimator's model lacks.

Dry friction and more damping in every joint, cables (mass along an upper arm and on the pelvis), and the safety hoist,
a rope of some stiffness to the torso. Figures of our own.
"""

from dataclasses import dataclass

import mujoco

from benchmarks.paper.plant import mjcf
from jax_inertia.robots import Terrain

FOREARM = "left_elbow_pitch_link"
DUMBBELL = "dumbbell"
DUMBBELL_MASS = 5.44  # kg: 12 lb, as in the paper
GRIP = (-0.011, -0.011, -0.28)  # m, in the forearm's frame


@dataclass(frozen=True)
class Effects:
    """What the model lacks; zeros give the model itself."""

    friction: float = 0.6  # N m, arms; legs and spine have twice that
    damping: float = 0.15  # N m s/rad, beside what the model has
    arm_cable: float = 0.3  # kg, halfway down the left upper arm
    pelvis_cable: float = 0.8  # kg
    hoist: float = 40.0  # N, upward on the torso when standing


NOTHING = Effects(0.0, 0.0, 0.0, 0.0, 0.0)


def hardware(
    effects: Effects, *, terrain: Terrain = Terrain.FLAT, solref: tuple[float, float] = (0.006, 1.0)
) -> mujoco.MjModel:
    """The plant with these effects, and a dumbbell on the left forearm (`LinkMass` takes it off)."""
    spec = mujoco.MjSpec.from_string(mjcf(terrain=terrain, solref=solref))
    ball = 0.4 * 0.05**2  # kg m² per kg, a ball of 5 cm

    def lump(parent: str, name: str, mass: float, pos: tuple[float, float, float]) -> None:
        if mass > 0:
            body = spec.body(parent).add_body(name=name, pos=pos)
            body.mass, body.inertia, body.explicitinertial = mass, [ball * mass] * 3, True
            body.ipos = [0.0, 0.0, 0.0]  # left out, MuJoCo takes it to be `pos`

    lump(FOREARM, DUMBBELL, DUMBBELL_MASS, GRIP)
    lump("left_shoulder_yaw_link", "arm_cable", effects.arm_cable, (0.03, 0.0, -0.2))
    lump("pelvis_link", "pelvis_cable", effects.pelvis_cable, (-0.1, 0.0, 0.0))
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
            arm = "shoulder" in joint.name or "elbow" in joint.name
            joint.frictionloss = effects.friction * (1.0 if arm else 2.0)
            joint.damping[0] += effects.damping
    if effects.hoist > 0:
        spec.body("torso_link").add_site(name="hook", pos=[-0.05, 0.0, 0.45])
        spec.worldbody.add_site(name="crane", pos=[-0.05, 0.0, 3.5])
        rope = spec.add_tendon(name="hoist", stiffness=400.0, springlength=[0.0, 0.0])
        rope.wrap_site("hook")
        rope.wrap_site("crane")
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_forward(model, data)
        length = float(data.ten_length[0]) - effects.hoist / 400.0
        rope.springlength = [0.0, length]
    return spec.compile()
