"""A linear axis is a joint like any other: what slows it is told at its own speeds, a tenth of a hinge's in metres."""

import mujoco
import numpy as np
import pytest

import jax_inertia as ji
from jax_inertia.logs.log import Log

AXIS = """<mujoco><worldbody><body><joint name="rail" type="slide" axis="1 0 0"/>
<inertial mass="6" pos="0 0 0" diaginertia="0.02 0.02 0.02"/>
<body pos="0 0 0.1"><joint name="lift" type="slide" axis="0 0 1"/>
<inertial mass="2" pos="0.05 0 0" diaginertia="0.01 0.01 0.01"/></body></body></worldbody></mujoco>"""
MASS, DRIVE = np.array([8.0, 2.0]), np.array([3.0, 0.8])
"""What each axis moves [kg], and its drive's inertia [kg]."""
LEVEL, DAMPING = np.array([4.0, 2.0]), np.array([6.0, 3.0])


def log_of(seed: int, extra, seconds: float = 20.0) -> Log:
    """In closed form: m q̈ + weight + friction, up to 0.25 m/s; `extra` acts on the rail at its speed."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.004)
    q, v, a = np.zeros((3, len(t), 2))
    for f in (0.13, 0.31, 0.57, 0.83):
        size, phase, w = 0.03 * rng.uniform(0.5, 1.0, 2), rng.uniform(0, 6.28, 2), 2 * np.pi * f
        q += size * np.sin(w * t[:, None] + phase)
        v += size * w * np.cos(w * t[:, None] + phase)
        a -= size * w * w * np.sin(w * t[:, None] + phase)
    tau = (MASS + DRIVE) * a + [0.0, 2.0 * 9.81] + LEVEL * np.tanh(v / 1e-3) + DAMPING * v
    tau[:, 0] += extra(v[:, 0])
    return Log(
        time=t,
        qpos=q + 5e-6 * rng.normal(size=q.shape),
        qvel=None,
        tau=tau + 0.05 * rng.normal(size=q.shape),
        joint_names=("rail", "lift"),
        tau_kind="sensor",
    )


@pytest.mark.parametrize(
    ("family", "extra"),
    [
        ("quadratic_viscous", lambda v: 90.0 * v * np.abs(v)),
        ("stribeck_friction", lambda v: 3.0 * np.exp(-((v / 0.01) ** 2)) * np.tanh(v / 1e-3)),
    ],
)
@pytest.mark.slow
def test_what_slows_a_linear_axis_is_told(family, extra):
    robot = ji.load_model(mujoco.MjModel.from_xml_string(AXIS))
    found = ji.diagnose(robot, log_of(0, extra), test_log=log_of(1, extra, 12.0))
    report = ji.to_report(found)
    odd = [(e["family"], e["location"]["name"]) for e in report["effects"] if not e["ordinary"]]
    assert odd == [(family, "rail")]
    assert report["verdict"] == "explained"
    rotor = report["joints"]["rail"]["armature"]["value"]
    assert rotor == pytest.approx(DRIVE[0], abs=0.3)
