"""Where a gap lies, joints and time apart: at which speeds, positions and torques, and on which body a force would."""

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.result import BodyForce, Region

WINDOW, LEAST_ROWS = 0.5, 12
"""Over how long a force is taken for constant [s], and how many numbers of a window tell one."""
PARTS = 5
"""Quantiles of a signal over the log."""


def states(residual: Residual) -> dict[str, Float[np.ndarray, "R n"]]:
    """Position, velocity and logged torque of each row: q, v, tau."""
    context, finish = residual.context, residual.prepared.finish
    return {
        "q": finish(context.joint_position),
        "v": finish(context.v),
        "tau": finish(context.tau),
    }


def regions(residual: Residual) -> tuple[Region, ...]:
    """The energy of the row with the largest gap above its sensors' noise against its own q, v and τ, by quintiles."""
    z = residual.y / np.maximum(residual.sensors, 1e-12)
    excess = residual.weight * np.maximum(z**2 - 1.0, 0.0)
    most = int(np.argmax(excess.sum(axis=0)))
    out = []
    for signal, values in states(residual).items():
        x = values[:, most]
        edges = np.quantile(x, np.linspace(0.0, 1.0, PARTS + 1))
        place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, PARTS - 1)
        energy = np.bincount(place, weights=excess[:, most], minlength=PARTS)
        share = energy / max(float(energy.sum()), 1e-300)
        out.append(Region(residual.context.row_names[most], signal, edges, share))
    return tuple(out)


def body_forces(residual: Residual) -> tuple[BodyForce, ...]:
    """The residual projected back to each body as a force at its centre of mass, the most telling body first.

    Least squares of y/σ over each window by Jᵀ f/σ, f constant there and along the world's axes; of its energy, three
    units of noise a window are chance. Along what hardly turns a joint in its window a force may have any size: there
    it stays small compared with the robot's weight.
    """
    context, sensors = residual.context, np.maximum(residual.sensors, 1e-12)
    weigh = np.sqrt(residual.weight) / sensors
    y, time = weigh * residual.y, residual.time
    weight = float(context.pi[:, 0].sum() * np.linalg.norm(np.asarray(context.robot.gravity)))
    weak = np.eye(3) / max(weight, 1.0) ** 2
    label = ((time - time[0]) / WINDOW).astype(int)
    excess = max(float(np.sum(y**2) - residual.weight.sum()), 1e-300)
    out = []
    for index, body in enumerate(context.robot.body_names):
        rows = residual.prepared.finish_torque(context.force_rows[:, index]) * weigh[:, :, None]
        explained, peak, count = 0.0, 0.0, 0
        for k in range(label[-1] + 1):
            a, b = rows[label == k].reshape(-1, 3), y[label == k].ravel()
            if len(b) < LEAST_ROWS:
                continue
            force = np.linalg.solve(a.T @ a + weak, a.T @ b)
            explained += float(b @ b - np.sum((b - a @ force) ** 2))
            peak, count = max(peak, float(np.linalg.norm(force))), count + 1
        share = (explained - 3 * count) / excess
        out.append(BodyForce(body, float(np.clip(share, 0.0, 1.0)), peak))
    return tuple(sorted(out, key=lambda f: -f.share))
