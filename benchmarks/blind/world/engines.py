"""Two engines for the rigid bodies: MuJoCo's and Pinocchio's. Joint mechanics and forces are given to both.

Coordinates (q, v) are the engine's own; the joints are the last n of each. Forces act at points of bodies, in world
axes. Pinocchio has no contacts: the ones below are ours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin

from world.describe import Machine, to_mjcf, to_pinocchio


@dataclass
class Pull:
    """Forces on points of bodies: `law(t, places, velocities)` gives them in world axes, all three (k, 3)."""

    bodies: tuple[str, ...]
    points: np.ndarray
    law: Callable[[float, np.ndarray, np.ndarray], np.ndarray]
    measured: bool = False
    """Whether the bodies' wrench sensors take part in it."""
    commit: Callable[[], None] | None = None


class Ground:
    """Balls on a flat floor: Hunt and Crossley's normal force, dry friction through a spring that slides.

    f = k δ (1 + c δ̇), |f_t| ≤ μ f. Compliant and continuous, so that a fourth-order integrator keeps its order while
    a foot stands. The law takes the balls' centres.
    """

    stiffness, loss, side, grip, damping = 2.5e4, 6.0, 1.5e4, 0.8, 40.0

    def __init__(self, radius: float, count: int):
        self.radius = radius
        self.anchor = np.full((count, 2), np.nan)
        self.next = self.anchor

    def __call__(self, t: float, place: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        depth = np.maximum(self.radius - place[:, 2], 0.0)
        normal = self.stiffness * depth * np.maximum(1.0 - self.loss * velocity[:, 2], 0.0)
        flat = place[:, :2]
        anchor = np.where(np.isnan(self.anchor), flat, self.anchor)
        spring = -self.side * (flat - anchor)
        most = self.grip * normal
        held = np.sqrt((spring * spring).sum(1)) + 1e-12
        spring *= np.minimum(1.0, most / held)[:, None]
        self.next = np.where((depth > 0.0)[:, None], flat + spring / self.side, np.nan)
        spring -= (self.damping * np.minimum(depth * 1e4, 1.0))[:, None] * velocity[:, :2]
        held = np.sqrt((spring * spring).sum(1)) + 1e-12
        out = np.empty_like(place)
        out[:, :2] = spring * np.minimum(1.0, most / held)[:, None]
        out[:, 2] = normal
        return out

    def commit(self) -> None:
        self.anchor = self.next


class _Points:
    """All points of all pulls, and the wrench that the sensors feel."""

    def __init__(self, machine: Machine, pulls: list[Pull]):
        self.pulls = pulls
        self.body = [machine.index(b) for p in pulls for b in p.bodies]
        self.point = np.concatenate([p.points for p in pulls]) if pulls else np.zeros((0, 3))
        cells = np.cumsum([0, *(len(p.bodies) for p in pulls)]).tolist()
        self.cells = [slice(a, b) for a, b in zip(cells[:-1], cells[1:], strict=True)]
        self.sensed = [machine.index(b) for b in machine.sensed]
        self.arm = self.force = np.zeros_like(self.point)

    def forces(self, t: float, arm: np.ndarray, place: np.ndarray, velocity: np.ndarray):
        """(k, 3) in world axes; `arm` from the bodies' origins."""
        out = np.empty_like(place)
        for pull, cell in zip(self.pulls, self.cells, strict=True):
            out[cell] = pull.law(t, place[cell], velocity[cell])
        self.arm, self.force = arm, out
        return out

    def measured(self, out: np.ndarray) -> np.ndarray:
        for pull, cell in zip(self.pulls, self.cells, strict=True):
            if pull.measured:
                for k in range(cell.start, cell.stop):
                    row = out[self.sensed.index(self.body[k])]
                    row[:3] += self.force[k]
                    row[3:] += _cross(self.arm[k], self.force[k])
        return out

    def commit(self) -> None:
        for pull in self.pulls:
            if pull.commit:
                pull.commit()


class MujocoEngine:
    """Accelerations by `mj_forward`; feet by MuJoCo's own contacts."""

    name, order = "mujoco", 2

    def __init__(self, machine: Machine, pulls: list[Pull]):
        self.model = mujoco.MjModel.from_xml_string(to_mjcf(machine, passive=False))
        self.data = mujoco.MjData(self.model)
        self.machine, self.points = machine, _Points(machine, pulls)
        self.nv, self.n = self.model.nv, len(machine.joints)
        if [self.model.body(k + 1).name for k in range(len(machine.links))] != [
            link.name for link in machine.links
        ]:
            raise ValueError(f"{machine.name}: links must be in depth-first order, as MuJoCo's are")
        self.bodies = [k + 1 for k in self.points.body]
        self.sensed = [self.model.body(b).id for b in machine.sensed]
        self.twist = np.zeros((len(self.bodies), 6))

    def start(self, base: np.ndarray | None, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """q and v at rest; `base` is (7) position and wxyz."""
        q = joints.copy() if base is None else np.concatenate([base, joints])
        return q, np.zeros(self.nv)

    def move(self, q: np.ndarray, v: np.ndarray, h: float) -> np.ndarray:
        if not self.machine.floating:
            return q + h * v
        out = q.copy()
        mujoco.mj_integratePos(self.model, out, v, h)
        return out

    def accelerate(self, t: float, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """v̇ (nv) under joint torques `tau` (n) and all pulls."""
        d = self.data
        d.qpos[:], d.qvel[:] = q, v
        d.qfrc_applied[self.nv - self.n :] = tau
        if self.bodies:
            self._pull(t)
        mujoco.mj_forward(self.model, d)
        return d.qacc.copy()

    def _pull(self, t: float) -> None:
        m, d = self.model, self.data
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_comVel(m, d)
        for row, body in zip(self.twist, self.bodies, strict=True):
            mujoco.mj_objectVelocity(m, d, mujoco.mjtObj.mjOBJ_XBODY, body, row, 0)
        rot = d.xmat[self.bodies].reshape(-1, 3, 3)
        arm = np.einsum("kij,kj->ki", rot, self.points.point)
        place = d.xpos[self.bodies] + arm
        velocity = self.twist[:, 3:] + _cross(self.twist[:, :3], arm)
        force = self.points.forces(t, arm, place, velocity)
        moment = _cross(place - d.xipos[self.bodies], force)
        d.xfrc_applied[:] = 0.0
        for k, body in enumerate(self.bodies):
            d.xfrc_applied[body, :3] += force[k]
            d.xfrc_applied[body, 3:] += moment[k]

    def wrenches(self) -> np.ndarray:
        """Measured wrenches (C, 6) of the last evaluation: world axes, about the bodies' origins."""
        d = self.data
        out = np.zeros((len(self.sensed), 6))
        if self.machine.feet:
            mujoco.mj_rnePostConstraint(self.model, d)
            for row, body in zip(out, self.sensed, strict=True):
                # cfrc_ext holds what pulls give, too; only contacts touch a foot.
                row[:3] = d.cfrc_ext[body, 3:]
                arm = d.xpos[body] - d.subtree_com[self.model.body_rootid[body]]
                row[3:] = d.cfrc_ext[body, :3] - _cross(arm, row[:3])
        return self.points.measured(out)

    def base(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Position, wxyz, linear velocity (world), angular velocity (body): (13)."""
        return np.concatenate([q[:7], v[:6]])

    def commit(self) -> None:
        self.points.commit()


class PinocchioEngine:
    """Accelerations by Pinocchio's articulated-body algorithm; feet by `Ground`."""

    name, order = "pinocchio", 4

    def __init__(self, machine: Machine, pulls: list[Pull]):
        self.model, seats = to_pinocchio(machine)
        self.data = self.model.createData()
        self.machine = machine
        self.nv, self.n = self.model.nv, len(machine.joints)
        pulls = list(pulls)
        if machine.feet:
            radius = machine.links[machine.index(machine.feet[0])].radius
            ground, count = Ground(radius, len(machine.feet)), len(machine.feet)
            centre = np.zeros((count, 3))
            pulls.append(Pull(machine.feet, centre, ground, measured=True, commit=ground.commit))
        self.points = _Points(machine, pulls)
        self.joints = [seats[k][0] for k in self.points.body]
        self.inside = self.points.point + np.array([seats[k][1] for k in self.points.body]).reshape(
            -1, 3
        )
        self.down = np.zeros_like(self.inside)
        if machine.feet:
            self.down[-len(machine.feet) :, 2] = -radius
        self.push = pin.StdVec_Force()
        for _ in range(self.model.njoints):
            self.push.append(pin.Force.Zero())

    def start(self, base: np.ndarray | None, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if base is None:
            return joints.copy(), np.zeros(self.nv)
        return np.concatenate([base[:3], base[4:7], base[3:4], joints]), np.zeros(self.nv)

    def move(self, q: np.ndarray, v: np.ndarray, h: float) -> np.ndarray:
        return pin.integrate(self.model, q, h * v) if self.machine.floating else q + h * v

    def accelerate(self, t: float, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
        if self.machine.floating:
            tau = np.concatenate([np.zeros(6), tau])
        if not self.joints:
            return pin.aba(self.model, self.data, q, v, tau).copy()
        self._pull(t, q, v)
        return pin.aba(self.model, self.data, q, v, tau, self.push).copy()

    def _pull(self, t: float, q: np.ndarray, v: np.ndarray) -> None:
        pin.forwardKinematics(self.model, self.data, q, v)
        frames = [self.data.oMi[j] for j in self.joints]
        speeds = np.array([self.data.v[j].vector for j in self.joints])
        rot = np.array([f.rotation for f in frames])
        origin = np.array([f.translation for f in frames])
        spin = np.einsum("kij,kj->ki", rot, speeds[:, 3:])
        arm = np.einsum("kij,kj->ki", rot, self.points.point)
        reach = np.einsum("kij,kj->ki", rot, self.inside)
        speed = np.einsum("kij,kj->ki", rot, speeds[:, :3]) + _cross(spin, reach)
        # A ball touches below its centre; only the force's moment and the slip need to know.
        touch = speed + _cross(spin, self.down)
        force = self.points.forces(t, arm + self.down, origin + reach, touch)
        moment = _cross(reach + self.down, force)
        local = np.empty((len(frames), 6))
        local[:, :3] = np.einsum("kji,kj->ki", rot, force)
        local[:, 3:] = np.einsum("kji,kj->ki", rot, moment)
        total: dict[int, np.ndarray] = {}
        for joint, wrench in zip(self.joints, local, strict=True):
            total[joint] = total[joint] + wrench if joint in total else wrench
        for joint, wrench in total.items():
            self.push[joint] = pin.Force(wrench)

    def wrenches(self) -> np.ndarray:
        return self.points.measured(np.zeros((len(self.points.sensed), 6)))

    def base(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        rot = pin.Quaternion(q[6], q[3], q[4], q[5]).toRotationMatrix()
        return np.concatenate([q[:3], q[6:7], q[3:6], rot @ v[:3], v[3:6]])

    def commit(self) -> None:
        self.points.commit()


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of rows of one shape; `np.cross` takes five times as long on a few rows."""
    out = np.empty(b.shape)
    out[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    out[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    out[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out


ENGINES = {"mujoco": MujocoEngine, "pinocchio": PinocchioEngine}
