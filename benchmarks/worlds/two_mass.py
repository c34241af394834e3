"""Two-mass joints: a motor with its own inertia, coupled to the link by a spring or a dead zone.

The nominal armature, damping and friction loss move from the link to the motor, where they belong;
the encoder sits on the motor. The motor is a state of the effect, integrated with the plant's own
stages.
"""

from __future__ import annotations

import math

from benchmarks.worlds.effects import Effect
from benchmarks.worlds.friction import Bristle, reflected_inertia


class TwoMass(Effect):
    """Motor θ: J θ̈ = τ − d θ̇ − friction − transmitted; the link receives `transmitted`."""

    def edit(self, model):
        dof = int(model.joint(self.name).dofadr[0])
        self.inertia = float(model.dof_armature[dof])
        self.damping = float(model.dof_damping[dof])
        self.friction = float(model.dof_frictionloss[dof])
        model.dof_armature[dof] = model.dof_damping[dof] = model.dof_frictionloss[dof] = 0.0

    def bind(self, model, joints):
        super().bind(model, joints)
        link = reflected_inertia(model, self.dof)
        reduced = link * self.inertia / (link + self.inertia)
        stiffness = self.parameters["stiffness"]
        self.coupling_damping = 2.0 * self.damping_ratio * math.sqrt(stiffness * reduced)
        # 0.2 rad of the fastest oscillation a step; the reduced inertia varies with the pose.
        self.dt_max = 0.2 / math.sqrt(2.0 * stiffness / reduced)
        self.dt_max = min(self.dt_max, 2.5e-4)

    damping_ratio = 0.06
    rubbing = 0.0  # N m: friction that another effect finds at the motor's speed

    def reset(self, q, v):
        self.angle = self.angle0 = float(q[self.joint])
        self.speed = self.speed0 = float(v[self.joint])
        self.bristle = Bristle(self.friction, 2e-4, self.inertia) if self.friction > 0 else None
        if self.bristle:
            self.dt_max = min(self.dt_max, self.bristle.dt_max)

    def transmitted(self, gap: float, rate: float) -> float:
        return self.parameters["stiffness"] * gap + self.coupling_damping * rate

    def load(self, t, data, tau, out):
        drive = float(tau[self.joint])
        q, v = float(data.qpos[self.adr]), float(data.qvel[self.dof])
        torque = self.transmitted(self.angle - q, self.speed - v)
        out[self.dof] += torque - drive
        net = drive - torque - self.damping * self.speed - self.rubbing
        if self.bristle:
            net -= self.bristle.torque(self.speed, self.friction)
        self.rate_angle, self.rate_speed = self.speed, net / self.inertia

    def evolve(self, h):
        self.angle = self.angle0 + h * self.rate_angle
        self.speed = self.speed0 + h * self.rate_speed
        if self.bristle:
            self.bristle.evolve(h)

    def commit(self):
        self.angle0, self.speed0 = self.angle, self.speed
        if self.bristle:
            self.bristle.commit()

    def sense(self, q, v):
        q[self.joint], v[self.joint] = self.angle0, self.speed0


class JointElasticity(TwoMass):
    family, units = "joint_elasticity", {"stiffness": "N m/rad"}


class Backlash(TwoMass):
    """Teeth that touch at ±dead_zone/2: a stiff spring outside, nothing between, never pulling."""

    family = "backlash"
    units = {"dead_zone": "rad", "stiffness": "N m/rad"}  # noqa: RUF012
    damping_ratio = 0.25

    def transmitted(self, gap, rate):
        half = 0.5 * self.parameters["dead_zone"]
        if gap > half:
            return max(
                self.parameters["stiffness"] * (gap - half) + self.coupling_damping * rate, 0.0
            )
        if gap < -half:
            return min(
                self.parameters["stiffness"] * (gap + half) + self.coupling_damping * rate, 0.0
            )
        return 0.0
