"""Hidden effects: the interface, and those that act on the actuator, the sensors and the bodies.

The plant calls an effect at up to seven places; an effect overrides those it needs:

- `edit(model)`: changes the plant's model once, before the run (payload, armature, gravity ...);
- `bind(model)`: looks up indices; `reset(...)`: clears the state before each run;
- `actuate(t, dt, u)`: in place, the torque the drive really gives over one integration step;
- `load(t, data, tau, out)`: adds generalised force to `out` (nv) at a stage of the integrator;
- `evolve(h)`: moves the effect's own state from the step's start by `h`; `commit()` accepts it;
- `sense(q, v)`: in place, what the joint encoders report;
- `record(log)`: changes what the finished log holds (a clock).
"""

from __future__ import annotations

import mujoco
import numpy as np

Parameters = dict[str, float | list[float]]


class Effect:
    """One hidden effect: its family, its place (kind and name) and its parameters with units."""

    family = ""
    units: dict[str, str] = {}  # noqa: RUF012

    def __init__(self, kind: str, name: str, parameters: Parameters):
        self.kind, self.name, self.parameters = kind, name, parameters
        self.joint = self.dof = self.adr = self.body = -1

    def bind(self, model: mujoco.MjModel, joints: tuple[str, ...]) -> None:
        self.dt_max = np.inf
        if self.kind == "joint":
            self.joint = joints.index(self.name)
            self.dof = int(model.joint(self.name).dofadr[0])
            self.adr = int(model.joint(self.name).qposadr[0])
        elif self.kind == "body":
            self.body = int(model.body(self.name).id)

    def edit(self, model: mujoco.MjModel) -> None: ...

    def reset(self, q: np.ndarray, v: np.ndarray) -> None: ...

    def actuate(self, t: float, dt: float, u: np.ndarray) -> None: ...

    def load(self, t: float, data: mujoco.MjData, tau: np.ndarray, out: np.ndarray) -> None: ...

    def evolve(self, h: float) -> None: ...

    def commit(self) -> None: ...

    def sense(self, q: np.ndarray, v: np.ndarray) -> None: ...

    def record(self, log: dict[str, np.ndarray]) -> None: ...

    def truth(self) -> dict:
        return {
            "family": self.family,
            "location": {"kind": self.kind, "name": self.name},
            "parameters": {
                key: {"value": value, "unit": self.units.get(key, "1")}
                for key, value in self.parameters.items()
            },
        }


