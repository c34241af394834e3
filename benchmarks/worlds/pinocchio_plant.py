"""A second engine: the real robot by Pinocchio's articulated-body algorithm, its joints by slipping springs.

Pinocchio gives q̈ = M⁻¹ (τ − h), integrated here by Runge and Kutta's fourth order; states of effects take their middle
rate (second order). Dry friction is Maxwell's: four springs in parallel, each of which slips at its share of the level
g (Al-Bender, Lampaert, Swevers 2005). MuJoCo's forward dynamics and LuGre's bristle are the other engine's (`plant`,
`joint_physics`); drives, springs, loads and encoders (`effects`) act on both alike. Fixed bases, hinges and slides.
"""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import numpy as np
import pinocchio as pin

from benchmarks.worlds.effects import Effect
from benchmarks.worlds.joint_physics import JointCoupling, Ordinary
from benchmarks.worlds.plant import Plant
from benchmarks.worlds.robots import Robot


class Bodies:
    """Forward dynamics of a compiled MuJoCo model in Pinocchio, the coordinates being MuJoCo's.

    `coupling` (row of n, kg m²): a rotor that turns with several joints, M + armature · row rowᵀ.
    """

    def __init__(self, source: mujoco.MjModel, coupling: tuple[np.ndarray, float] | None = None):
        self.model = pin.Model()
        self.model.gravity.linear = source.opt.gravity
        self.zero, self.coupling = source.qpos0.copy(), coupling
        self.stiffness, self.rest = source.jnt_stiffness.copy(), source.qpos_spring.copy()
        if np.ndim(self.stiffness) > 1:
            # From MuJoCo 3.4 on a polynomial, of which robots have the first.
            self.stiffness = self.stiffness[:, 0]
        self.centres: list[tuple[int, int, np.ndarray]] = []
        """Of each body that moves: its number, its joint's, its centre of mass in the joint's frame."""
        carrier = {0: (0, pin.SE3.Identity())}
        for b in range(1, source.nbody):
            joint, pose = carrier[int(source.body_parentid[b])]
            pose = pose * _pose(source.body_quat[b], source.body_pos[b])
            for j in source.body_jntadr[b] + np.arange(source.body_jntnum[b]):
                joint, pose = self._joint(source, int(j), joint, pose)
            carrier[b] = (joint, pose)
            if joint:
                turned = _pose(source.body_iquat[b], np.zeros(3)).rotation
                about = turned @ np.diag(source.body_inertia[b]) @ turned.T
                inertia = pin.Inertia(float(source.body_mass[b]), source.body_ipos[b], about)
                self.model.appendBodyToJoint(joint, inertia, pose)
                self.centres.append((b, joint, pose.act(source.body_ipos[b])))
        self.model.armature = source.dof_armature
        self.data = self.model.createData()
        self.pushes = pin.StdVec_Force()
        for _ in range(self.model.njoints):
            self.pushes.append(pin.Force.Zero())

    def _joint(self, source: mujoco.MjModel, j: int, parent: int, pose: pin.SE3):
        kind, axis = mujoco.mjtJoint(source.jnt_type[j]), source.jnt_axis[j]
        anchor = pin.SE3(np.eye(3), source.jnt_pos[j])
        if kind == mujoco.mjtJoint.mjJNT_HINGE:
            added = pin.JointModelRevoluteUnaligned(axis)
        elif kind == mujoco.mjtJoint.mjJNT_SLIDE:
            added = pin.JointModelPrismaticUnaligned(axis)
        else:
            raise ValueError(f"joint {j}: expected hinges and slides on a fixed base")
        return self.model.addJoint(parent, added, pose * anchor, f"joint{j}"), anchor.inverse()

    def accelerate(self, q, v, tau, forces: np.ndarray | None = None) -> np.ndarray:
        """q̈ (n) under joint torques `tau` (n) and `forces` (bodies, 3) [N] in world axes at centres of mass."""
        at = q - self.zero
        tau = tau - self.stiffness * (q - self.rest)
        if forces is None or not forces.any():
            out = pin.aba(self.model, self.data, at, v, tau).copy()
        else:
            self._push(at, forces)
            out = pin.aba(self.model, self.data, at, v, tau, self.pushes).copy()
        if self.coupling is not None:
            row, rotor = self.coupling
            inverse = pin.computeMinverse(self.model, self.data, at)
            beyond = (np.triu(inverse) + np.triu(inverse, 1).T) @ row
            out -= beyond * (row @ out) / (1.0 / rotor + row @ beyond)
        return out

    def _push(self, at: np.ndarray, forces: np.ndarray) -> None:
        pin.forwardKinematics(self.model, self.data, at)
        total: dict[int, pin.Force] = {}
        for body, joint, centre in self.centres:
            if forces[body].any():
                local = self.data.oMi[joint].rotation.T @ forces[body]
                one = pin.Force(local, np.cross(centre, local))
                total[joint] = total[joint] + one if joint in total else one
        for joint in range(self.model.njoints):
            self.pushes[joint] = total.get(joint, pin.Force.Zero())


