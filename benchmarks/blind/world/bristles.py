"""Dry friction with a memory: LuGre's bristle and Maxwell's slipping springs, advanced exactly along the path.

Both depend on the path travelled, not on time (LuGre's damping apart), so that the state after a displacement Δq has
a closed form and no stiff differential equation is left.
"""

from __future__ import annotations

import math

import numpy as np


class LuGre:
    """dz/dq = 1 − sign(q̇) σ₀ z / g and the torque σ₀ z + σ₁ ż (Canudas de Wit et al. 1995).

    `presliding` (rad) is g/σ₀ at `level`; sliding steadily the torque is g sign(q̇).
    """

    def __init__(self, level: float, presliding: float, inertia: float):
        self.stiffness = level / presliding
        self.loss = 0.6 * math.sqrt(self.stiffness * inertia)
        self.z = 0.0

    def _after(self, path: float, g: float) -> float:
        steady = math.copysign(g / self.stiffness, path)
        return steady + (self.z - steady) * math.exp(-abs(path) * self.stiffness / g)

    def torque(self, path: float, speed: float, g: float) -> float:
        """At `path` rad from the last commit, at this speed and level."""
        z = self._after(path, g) if path else self.z
        out = self.stiffness * z
        if abs(speed) < 0.06:
            # σ₁ fades with speed: LuGre stays passive and g alone is left when sliding.
            rate = speed - abs(speed) * self.stiffness / g * z
            out += self.loss * math.exp(-((speed / 0.015) ** 2)) * rate
        return out

    def commit(self, path: float, g: float) -> None:
        if path:
            self.z = self._after(path, g)


class Maxwell:
    """Slipping springs in parallel: each holds up to its share of the level, the weakest slips first."""

    shares = np.array([0.35, 0.3, 0.2, 0.15])
    travel = np.array([0.3, 1.0, 2.0, 3.5])

    def __init__(self, level: float, presliding: float, inertia: float):
        self.z = np.zeros(4)
        self.most = presliding * self.travel
        self.weight = self.shares / self.most
        self.stiffness = level * float(self.weight.sum())
        self.loss = 0.2 * math.sqrt(self.stiffness * inertia)

    def torque(self, path: float, speed: float, g: float) -> float:
        z = np.minimum(np.maximum(self.z + path, -self.most), self.most)
        out = g * float(self.weight @ z)
        if abs(speed) < 0.06:
            out += self.loss * math.exp(-((speed / 0.015) ** 2)) * speed
        return out

    def commit(self, path: float, g: float) -> None:
        self.z = np.minimum(np.maximum(self.z + path, -self.most), self.most)


BRISTLES = {"lugre": LuGre, "maxwell": Maxwell}
