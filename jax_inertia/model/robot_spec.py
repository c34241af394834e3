"""A loaded robot as a MuJoCo spec: what a model that was changed in memory, or came without a file, is written from."""

import mujoco
import numpy as np

from jax_inertia.model.load import set_inertials
from jax_inertia.model.mujoco_types import MjSpec
from jax_inertia.model.robot import BALL, FREE, HINGE, SLIDE, WELD, Robot

_TYPE = {
    FREE: mujoco.mjtJoint.mjJNT_FREE,
    BALL: mujoco.mjtJoint.mjJNT_BALL,
    SLIDE: mujoco.mjtJoint.mjJNT_SLIDE,
    HINGE: mujoco.mjtJoint.mjJNT_HINGE,
}


def spec_of(robot: Robot) -> MjSpec:
    """A spec with the robot's bodies, joints and gravity: the same equations of motion, no geometry and no actuators.

    Bodies and joints are in the robot's order and have its names, so states carry over. What is fixed to the world is
    left out, as in the robot. Loops and couplings between joints are not in a `Robot`'s dynamics and not in the spec.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.model.robot_spec import spec_of
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> spec_of(load_model(double_pendulum())).compile().nv
    2
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.gravity = np.asarray(robot.gravity)
    tree, joint_of = robot.topology, {}
    for node, kind in enumerate(tree.kind):
        if kind != WELD:
            joint_of[node] = len(joint_of)
    bodies: dict[int, object] = {}
    for index, (name, last) in enumerate(zip(robot.body_names, tree.body_node, strict=True)):
        run = [last]
        while (up := tree.parent[run[0]]) >= 0 and up not in bodies:
            run.insert(0, up)
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, np.asarray(robot.placement_rotation, float)[run[0]].ravel())
        under = bodies[tree.parent[run[0]]] if tree.parent[run[0]] >= 0 else spec.worldbody
        body = under.add_body(  # pyright: ignore[reportAttributeAccessIssue]
            name=name, pos=np.asarray(robot.placement_position)[run[0]], quat=quat
        )
        bodies[last] = body
        for node in run:
            if node in joint_of:
                _add_joint(body, robot, node, joint_of[node])
        if robot.compensated is not None and float(robot.pi[index, 0]) > 0:
            body.gravcomp = float(robot.compensated[index, 0] / robot.pi[index, 0])
    pi = {name: np.asarray(p) for name, p in zip(robot.body_names, robot.pi, strict=True)}
    set_inertials(spec, {name: p for name, p in pi.items() if p[0] > 0})
    return spec


def _add_joint(body, robot: Robot, node: int, joint: int) -> None:
    kind, row = robot.joint_type[joint], robot.joint_dofadr[joint]
    out = body.add_joint(name=robot.joint_names[joint], type=_TYPE[kind])
    if kind == FREE:
        return
    out.pos = np.asarray(robot.joint_position)[node]
    numbers = (robot.armature, robot.frictionloss, robot.damping, robot.stiffness)
    out.armature, out.frictionloss, damping, stiffness = (float(x[row]) for x in numbers)
    out.damping, out.stiffness = np.array([damping, 0, 0]), np.array([stiffness, 0, 0])
    if kind in (HINGE, SLIDE):
        out.axis = np.asarray(robot.joint_axis)[node]
        out.ref = float(robot.joint_reference[node])
        out.springref = float(robot.spring_reference[row])