class Slips(Ordinary):
    """Ordinary physics with dry friction by slipping springs; stuck, they are as stiff as the bristle would be."""

    SHARES = np.array([0.35, 0.3, 0.2, 0.15])[:, None]
    TRAVEL = np.array([0.55, 1.35, 2.2, 3.8])[:, None]
    FADES = 0.02  # rad/s: the damping of springs that stick

    def bind(self, model, joints):
        super().bind(model, joints)
        self.most = self.presliding * self.TRAVEL

    def reset(self, q, v):
        super().reset(q, v)
        self.z0 = self.z = np.zeros((4, len(self.bias)))

    def _torque(self, q, w):
        law, g = self.odd, self._level(q, w)
        held = (self.SHARES * (1.0 - np.maximum(self.z * np.sign(w), 0.0) / self.most)).sum(0)
        size = np.abs(w)
        dry = g * (self.SHARES * self.z / self.most).sum(0)
        damping = self.sigma1 * np.exp(-((w / self.FADES) ** 2)) * np.minimum(held, 1.0) * w
        return dry + damping + law.viscous * size**law.exponent * np.sign(w)

    def evolve(self, h):
        self.z = np.clip(self.z0 + self.w * h, -self.most, self.most)


class PinocchioPlant(Plant):
    """`Plant` whose accelerations are Pinocchio's. `model` is edited: pass a copy."""

    finest, stretch = 1e-3, 2.0  # fourth order: 3e-5 rad and 1e-3 of the torque, below the sensors

    def __init__(self, robot: Robot, model: mujoco.MjModel, effects: list[Effect]):
        if robot.floating:
            raise ValueError(f"{robot.name}: a floating base; expected a fixed one")
        super().__init__(robot, model, effects)
        coupling = None
        for effect in effects:
            if isinstance(effect, JointCoupling):
                row = np.zeros(model.nv)
                row[effect.joint], row[effect.other] = 1.0, effect.ratio
                coupling = row, float(model.tendon_armature[0])
        self.bodies = Bodies(model, coupling)
        n = model.nv
        self.data = SimpleNamespace(
            qpos=np.zeros(n),
            qvel=np.zeros(n),
            qfrc_applied=np.zeros(n),
            xfrc_applied=np.zeros((model.nbody, 6)),
        )
        self.q, self.v, self.out = self.data.qpos, self.data.qvel, self.data.qfrc_applied

    def _start(self, q: np.ndarray, v: np.ndarray) -> None:
        self.q[:], self.v[:] = q, v

    def _rate(self, t: float, tau: np.ndarray) -> np.ndarray:
        """q̈ at the stage that `q` and `v` hold."""
        self.out[:] = tau
        forces = None
        if self.pushes:
            self.data.xfrc_applied[:] = 0.0
            forces = self.data.xfrc_applied[:, :3]
        for load in self.load:
            load(t, self.data, tau, self.out)
        return self.bodies.accelerate(self.q, self.v, self.out, forces)

    def _step(self, t: float, dt: float, tau: np.ndarray) -> None:
        q0, v0 = self.q.copy(), self.v.copy()
        speeds, rates = [], []
        for share in (0.0, 0.5, 0.5, 1.0):
            if share:
                self.q[:] = q0 + share * dt * speeds[-1]
                self.v[:] = v0 + share * dt * rates[-1]
                for evolve in self.evolve:
                    evolve(share * dt)
            speeds.append(self.v.copy())
            rates.append(self._rate(t + share * dt, tau))
        self.q[:] = q0 + dt / 6.0 * (speeds[0] + 2.0 * (speeds[1] + speeds[2]) + speeds[3])
        self.v[:] = v0 + dt / 6.0 * (rates[0] + 2.0 * (rates[1] + rates[2]) + rates[3])
        for commit in self.commit:
            commit()


def _pose(quat: np.ndarray, position: np.ndarray) -> pin.SE3:
    w, x, y, z = quat / np.linalg.norm(quat)
    return pin.SE3(pin.Quaternion(w, x, y, z).matrix(), np.array(position, float))
