"""Two engines for the rigid bodies: MuJoCo's and Pinocchio's. Joint mechanics and forces are given to both.

Coordinates (q, v) are the engine's own; the joints are the last n of each. Forces act at points of bodies, in world
axes. Pinocchio has no contacts: the ones below are ours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby

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
    """Round point feet on a flat floor: Hunt and Crossley's normal force, dry friction through a spring that slides.

    f = k δ (1 + c δ̇), |f_t| ≤ μ f. Compliant and continuous, so that a fourth-order integrator keeps its order while
    a foot stands. Forces act at the balls' centres, which the law takes.
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


def _wrench_map(points: np.ndarray) -> np.ndarray:
    """(6, 3k): k forces as force and moment about the frame's origin; transposed, the points' velocities."""
    out = np.zeros((6, 3 * len(points)))
    for k, (x, y, z) in enumerate(points):
        out[:3, 3 * k : 3 * k + 3] = np.eye(3)
        out[3:, 3 * k : 3 * k + 3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    return out


class _Group:
    """Neighbouring points on one body; `seat` is the body's origin in the frame that the engine tells."""

    def __init__(self, body: int, cell: slice, points: np.ndarray, seat: np.ndarray):
        self.body, self.cell, self.points = body, cell, points + seat
        self.map, self.own = _wrench_map(self.points), _wrench_map(points)
        self.rot = np.eye(3)


class _Points:
    """All points of all pulls, body by body, and the wrench that the sensors feel."""

    def __init__(self, machine: Machine, pulls: list[Pull], seats: list[np.ndarray]):
        self.pulls, self.cells, self.groups, self.felt = pulls, [], [], []
        self.sensed = [machine.index(b) for b in machine.sensed]
        count = 0
        for pull in pulls:
            self.cells.append(slice(count, count + len(pull.bodies)))
            for body, some in groupby(range(len(pull.bodies)), lambda k, p=pull: p.bodies[k]):
                rows, which = list(some), machine.index(body)
                cell = slice(count + rows[0], count + rows[-1] + 1)
                group = _Group(which, cell, pull.points[rows], seats[which])
                self.groups.append(group)
                if pull.measured:
                    self.felt.append((self.sensed.index(which), group))
            count += len(pull.bodies)
        self.place, self.velocity, self.force = np.zeros((3, count, 3))

    def move(self, group: _Group, rot: np.ndarray, origin: np.ndarray, twist: np.ndarray) -> None:
        """Where a group is: its frame in the world, and that frame's velocity in its own axes (linear, angular)."""
        group.rot = rot
        self.place[group.cell] = origin + group.points @ rot.T
        self.velocity[group.cell] = (group.map.T @ twist).reshape(-1, 3) @ rot.T

    def pull(self, t: float) -> None:
        for pull, cell in zip(self.pulls, self.cells, strict=True):
            self.force[cell] = pull.law(t, self.place[cell], self.velocity[cell])

    def wrench(self, group: _Group) -> np.ndarray:
        """On the group's frame, in its own axes: force, moment about its origin (6)."""
        return group.map @ (self.force[group.cell] @ group.rot).ravel()

    def measured(self, out: np.ndarray) -> np.ndarray:
        for row, group in self.felt:
            local = group.own @ (self.force[group.cell] @ group.rot).ravel()
            out[row, :3] += group.rot @ local[:3]
            out[row, 3:] += group.rot @ local[3:]
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
        seats = [np.zeros(3)] * len(machine.links)
        self.machine, self.points = machine, _Points(machine, pulls, seats)
        self.nv, self.n = self.model.nv, len(machine.joints)
        if [self.model.body(k + 1).name for k in range(len(machine.links))] != [
            link.name for link in machine.links
        ]:
            raise ValueError(f"{machine.name}: links must be in depth-first order, as MuJoCo's are")
        self.sensed = [self.model.body(b).id for b in machine.sensed]
        self.twist = np.zeros(6)

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
        if self.points.groups:
            self._pull(t)
        mujoco.mj_forward(self.model, d)
        return d.qacc.copy()

    def _pull(self, t: float) -> None:
        m, d = self.model, self.data
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_comVel(m, d)
        twist = self.twist
        for group in self.points.groups:
            body = group.body + 1
            mujoco.mj_objectVelocity(m, d, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 1)
            local = np.concatenate([twist[3:], twist[:3]])
            self.points.move(group, d.xmat[body].reshape(3, 3).copy(), d.xpos[body], local)
        self.points.pull(t)
        d.xfrc_applied[:] = 0.0
        for group in self.points.groups:
            body, local = group.body + 1, self.points.wrench(group)
            force, moment = group.rot @ local[:3], group.rot @ local[3:]
            # MuJoCo takes it about the centre of mass.
            d.xfrc_applied[body, :3] += force
            d.xfrc_applied[body, 3:] += moment - _cross(d.xipos[body] - d.xpos[body], force)

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
        self.points = _Points(machine, pulls, [at for _, at in seats])
        self.joints = [seats[g.body][0] for g in self.points.groups]
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
        for group, joint in zip(self.points.groups, self.joints, strict=True):
            frame = self.data.oMi[joint]
            self.points.move(group, frame.rotation, frame.translation, self.data.v[joint].vector)
        self.points.pull(t)
        total: dict[int, np.ndarray] = {}
        for group, joint in zip(self.points.groups, self.joints, strict=True):
            wrench = self.points.wrench(group)
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
    """`np.cross` takes ten times as long on three numbers."""
    (x, y, z), (i, j, k) = a.tolist(), b.tolist()
    return np.array([y * k - z * j, z * i - x * k, x * j - y * i])


ENGINES = {"mujoco": MujocoEngine, "pinocchio": PinocchioEngine}
