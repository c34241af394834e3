"""What a fair reader may ask of a log: the nearest ordinary terms, what the log determines, how visible the odd is.

All from the clean log (neither the sensors' noise nor the drive's ripple), through one chain: 10 Hz zero-phase low-pass
on both sides.

- The friction that was really there is written as d v + F sign v by least squares over the moving rows: `damping` and
  `friction` of the truth. Another motion gives other numbers; both are stated.
- `sigma` of each term: posterior standard deviation of a linear fit of all terms of all joints beside the drawing's
  tolerances, under the sensors' noise and an error of form (below). A term with 1.96 sigma above 10 % of its size is
  not determined by this log.
- The odd effect's torque y is what real bodies, rotors, recorded friction and offsets leave. `chi2` weighs it with the
  noise of the sensors, `distinct` after all that the ordinary terms and the drawing's tolerances can absorb has been
  projected out, and `distinct_form` with the error of form in the variance as well: 3 % of the friction's rms at that
  joint, alike over a second. sqrt(distinct_form) is the effect's size in sigmas of what else is uncertain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from benchmarks.worlds.dynamics import inverse_dynamics, noise_floor
from benchmarks.worlds.hidden import TOLERANCE, Hidden
from benchmarks.worlds.plant import Noise
from benchmarks.worlds.robots import Robot

CUT, ROWS = 10.0, 50.0  # Hz
MOVING = 0.02  # rad/s
FORM, ALIKE = 0.03, 1.0  # share of the friction's rms; s
TERMS = (
    ("viscous_friction", "damping", "N m s/rad"),
    ("coulomb_friction", "friction", "N m"),
    ("armature", "armature", "kg m^2"),
    ("torque_bias", "bias", "N m"),
)


@dataclass
class Clean:
    """A clean log on ROWS Hz, low-passed; `dry` is F[tanh(v/0.003)], `missing` the torque of the odd effect."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    dry: np.ndarray
    friction: np.ndarray
    missing: np.ndarray
    moving: np.ndarray
    share: float
    """Independent samples a row."""


def clean(robot: Robot, hidden: Hidden, log: dict) -> Clean:
    dt = float(log["time"][1] - log["time"][0])
    rate = 1.0 / dt
    sos = butter(4, CUT, fs=rate, output="sos")
    smooth = lambda x: sosfiltfilt(sos, x, axis=0)  # noqa: E731
    held = log["tau"] + log["ripple"]  # what the drive gave: its ripple is noise, and no effect
    held[1:] = 0.5 * (held[1:] + held[:-1])  # row k's torque is held from there on
    model = hidden.model(robot, with_odd=False)
    model.dof_armature[:] = hidden.armature
    v = log["qvel"]
    a = np.gradient(v, dt, axis=0)
    # Of every row: accelerations answer the ripple, and every fourth of them would fold it into the band.
    rigid = smooth(inverse_dynamics(model, log["qpos"], v, a))
    thin = slice(round(0.5 * rate), len(v) - round(0.5 * rate), max(1, round(rate / ROWS)))
    friction = smooth(log["friction"])
    missing = smooth(held) + hidden.bias - rigid - friction
    return Clean(
        q=smooth(log["qpos"])[thin],
        v=smooth(v)[thin],
        a=smooth(a)[thin],
        dry=smooth(np.tanh(v / 0.003))[thin],
        friction=friction[thin],
        missing=missing[thin],
        moving=(np.abs(v) > MOVING)[thin],
        share=min(1.0, 2 * CUT / ROWS),
    )


def nearest(c: Clean) -> np.ndarray:
    """(n, 2): viscous and Coulomb friction nearest to the real law, moving rows."""
    out = []
    for j in range(c.v.shape[1]):
        rows = c.moving[:, j]
        columns = np.stack([c.v[rows, j], c.dry[rows, j]], 1)
        out.append(np.linalg.lstsq(columns, c.friction[rows, j], rcond=None)[0])
    return np.array(out)


def ordinary_columns(c: Clean) -> np.ndarray:
    """(T, n, 4 n): viscous, Coulomb, armature, offset of each joint; tau = ... − offset."""
    rows, n = c.v.shape
    out = np.zeros((rows, n, n, 4))
    for j in range(n):
        out[:, j, j] = np.stack([c.v[:, j], c.dry[:, j], c.a[:, j], -np.ones(rows)], 1)
    return out.reshape(rows, n, 4 * n)


