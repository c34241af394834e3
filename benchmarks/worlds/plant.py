"""The real robot: MuJoCo's forward dynamics under our own integrator, hidden effects inside.

MuJoCo's Euler step is semi-implicit: its first-order error looks like drag or a delay. We integrate
by the explicit midpoint rule (second order) on a grid of 0.25 ms, finer where an effect is stiff,
and call `mj_forward` for the accelerations. Stiff inner states (bristles) advance by their exact
solution.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.worlds.effects import Effect
from benchmarks.worlds.robots import Robot

PREROLL, TAIL = 1.4, 0.05
LOST = 0.4  # rad: a loop that strays further from its aim would be stopped by its owner


@dataclass
class Noise:
    """Standard deviations (SI units). `ripple` is torque the drive adds without reporting it."""

    qpos: np.ndarray
    qvel: np.ndarray
    tau: np.ndarray
    ripple: np.ndarray
    base: np.ndarray  # 12: position, rotation, linear and angular velocity
    wrench: np.ndarray  # 6

    @staticmethod
    def none(n: int) -> Noise:
        z = np.zeros(n)
        return Noise(z, z, z, z, np.zeros(12), np.zeros(6))


class Unstable(RuntimeError):
    """The closed loop lost the motion; the caller draws another effect or a softer loop."""


class Plant:
    """A robot with hidden effects. `model` is edited: pass a copy."""

    finest = 2.5e-4  # s: the step where no effect asks for a shorter one
    stretch = 1.0
    """What effects ask for, of the midpoint rule, times this."""

    def __init__(self, robot: Robot, model: mujoco.MjModel, effects: list[Effect]):
        self.robot, self.effects = robot, effects
        for effect in effects:
            effect.edit(model)
        data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        for effect in effects:
            effect.bind(model, robot.joints)
        self.model, self.data = model, data
        self.q, self.v, self.a, self.out = data.qpos, data.qvel, data.qacc, data.qfrc_applied
        self.dofs = slice(6, model.nv) if robot.floating else slice(0, model.nv)
        self.feet = [model.body(f).id for f in robot.feet]

        def having(name: str):
            return [
                getattr(e, name) for e in effects if getattr(type(e), name) != getattr(Effect, name)
            ]

        self.actuate, self.load, self.sense = having("actuate"), having("load"), having("sense")
        self.evolve, self.commit, self.record = having("evolve"), having("commit"), having("record")
        self.pushes = any(e.kind == "body" for e in effects)

    def _start(self, q: np.ndarray, v: np.ndarray) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = q, v

    def _accelerate(self, t: float, tau: np.ndarray) -> None:
        out = self.out
        if self.robot.feet:
            out[:6] = 0.0
        out[self.dofs] = tau
        if self.pushes:
            self.data.xfrc_applied[:] = 0.0
        for load in self.load:
            load(t, self.data, tau, out)
        mujoco.mj_forward(self.model, self.data)

    def _move(self, q0: np.ndarray, v: np.ndarray, h: float) -> None:
        if self.robot.feet:
            self.q[:] = q0
            mujoco.mj_integratePos(self.model, self.q, v, h)
        else:
            np.add(q0, h * v, out=self.q)

    def _step(self, t: float, dt: float, tau: np.ndarray) -> None:
        q, v, a = self.q, self.v, self.a
        q0, v0 = q.copy(), v.copy()
        self._accelerate(t, tau)
        self._move(q0, v0, 0.5 * dt)
        np.add(v0, 0.5 * dt * a, out=v)
        for evolve in self.evolve:
            evolve(0.5 * dt)
        self._accelerate(t + 0.5 * dt, tau)
        self._move(q0, v, dt)
        np.add(v0, dt * a, out=v)
        for evolve in self.evolve:
            evolve(dt)
        for commit in self.commit:
            commit()

    def _wrenches(self) -> np.ndarray:
        """Contact wrenches on the feet at the last stage: world axes, about the feet's origins."""
        data = self.data
        mujoco.mj_rnePostConstraint(self.model, data)
        spatial = data.cfrc_ext[self.feet]  # torque, force about the tree's centre of mass
        arm = data.xpos[self.feet] - data.subtree_com[1]
        force, (x, y, z) = spatial[:, 3:], arm.T
        fx, fy, fz = force.T
        out = np.empty((len(self.feet), 6))
        out[:, :3] = force
        out[:, 3:] = spatial[:, :3]
        out[:, 3] -= y * fz - z * fy
        out[:, 4] -= z * fx - x * fz
        out[:, 5] -= x * fy - y * fx
        return out

    def run(self, controller, motion, start, rate, duration, noise: Noise, rng, preroll=PREROLL):
        """Runs the motion; returns the clean log, under `noise` what the sensors add to it, and the drive's `ripple`.

        Row k holds the sensors at time k / rate and the torque command held from there to the next
        row; contact wrenches are means over that same interval.
        """
        data, n, floating = self.data, len(self.robot.joints), self.robot.floating
        self._start(*start)
        joint_q = data.qpos[7:] if floating else data.qpos
        joint_v = data.qvel[self.dofs]
        for effect in self.effects:
            effect.reset(joint_q, joint_v)
        dt = min([self.finest] + [self.stretch * e.dt_max for e in self.effects])
        substeps = int(np.ceil(1.0 / rate / dt - 1e-9))
        dt = 1.0 / rate / substeps
        first = -int(preroll * rate)
        rows = round((duration + TAIL) * rate)
        draws = {
            "qpos": rng.normal(size=(rows - first, n)) * noise.qpos,
            "qvel": rng.normal(size=(rows - first, n)) * noise.qvel,
            "tau": rng.normal(size=(rows - first, n)) * noise.tau,
        }
        ripple = rng.normal(size=(rows - first, n)) * noise.ripple
        base_noise = rng.normal(size=(rows - first, 12)) * noise.base if floating else None
        log = {name: np.zeros((rows, n)) for name in ("qpos", "qvel", "tau", "qpos_target")}
        log["time"] = np.arange(rows) / rate
        if floating:
            log["base"] = np.zeros((rows, 13))
            log["contact_wrench"] = np.zeros((rows, len(self.feet), 6))
            log["contact_bodies"] = np.array(self.robot.feet)
            draws["base"] = base_noise[-first:]
            draws["wrench"] = rng.normal(size=(rows, len(self.feet), 6)) * noise.wrench

        for k in range(first, rows):
            t, at = k / rate, k - first
            q, v, base = joint_q.copy(), joint_v.copy(), None
            for sense in self.sense:
                sense(q, v)
            target = motion(t)
            if floating:
                clean = np.concatenate([data.qpos[:7], data.qvel[:6]])
                base = disturb_base(clean, base_noise[at])
            tau, aim = controller(k, t, q + draws["qpos"][at], v + draws["qvel"][at], base, target)
            if k >= 0:
                log["qpos"][k], log["qvel"][k], log["tau"][k] = q, v, tau
                log["qpos_target"][k] = aim
                if floating:
                    log["base"][k] = clean
            real = tau + ripple[at]
            wrench = 0.0
            for i in range(substeps):
                now = t + i * dt
                if self.actuate:
                    applied = real.copy()
                    for actuate in self.actuate:
                        actuate(now, dt, applied)
                else:
                    applied = real
                self._step(now, dt, applied)
                if floating and k >= 0:
                    wrench = wrench + self._wrenches()
            if floating and k >= 0:
                log["contact_wrench"][k] = wrench / substeps
            self._check(t, aim)
        for record in self.record:
            record(log)
        log["noise"] = {name: x[-rows:] for name, x in draws.items()}
        log["ripple"] = ripple[-rows:]
        return log

    def _check(self, t: float, aim: np.ndarray) -> None:
        data = self.data
        q = data.qpos[7:] if self.robot.floating else data.qpos
        if not np.abs(q - aim).max() < LOST:
            raise Unstable(f"lost the motion at {t:.2f} s")
        if self.robot.floating and (data.qpos[2] < 0.2 or data.xmat[1][8] < 0.85):
            raise Unstable(f"fell at {t:.2f} s")


def disturb_base(base: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Adds sensor noise (12: position, rotation vector, velocities) to a base state (13)."""
    out = base.copy()
    out[:3] += noise[:3]
    mujoco.mju_quatIntegrate(out[3:7], noise[3:6], 1.0)
    out[7:] += noise[6:]
    return out
