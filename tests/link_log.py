"""One link on a hinge that is told positions at 50 Hz: its model, its loop, its targets and its log."""

import numpy as np

from jax_inertia.logs.log import Log
from jax_inertia.replay.loop import Loop

KP, KD = 30.0, 0.8
LOOP = Loop(np.array([KP]), np.array([KD]), np.array([np.inf]), "log")
MODEL = """<mujoco><worldbody><body name="link"><joint name="hinge" axis="0 1 0"/>
<inertial pos="0 0 -0.15" mass="1" diaginertia="0.006 0.006 0.001"/></body></worldbody></mujoco>"""
COUNT = 2 * np.pi / 2**14


def targets(seconds: float) -> np.ndarray:
    """Two waves and steps [rad], one each 20 ms."""
    rng, at = np.random.default_rng(0), np.arange(0, seconds, 0.02)
    told = 0.5 * np.sin(2 * np.pi * 0.6 * at) + 0.3 * np.sin(2 * np.pi * 1.7 * at)
    return told + np.repeat(rng.normal(size=len(at) // 40 + 1) * 0.2, 40)[: len(at)]


def logged(time, q, told, tau, **more) -> Log:
    q, told, tau = (np.reshape(x, (-1, 1)) for x in (q, told, tau))
    gains = {"kp": LOOP.kp, "kd": LOOP.kd}
    return Log(
        time=time, joint_names=("hinge",), qpos=q, qpos_target=told, tau=tau, **gains, **more
    )