def tolerance_columns(robot: Robot, c: Clean) -> np.ndarray:
    """(T, n, 5 B): inverse dynamics per sigma of each body's mass, centre (3) and inertia."""
    plain = inverse_dynamics(robot.model(), c.q, c.v, c.a)
    columns = []
    for name in robot.bodies:
        for what in range(5):
            model = robot.model()
            body = model.body(name).id
            if what == 0:
                model.body_mass[body] *= 1.0 + TOLERANCE["mass"]
                model.body_inertia[body] *= 1.0 + TOLERANCE["mass"]
            elif what == 4:
                model.body_inertia[body] *= 1.0 + TOLERANCE["inertia"]
            else:
                model.body_ipos[body, what - 1] += TOLERANCE["com"]
            columns.append(inverse_dynamics(model, c.q, c.v, c.a) - plain)
    return np.stack(columns, axis=-1)


def judge(robot: Robot, hidden: Hidden, log: dict, noise: Noise, rate: float) -> dict:
    """Nearest terms, their sigmas, the odd effect's visibility."""
    c = clean(robot, hidden, log)
    real = hidden.model(robot, with_odd=False)
    real.dof_armature[:] = hidden.armature
    floor = noise_floor(real, noise, rate, c.q[0])
    rubbing = np.sqrt((c.friction**2).mean(0))
    form = FORM * rubbing * np.sqrt(2 * CUT * ALIKE)
    weigh = lambda sigma: np.where(c.moving, np.sqrt(c.share) / sigma, 0.0)  # noqa: E731
    columns = np.concatenate([tolerance_columns(robot, c), ordinary_columns(c)], axis=2)
    count = columns.shape[2] - 4 * len(robot.joints)
    wide = np.repeat(hidden.scale, 4)
    prior = np.concatenate([np.ones(count), 1.0 / (10.0 * wide) ** 2])

    def project(weight):
        a = (columns * weight[:, :, None]).reshape(-1, columns.shape[2])
        y = (c.missing * weight).ravel()
        normal = a.T @ a + np.diag(prior)
        theta = np.linalg.solve(normal, a.T @ y)
        return float(y @ y), float(y @ y - (a.T @ y) @ theta), theta, normal

    chi2, distinct, _, _ = project(weigh(floor))
    _, distinct_form, theta, normal = project(weigh(np.hypot(floor, form)))
    left = np.where(c.moving, c.missing - columns @ theta, 0.0)
    count_moving = np.maximum(c.moving.sum(0), 1)
    sigma = np.sqrt(np.diag(np.linalg.inv(normal)))[count:].reshape(-1, 4)
    rms = lambda x: np.sqrt((np.where(c.moving, x, 0.0) ** 2).sum(0) / count_moving)  # noqa: E731
    named = lambda x: {j: float(y) for j, y in zip(robot.joints, x, strict=True)}  # noqa: E731
    return {
        "nearest": nearest(c),
        "sigma": sigma,
        "visibility": {
            "chi2": chi2,
            "distinct": distinct,
            "distinct_form": distinct_form,
            "sigmas": float(np.sqrt(max(distinct_form, 0.0))),
            "rms": named(rms(c.missing)),
            "rms_distinct": named(rms(left)),
            "noise": named(floor),
            "friction_rms": named(rubbing),
        },
    }


def joint_terms(robot: Robot, hidden: Hidden, log: dict, test: dict) -> dict:
    """`joints` of the truth: value, unit, sigma and what the other motion would say, of each term."""
    out = {}
    for j, name in enumerate(robot.joints):
        exact = (hidden.armature[j], hidden.bias[j])
        values = (*log["nearest"][j], *exact)
        others = (*test["nearest"][j], *exact)
        out[name] = {
            family: {
                "parameter": parameter,
                "value": float(value),
                "unit": unit,
                "sigma": float(sigma),
                "on_test_motion": float(other),
            }
            for (family, parameter, unit), value, other, sigma in zip(
                TERMS, values, others, log["sigma"][j], strict=True
            )
        }
    return out
