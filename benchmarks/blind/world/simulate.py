"""A closed loop in continuous time: controller at the log's rate, physics in fine steps, sensors in between."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from world.describe import Machine, to_mjcf
from world.engines import ENGINES, Pull
from world.mechanics import Damping, KnownDry, Part, TwoMass

PREROLL, TAIL = 1.0, 0.04
STEP = {
    "mujoco": {"arm": 1e-3, "straps": 1e-3, "feet": 4e-4},
    "pinocchio": {"arm": 2e-3, "straps": 2e-3, "feet": 1e-3},
}
"""Longest steps (s); bristles, gears and two-mass joints ask for shorter ones. Steps a third as long move no joint of
an arm by more than 5e-6 rad over three seconds, a tenth of the encoder's noise (test_blind_world.py)."""
LOST = 0.45


class Unstable(RuntimeError):
    """The loop lost its motion: its owner would have stopped the robot."""


@dataclass
class Real:
    """A real robot: the true bodies, the nominal ones that its controller knows, and what is hidden in it.

    `presliding`: how far the known dry friction gives before it slides, rad.
    """

    nominal: Machine
    true: Machine
    parts: list[Part]
    engine: str
    presliding: float = 5e-4


def felt(machine: Machine, q: np.ndarray | None = None) -> np.ndarray:
    """What a torque on each joint feels (n), 1 / (M⁻¹)ⱼⱼ, the least of a few poses."""
    model = mujoco.MjModel.from_xml_string(to_mjcf(machine))
    data = mujoco.MjData(model)
    n, out = len(machine.joints), []
    rng = np.random.default_rng(0)
    for _ in range(8):
        data.qpos[model.nq - n :] = rng.uniform(machine.lower, machine.upper)
        mujoco.mj_forward(model, data)
        inverse = np.zeros((model.nv, model.nv))
        mujoco.mj_solveM(model, data, inverse, np.eye(model.nv))
        out.append(1.0 / np.diag(inverse)[model.nv - n :])
    return np.min(out, axis=0)


def straps(machine: Machine) -> list[Pull]:
    """Springs from the ceiling to points of the base; the load cell between them and the base sees them all."""
    weight = 9.81 * sum(link.mass for link in machine.links)
    points, top = np.array(machine.straps), 1.4
    count = len(points)
    stiffness = 9.0 * weight / count
    anchor = points + np.array([0.0, 0.0, machine.height + top])
    rest = top - weight / count / stiffness

    def law(t, place, velocity):
        line = anchor - place
        length = np.sqrt((line * line).sum(1))
        line /= length[:, None]
        pull = stiffness * (length - rest) - 0.04 * stiffness * (line * velocity).sum(1)
        # The straps' own friction calms the swing; the load cell feels that, too.
        return np.maximum(pull, 0.0)[:, None] * line - 0.012 * stiffness * velocity

    return [Pull((machine.links[0].name,) * count, points, law, measured=True)]


def run(real: Real, controller, motion, rate, duration, noise, rng) -> dict[str, np.ndarray]:
    """The clean log of one motion; `noise` is what the controller's sensors add, `noise.ripple` what the drive adds.

    Row k holds the sensors at k/rate and the command held from there to the next row; wrenches are means over the
    same interval. Raises `Unstable`.
    """
    machine = real.true
    for part in real.parts:
        machine = part.edit(machine)
    # What is left of friction after two-mass joints took theirs to the motor.
    parts = [*real.parts, Damping(machine.array("damping"))]
    if (friction := machine.array("friction")).any():
        parts.append(KnownDry(friction, real.presliding))
    pulls = [p for part in parts for p in part.pulls(machine)]
    if machine.straps:
        pulls += straps(real.true)
    bare = machine
    for k in range(len(machine.links)):
        bare = bare.edited(k, damping=0.0, friction=0.0)
    engine = ENGINES[real.engine](bare, pulls)
    inertia = felt(bare)
    for part in parts:
        part.bind(bare, inertia)
    base0, joints0 = controller.start()
    q, v = engine.start(base0, joints0)
    n = engine.n
    for part in parts:
        part.reset(q[-n:], v[-n:])
    kind = "feet" if machine.feet else "straps" if machine.straps else "arm"
    most = min([STEP[real.engine][kind], *(p.step_limit() for p in parts)])
    substeps = int(np.ceil(1.0 / rate / most - 1e-9))
    h = 1.0 / rate / substeps
    stepper = _Stepper(engine, parts, h)

    first, rows = -int(PREROLL * rate), round((duration + TAIL) * rate)
    heard = rng.normal(size=(2, rows - first, n)) * np.stack([noise.qpos, noise.qvel])[:, None]
    ripple = noise.draw(rng, rows - first, n) * noise.ripple
    log = {name: np.zeros((rows, n)) for name in ("qpos", "qvel", "tau", "qpos_target")}
    log["time"] = np.arange(rows) / rate
    if machine.floating:
        log["base"] = np.zeros((rows, 13))
        log["wrench"] = np.zeros((rows, len(machine.sensed), 6))
    for k in range(first, rows):
        t, at = k / rate, k - first
        seen, speed = q[-n:].copy(), v[-n:].copy()
        for part in parts:
            part.sense(t, seen, speed)
        base = engine.base(q, v) if machine.floating else None
        tau, aim = controller(t, seen + heard[0, at], speed + heard[1, at], base, motion)
        if k >= 0:
            log["qpos"][k], log["qvel"][k], log["tau"][k] = seen, speed, tau
            log["qpos_target"][k] = aim
            if machine.floating:
                log["base"][k] = base
        stepper.begin(felt=machine.floating and k >= 0)
        for i in range(substeps):
            q, v = stepper(t + i * h, q, v, tau + ripple[at])
        if stepper.felt:
            log["wrench"][k] = stepper.wrench / substeps
        if not np.abs(q[-n:] - aim).max() < LOST:
            raise Unstable(f"lost the motion at {t:.2f} s")
        if machine.feet and (base[2] < 0.16 or 1 - 2 * (base[4] ** 2 + base[5] ** 2) < 0.85):
            raise Unstable(f"fell at {t:.2f} s")
    for part in parts:
        part.record(log)
    return log