def rotation_from_tilt(tilt_x: float, tilt_y: float) -> np.ndarray:
    """Rotation by the vector (tilt_x, tilt_y, 0) rad in the world frame, shape (3, 3)."""
    angle = float(np.hypot(tilt_x, tilt_y))
    if angle == 0.0:
        return np.eye(3)
    x, y = tilt_x / angle, tilt_y / angle
    skew = np.array([[0, 0, y], [0, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew


def editable(model: mujoco.MjModel) -> mujoco.MjModel:
    """The model, whose centres and axes of inertia may be edited.

    Where a compiled body's inertia has its own axes MuJoCo takes the body's and never looks at `body_iquat` (or, with
    its centre, at `body_ipos`) again.
    """
    model.body_sameframe[:] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    return model


def add_mass(model: mujoco.MjModel, body: int, mass: float, com, inertia: np.ndarray) -> None:
    """Welds a rigid piece (inertia (3, 3) about its own centre, body axes) onto a body."""
    rot = np.zeros(9)
    mujoco.mju_quat2Mat(rot, model.body_iquat[body])
    rot = rot.reshape(3, 3)
    m0, c0 = model.body_mass[body], model.body_ipos[body].copy()
    total = m0 + mass
    centre = (m0 * c0 + mass * np.asarray(com)) / total

    def steiner(m, c):
        r = np.asarray(c) - centre
        return m * (r @ r * np.eye(3) - np.outer(r, r))

    tensor = rot @ np.diag(model.body_inertia[body]) @ rot.T + steiner(m0, c0)
    tensor = tensor + inertia + steiner(mass, com)
    values, axes = np.linalg.eigh(tensor)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, axes.flatten())
    model.body_mass[body], model.body_ipos[body] = total, centre
    model.body_inertia[body], model.body_iquat[body] = values, quat


# -- the drive ---------------------------------------------------------------------------------


class TorqueGain(Effect):
    family, units = "torque_gain", {"gain": "1"}

    def actuate(self, t, dt, u):
        u[self.joint] *= self.parameters["gain"]


class TorqueSaturation(Effect):
    family, units = "torque_saturation", {"limit": "N m"}

    def actuate(self, t, dt, u):
        limit = self.parameters["limit"]
        u[self.joint] = min(max(u[self.joint], -limit), limit)


class _Selected(Effect):
    """An effect of one joint's drive, or of every drive where the place is global."""

    def bind(self, model, joints):
        super().bind(model, joints)
        self.which = slice(None) if self.kind == "global" else slice(self.joint, self.joint + 1)


class TimeDelay(_Selected):
    """Torque acts `delay` later: a buffer on the integration grid, interpolated between cells.

    The commanded torque is piecewise constant, so the mean over a step of the delayed torque is
    exactly the interpolation of two cells, whatever the delay.
    """

    family, units = "time_delay", {"delay": "s"}

    def reset(self, q, v):
        self.cells = None

    def actuate(self, t, dt, u):
        new = u[self.which]
        if self.cells is None:
            whole = self.parameters["delay"] / dt
            self.shift, self.fraction = int(whole), whole - int(whole)
            self.size = self.shift + 2
            self.cells = np.tile(new, (self.size, 1))
            self.at = 0
        self.at = (self.at + 1) % self.size
        self.cells[self.at] = new
        near, far = self.cells[self.at - self.shift], self.cells[self.at - self.shift - 1]
        u[self.which] = (1.0 - self.fraction) * near + self.fraction * far


class ActuatorLag(_Selected):
    """First-order lag; the step's mean of the exact response to a held input."""

    family, units = "actuator_lag", {"time_constant": "s"}

    def reset(self, q, v):
        self.state = None

    def actuate(self, t, dt, u):
        new = u[self.which].copy()
        if self.state is None:
            self.state = new
            x = dt / self.parameters["time_constant"]
            self.decay, self.mean = np.exp(-x), (1.0 - np.exp(-x)) / x
        u[self.which] = new + (self.state - new) * self.mean
        self.state = new + (self.state - new) * self.decay


# -- the encoders ------------------------------------------------------------------------------


class EncoderOffset(Effect):
    family, units = "encoder_offset", {"offset": "rad"}

    def sense(self, q, v):
        q[self.joint] += self.parameters["offset"]


# -- bodies and the world ----------------------------------------------------------------------


class GravityTilt(Effect):
    """Gravity turned by the rotation vector `tilt` (about world x and y)."""

    family, units = "gravity_tilt", {"tilt": "rad", "gravity": "m/s^2"}

    def edit(self, model):
        model.opt.gravity[:] = rotation_from_tilt(*self.parameters["tilt"]) @ model.opt.gravity
        self.parameters["gravity"] = [float(g) for g in model.opt.gravity]


class Payload(Effect):
    """A compact piece of mass m at `com` (body frame): a box of equal sides `size`."""

    family = "payload"
    units = {"mass": "kg", "com": "m", "size": "m"}  # noqa: RUF012

    def edit(self, model):
        p = self.parameters
        inertia = p["mass"] * p["size"] ** 2 / 6.0 * np.eye(3)
        add_mass(model, int(model.body(self.name).id), p["mass"], p["com"], inertia)


class ComShift(Effect):
    family, units = "com_shift", {"com_shift": "m"}

    def edit(self, model):
        model.body_ipos[int(model.body(self.name).id)] += self.parameters["com_shift"]


class ConstantForce(Effect):
    """A world-fixed force at the body's centre of mass."""

    family, units = "constant_force", {"force": "N"}

    def load(self, t, data, tau, out):
        data.xfrc_applied[self.body, :3] += self.parameters["force"]


class Push(Effect):
    """A world-fixed force at the centre of mass, `start` to `end`, with raised-cosine flanks."""

    family, units = "push", {"force": "N", "start": "s", "end": "s"}

    def load(self, t, data, tau, out):
        start, end = self.parameters["start"], self.parameters["end"]
        if start < t < end:
            flank = 0.3 * (end - start)
            near = min(t - start, end - t, flank) / flank
            level = 0.5 - 0.5 * np.cos(np.pi * near)
            data.xfrc_applied[self.body, :3] += level * np.asarray(self.parameters["force"])
