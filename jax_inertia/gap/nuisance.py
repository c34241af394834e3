"""What is never exact and is no finding: the nominal model within its tolerance, and friction at rest.

Each nuisance is a column scaled to its prior standard deviation, integrated out with the prior *charged*:

    J = min over z of ‖y − N z − A θ‖² + ‖z‖²

Uncharged, the same columns would swallow payloads. Friction at rest is arbitrary within ± stiction, so a standing
joint's row gets hat functions of time; torque is logged within half a period of when it acted.
"""

import dataclasses

import numpy as np

from jax_inertia.gap.context import Context
from jax_inertia.gap.families.base import Columns
from jax_inertia.gap.families.joint import PRESLIDING, sign


@dataclasses.dataclass(frozen=True)
class Tolerance:
    """One standard deviation of what a nominal model may be off by, everywhere at once."""

    mass: float = 0.01
    """Relative."""
    com: float = 1e-3
    """m, along each axis."""
    inertia: float = 0.02
    """Relative, about the centre of mass."""
    damping: float = 0.05
    """Relative to the model's own damping, frictionloss and armature."""
    rest_friction: float = 0.05
    """Relative to the joint's peak torque."""
    period: float = 0.3
    """Of the log's period: when within it the torque acted."""


def columns(context: Context, tolerance: Tolerance, log_period: float) -> list[Columns]:
    """All nuisance columns on the fast grid, each times its prior standard deviation."""
    out = [Columns(-_bodies(context, tolerance))]
    robot, v = context.robot, context.v
    for row in context.joint_dofs.values():
        for own, shape in (
            (robot.damping, -v[:, row]),
            (robot.frictionloss, -sign(v[:, row])),
            (robot.armature, -context.a[:, row]),
        ):
            if float(own[row]) > 0:
                out.append(Columns(tolerance.damping * float(own[row]) * shape[:, None], row))
        # How soon the model's own dry friction turns over is not in the model: bristles turn late, MuJoCo's soft
        # constraint early, by about q̈ times its time constant.
        if (friction := float(robot.frictionloss[row])) > 0:
            late = [context.bristle(row, x) for x in PRESLIDING[1:]]
            early = [sign(v[:, row] + x * context.a[:, row]) for x in (0.004, 0.01, 0.02)]
            turned = [z - sign(v[:, row]) for z in (*late, *early)]
            out.append(Columns(friction * np.stack(turned, axis=1), row))
        hats = _rest_hats(context, row)
        if hats.shape[1]:
            out.append(Columns(tolerance.rest_friction * context.peak[row] * hats, row))
    slope = np.gradient(context.tau, context.time, axis=0)
    out.append(Columns((tolerance.period * log_period * slope)[:, :, None]))
    return out


def _bodies(context: Context, tolerance: Tolerance) -> np.ndarray:
    """Y ∂π for mass, centre of mass and inertia of every body, (T, nv, 5 nb)."""
    changes = []
    for i, pi in enumerate(np.asarray(context.robot.pi)):
        m, h = pi[0], pi[1:4]
        if m <= 0:
            continue
        c = h / m
        steiner = m * (c @ c * np.eye(3) - np.outer(c, c))
        central = pi[4:] - steiner[np.triu_indices(3)]
        changes.append((i, tolerance.mass * pi))
        changes.append((i, tolerance.inertia * np.concatenate([np.zeros(4), central])))
        for axis in np.eye(3):
            # The exact derivative, rotational part included: I about the origin moves with the centre of mass.
            turn = m * (2 * c @ axis * np.eye(3) - np.outer(c, axis) - np.outer(axis, c))
            change = np.concatenate([[0.0], m * axis, turn[np.triu_indices(3)]])
            changes.append((i, tolerance.com * change))
    blocks = [context.regressor[:, :, i, :] @ change for i, change in changes]
    return np.stack(blocks, axis=-1)


def _rest_hats(context: Context, row: int, spacing: float = 0.05) -> np.ndarray:
    """Hat functions of time, every `spacing` seconds, over the stretches where a joint stands still."""
    rest = context.at_rest[:, row]
    t = context.time
    centres = np.arange(0.0, t[-1] + spacing, spacing)
    near = np.interp(centres, t, rest * 1.0) > 0.3
    hats = np.clip(1 - np.abs(t[:, None] - centres[None, near]) / spacing, 0, None)
    return hats * rest[:, None]
