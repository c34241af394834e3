"""Controllers: they know the nominal robot and noisy signals, nothing else."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from world.describe import Machine, to_pinocchio
from world.motions import rotation


class Follow:
    """Follows joint references: computed torque, or stiff loops over gravity and friction (`simple`)."""

    def __init__(self, machine: Machine, omega: float, simple: bool, motion, start: float):
        self.machine, self.simple, self.motion, self.begin = machine, simple, motion, start
        self.model, _ = to_pinocchio(machine)
        self.data = self.model.createData()
        self.n = len(machine.joints)
        self.damping, self.friction = machine.array("damping"), machine.array("friction")
        q = self._full(0.5 * (machine.lower + machine.upper), None)
        inertia = pin.crba(self.model, self.data, q)
        own = np.diag(inertia)[-self.n :]
        self.kp, self.kd = omega**2, 2.0 * omega
        self.stiff, self.loss = own * omega**2, own * 1.6 * omega

    def start(self):
        q = self.motion(self.begin)[0]
        if not self.machine.floating:
            return None, q
        return np.array([0, 0, self.machine.height, 1.0, 0, 0, 0]), q

    def _full(self, q: np.ndarray, base: np.ndarray | None) -> np.ndarray:
        if not self.machine.floating:
            return q
        if base is None:
            return np.concatenate([[0, 0, 0, 0, 0, 0, 1.0], q])
        return np.concatenate([base[:3], base[4:7], base[3:4], q])

    def __call__(self, t, q, v, base, motion):
        want, speed, accel = motion(t)
        full = self._full(q, base)
        if self.machine.floating:
            still = np.zeros(self.model.nv)
            tau = pin.rnea(self.model, self.data, full, still, still)[-self.n :].copy()
            tau += self.stiff * (want - q) + self.loss * (speed - v)
        elif self.simple:
            tau = pin.computeGeneralizedGravity(self.model, self.data, q).copy()
            tau += self.stiff * (want - q) + self.loss * (speed - v)
        else:
            a = accel + self.kd * (speed - v) + self.kp * (want - q)
            tau = pin.rnea(self.model, self.data, q, v, a) + self.damping * speed
        tau += 0.8 * self.friction * np.tanh(speed / 0.05)
        return np.clip(tau, -self.machine.peak, self.machine.peak), want


class Stand:
    """A dog: loops around the legs' angles, and the trunk's weight and accelerations shared among the feet."""

    def __init__(self, machine: Machine, motion, start: float):
        self.machine, self.motion, self.begin = machine, motion, start
        self.model, seats = to_pinocchio(machine)
        self.data = self.model.createData()
        self.feet = [seats[machine.index(f)] for f in machine.feet]
        self.frames = []
        for name, (joint, at) in zip(machine.feet, self.feet, strict=True):
            frame = pin.Frame(name, joint, 0, pin.SE3(np.eye(3), at), pin.FrameType.OP_FRAME)
            self.frames.append(self.model.addFrame(frame))
        self.data = self.model.createData()
        self.mass = sum(link.mass for link in machine.links)

    def start(self):
        pose = self.motion.pose(self.begin)
        base = np.concatenate([pose[:3], [1, 0, 0, 0]])
        base[2] += -0.001
        return base, self.motion.angles(self.begin)

    def __call__(self, t, q, v, base, motion):
        model, data = self.model, self.data
        full = np.concatenate([base[:3], base[4:7], base[3:4], q])
        want, speed, _ = motion(t)
        h = 5e-3
        before, pose, after = motion.pose(t - h), motion.pose(t), motion.pose(t + h)
        move, accel = (after - before) / (2 * h), (after - 2 * pose + before) / h**2
        rot = pin.Quaternion(base[3], base[4], base[5], base[6]).toRotationMatrix()
        error = pin.log3(rotation(pose[3:]) @ rot.T)
        force = self.mass * (
            accel[:3] + 50.0 * (pose[:3] - base[:3]) + 9.0 * (move[:3] - base[7:10])
        )
        force[2] += 9.81 * self.mass
        moment = np.array([0.35, 0.5, 0.55]) * (
            130.0 * error + 14.0 * (move[3:] - rot @ base[10:13])
        )
        still = np.zeros(model.nv)
        tau = pin.rnea(model, data, full, still, still)[6:].copy()
        centre = pin.centerOfMass(model, data, full)
        pin.computeJointJacobians(model, data, full)
        grasp, jacobians = np.zeros((6, 12)), []
        for i, frame in enumerate(self.frames):
            pin.updateFramePlacement(model, data, frame)
            arm = data.oMf[frame].translation - centre
            grasp[:3, 3 * i : 3 * i + 3] = np.eye(3)
            grasp[3:, 3 * i : 3 * i + 3] = pin.skew(arm)
            jacobians.append(
                pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[:3]
            )
        share = np.repeat(motion.weights(t), 3) * np.tile([0.5, 0.5, 1.0], 4)
        scaled = grasp * share
        wrench = np.concatenate([force, moment])
        forces = scaled.T @ np.linalg.solve(scaled @ grasp.T + 1e-4 * np.eye(6), wrench)
        forces = forces.reshape(4, 3)
        forces[:, 2] = np.maximum(forces[:, 2], 0.0)
        flat = np.linalg.norm(forces[:, :2], axis=1) + 1e-9
        forces[:, :2] *= np.minimum(1.0, 0.55 * forces[:, 2] / flat)[:, None]
        for i, jacobian in enumerate(jacobians):
            tau[3 * i : 3 * i + 3] -= jacobian[:, 6 + 3 * i : 9 + 3 * i].T @ forces[i]
        tau += 45.0 * (want - q) + 1.3 * (speed - v)
        return np.clip(tau, -self.machine.peak, self.machine.peak), want
