"""The same robot in Pinocchio, built joint by joint from a compiled MuJoCo model, without the package under test.

Conversions at the border: Pinocchio has quaternions xyzw; the velocity of a free joint in the body frame (so that
its acceleration has an extra −ω × v); π ordered [m, h, Ixx, Ixy, Iyy, Ixz, Iyz, Izz]; the bodies that move together
merged under one joint; armature in `rnea` and `crba` but not in the regressor.
"""

import mujoco
import numpy as np
import pytest

try:
    import pinocchio as pin
except ImportError as error:  # not installed, or a library of the system is missing (libgomp1)
    pytest.skip(f"Pinocchio, the second engine: {error}", allow_module_level=True)

# Where each entry of Pinocchio's π stands in ours.
ORDER = np.array([0, 1, 2, 3, 4, 5, 7, 6, 8, 9])


class PinocchioRobot:
    """A Pinocchio model with MuJoCo's q and v at its border."""

    def __init__(self, source: mujoco.MjModel):
        self.source = source
        self.model = pin.Model()
        self.model.gravity.linear = source.opt.gravity
        self.frames: list[tuple[int, pin.SE3]] = []
        """For each body that moves: the joint that carries it and the body's pose in that joint's frame."""
        carrier = {0: (0, pin.SE3.Identity())}
        for b in range(1, source.nbody):
            joint, pose = carrier[int(source.body_parentid[b])]
            pose = pose * _pose(source.body_quat[b], source.body_pos[b])
            for j in source.body_jntadr[b] + np.arange(source.body_jntnum[b]):
                joint, pose = self._add_joint(int(j), joint, pose)
            carrier[b] = (joint, pose)
            if joint == 0:
                continue
            self.model.appendBodyToJoint(joint, self._inertia(b), pose)
            self.frames.append((joint, pose))
        self.model.armature = source.dof_armature
        self.data = self.model.createData()

    def _add_joint(self, j: int, parent: int, pose: pin.SE3) -> tuple[int, pin.SE3]:
        kind, axis = mujoco.mjtJoint(self.source.jnt_type[j]), self.source.jnt_axis[j]
        anchor = pin.SE3(np.eye(3), self.source.jnt_pos[j])
        name = f"joint{j}"
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            added = pin.JointModelFreeFlyer()
            return self.model.addJoint(parent, added, pin.SE3.Identity(), name), pin.SE3.Identity()
        added = {
            mujoco.mjtJoint.mjJNT_HINGE: lambda: pin.JointModelRevoluteUnaligned(axis),
            mujoco.mjtJoint.mjJNT_SLIDE: lambda: pin.JointModelPrismaticUnaligned(axis),
            mujoco.mjtJoint.mjJNT_BALL: pin.JointModelSpherical,
        }[kind]()
        return self.model.addJoint(parent, added, pose * anchor, name), anchor.inverse()

    def _inertia(self, b: int) -> pin.Inertia:
        rotation = _pose(self.source.body_iquat[b], np.zeros(3)).rotation
        about_com = rotation @ np.diag(self.source.body_inertia[b]) @ rotation.T
        return pin.Inertia(self.source.body_mass[b], self.source.body_ipos[b], about_com)

    def configuration(self, q: np.ndarray) -> np.ndarray:
        """Pinocchio's q: quaternions xyzw, travel from the reference."""
        out = q - self.source.qpos0
        for j in range(self.source.njnt):
            start = self.source.jnt_qposadr[j]
            if self.source.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE:
                out[start : start + 3] = q[start : start + 3]
                start += 3
            elif self.source.jnt_type[j] != mujoco.mjtJoint.mjJNT_BALL:
                continue
            w, x, y, z = q[start : start + 4]
            out[start : start + 4] = x, y, z, w
        return out

    def border(self, q: np.ndarray, v: np.ndarray, a: np.ndarray):
        """Pinocchio's v and a, and the matrix G of v_pin = G v, which takes torques back: τ = Gᵀ τ_pin."""
        g, bias = np.eye(self.source.nv), np.zeros(self.source.nv)
        for j in np.flatnonzero(self.source.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
            d, start = self.source.jnt_dofadr[j], self.source.jnt_qposadr[j] + 3
            rotation = _pose(q[start : start + 4], np.zeros(3)).rotation
            g[d : d + 3, d : d + 3] = rotation.T
            bias[d : d + 3] = -np.cross(v[d + 3 : d + 6], rotation.T @ v[d : d + 3])
        return g @ v, g @ a + bias, g

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        v_pin, a_pin, g = self.border(q, v, a)
        return g.T @ pin.rnea(self.model, self.data, self.configuration(q), v_pin, a_pin)

    def regressor(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(nv, bodies, 10) in our order of π: Pinocchio's, from each joint's frame to the frames of its bodies."""
        v_pin, a_pin, g = self.border(q, v, a)
        args = (self.model, self.data, self.configuration(q), v_pin, a_pin)
        merged = (g.T @ pin.computeJointTorqueRegressor(*args)).reshape(len(v), -1, 10)
        ours = np.zeros_like(merged)
        ours[:, :, ORDER] = merged
        moved = [ours[:, joint - 1] @ _move_pi(pose) for joint, pose in self.frames]
        return np.stack(moved, axis=1)

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        _, _, g = self.border(q, np.zeros(self.source.nv), np.zeros(self.source.nv))
        upper = np.triu(pin.crba(self.model, self.data, self.configuration(q)))
        return g.T @ (upper + np.triu(upper, 1).T) @ g


def _move_pi(pose: pin.SE3) -> np.ndarray:
    """Matrix of π ↦ π seen from a frame in which the body's frame has this pose: P ↦ X P Xᵀ."""
    columns = []
    for unit in np.eye(10):
        m, h = unit[0], unit[1:4]
        i = unit[[4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(3, 3)
        p = np.block([[0.5 * np.trace(i) * np.eye(3) - i, h[:, None]], [h[None], np.array([[m]])]])
        p = pose.homogeneous @ p @ pose.homogeneous.T
        i = np.trace(p[:3, :3]) * np.eye(3) - p[:3, :3]
        columns.append([p[3, 3], *p[:3, 3], *i[np.triu_indices(3)]])
    return np.array(columns).T


def _pose(quat: np.ndarray, position: np.ndarray) -> pin.SE3:
    w, x, y, z = quat / np.linalg.norm(quat)
    return pin.SE3(pin.Quaternion(w, x, y, z).matrix(), np.array(position, float))