SIMPSON = (1 / 6, 2 / 6, 2 / 6, 1 / 6)


class _Stepper:
    """One step of the midpoint rule (MuJoCo) or of Runge and Kutta's fourth order (Pinocchio).

    `wrench` adds up what the sensors feel over the steps since `begin`, with the rule's own weights.
    """

    def __init__(self, engine, parts: list[Part], h: float):
        self.engine, self.h, self.n = engine, h, engine.n
        having = lambda name: [p for p in parts if getattr(type(p), name) != getattr(Part, name)]  # noqa: E731
        self.drives, self.loads, self.commits = having("drive"), having("load"), having("commit")
        self.motors = [p for p in parts if isinstance(p, TwoMass)]
        self.begin(felt=False)

    def begin(self, *, felt: bool) -> None:
        self.felt, self.wrench = felt, 0.0

    def _rate(self, t, q, v, q0, u, x, weight):
        for motor, stage in zip(self.motors, x, strict=True):
            motor.stage = stage
        tau = u.copy()
        joints, speeds = q[-self.n :], v[-self.n :]
        path = joints - q0
        for part in self.loads:
            part.load(t, joints, speeds, path, u, tau)
        a = self.engine.accelerate(t, q, v, tau)
        if weight and self.felt:
            self.wrench = self.wrench + weight * self.engine.wrenches()
        return a, [m.rate for m in self.motors]

    def __call__(self, t, q, v, u):
        h, move = self.h, self.engine.move
        u = u.copy()
        for part in self.drives:
            part.drive(t, h, u, v[-self.n :])
        q0 = q[-self.n :]
        x0 = [m.x for m in self.motors]
        # A force that jumps within a step is not what its last evaluation finds.
        first, second, third, last = (0, 1, 0, 0) if self.engine.order == 2 else SIMPSON
        a1, r1 = self._rate(t, q, v, q0, u, x0, first)
        half = [x + 0.5 * h * r for x, r in zip(x0, r1, strict=True)]
        v2 = v + 0.5 * h * a1
        a2, r2 = self._rate(t + 0.5 * h, move(q, v, 0.5 * h), v2, q0, u, half, second)
        if self.engine.order == 2:
            q1, v1 = move(q, v2, h), v + h * a2
            x1 = [x + h * r for x, r in zip(x0, r2, strict=True)]
        else:
            half = [x + 0.5 * h * r for x, r in zip(x0, r2, strict=True)]
            v3 = v + 0.5 * h * a2
            a3, r3 = self._rate(t + 0.5 * h, move(q, v2, 0.5 * h), v3, q0, u, half, third)
            full = [x + h * r for x, r in zip(x0, r3, strict=True)]
            v4 = v + h * a3
            a4, r4 = self._rate(t + h, move(q, v3, h), v4, q0, u, full, last)
            q1 = move(q, (v + 2.0 * (v2 + v3) + v4) / 6.0, h)
            v1 = v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
            x1 = [
                x + h / 6.0 * (b1 + 2.0 * (b2 + b3) + b4)
                for x, b1, b2, b3, b4 in zip(x0, r1, r2, r3, r4, strict=True)
            ]
        for motor, x in zip(self.motors, x1, strict=True):
            motor.x = x
        path = q1[-self.n :] - q0
        for part in self.commits:
            part.commit(path, v1[-self.n :], u)
        self.engine.commit()
        return q1, v1
