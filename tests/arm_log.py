"""Logs of a small arm under PD control, by MuJoCo C, with torques and forces that its model lacks."""

import mujoco
import numpy as np

from jax_inertia.logs.log import Log, TorqueKind

ARM = """
<mujoco><option gravity="0 0 -9.81" timestep="0.0005" integrator="RK4"/>
<worldbody><body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.3" armature="0.05"/>
<inertial mass="2.0" pos="0 0 -0.2" fullinertia="0.02 0.02 0.004 0 0.001 0"/>
<body name="lower" pos="0 0 -0.4"><joint name="elbow" axis="0 1 0.3" damping="0.2" armature="0.03"/>
<inertial mass="1.2" pos="0.02 0 -0.15" fullinertia="0.01 0.01 0.002 0 0 0.0005"/></body></body></worldbody></mujoco>
"""

# Noise of the torques logged [N m].
TORQUE = np.array([0.03, 0.01])


def wave(t, seed, pace=1.0):
    """A smooth wide motion (position, velocity) of both joints."""
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(0.15, 0.9, (4, 2)), rng.uniform(0, 6.28, (4, 2))
    size = np.array([0.6, 0.9]) * 2 / (1 + 2 * frequency)
    frequency = pace * frequency
    angle = 2 * np.pi * frequency * t + phase
    q = np.sum(size * np.sin(angle), axis=0)
    return q, np.sum(size * 2 * np.pi * frequency * np.cos(angle), axis=0)


def nothing(t, q, v, u):
    return np.zeros(2)


def asked(target, speed, q, v):
    """Torque of the arm's PD loop [N m]."""
    return np.array([60.0, 40.0]) * (target - q) + np.array([6.0, 3.0]) * (speed - v)


def logged(rows, encoder, torque):
    """A log of rows (time, positions seen, torques seen) with its sensors' noise [rad], [N m]."""
    time, qpos, tau = (np.array(x) for x in zip(*rows, strict=True))
    return Log(
        time=time,
        joint_names=("shoulder", "elbow"),
        qpos=qpos,
        tau=tau,
        tau_kind=TorqueKind.COMMANDED,
        sigma_qpos=np.full(2, encoder),
        sigma_tau=torque,
    )


def sized(size: float) -> mujoco.MjModel:
    """The arm so many times as long, of the same stuff."""
    model = mujoco.MjModel.from_xml_string(ARM)
    model.body_pos[:] *= size
    model.body_ipos[:] *= size
    model.body_mass[:] *= size**3
    for inertia in (model.body_inertia, model.dof_damping, model.dof_armature):
        inertia[:] *= size**5
    return model


def loaded(mass: float, at: tuple[float, float, float], radius: float = 0.0):
    """An edit of the arm's model: a ball [kg] of a radius of gyration [m] at a point of the lower arm [m]."""

    def edit(model):
        own, centre, point = model.body_mass[2], model.body_ipos[2].copy(), np.array(at)
        model.body_mass[2] = own + mass
        model.body_ipos[2] = (own * centre + mass * point) / (own + mass)
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.body_iquat[2])
        turn = turn.reshape(3, 3)
        inertia = turn @ np.diag(model.body_inertia[2]) @ turn.T
        inertia += mass * radius**2 * np.eye(3)
        for m, p in ((own, centre), (mass, point)):
            d = p - model.body_ipos[2]
            inertia += m * (d @ d * np.eye(3) - np.outer(d, d))
        model.body_inertia[2], axes = np.linalg.eigh(inertia)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        mujoco.mju_mat2Quat(model.body_iquat[2], axes.ravel())

    return edit


def simulate(
    torque=nothing,
    edit=lambda model: None,
    seed=0,
    seconds=8.0,
    noise=1.0,
    force=lambda t: np.zeros(3),
    at=None,
    encoder=lambda q: q,
    pace=1.0,
    size=1.0,
):
    """A log of the arm, with `torque(t, q, v, u)` acting beside the logged u and `force(t)` on the lower arm.

    `at`: the point of it that the force acts on, its centre of mass if None. `encoder` gives what the encoders read
    where the joints are at q; `pace` of the motion; `size` of the arm (`sized`).
    """
    model, strength = sized(size), size**5
    edit(model)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = wave(0.0, seed, pace)
    rng = np.random.default_rng(seed + 100)
    rows, sensed, felt = [], noise * 2e-5, noise * strength * TORQUE
    for _ in range(round(seconds * 500)):
        target, speed = wave(data.time, seed, pace)
        u = strength * asked(target, speed, data.qpos, data.qvel)
        seen = encoder(data.qpos) + sensed * rng.standard_normal(2)
        rows.append((data.time, seen, u + felt * rng.standard_normal(2)))
        for _ in range(4):
            pull = data.xfrc_applied[2, :3] = force(data.time)
            if at is not None:
                point = data.xpos[2] + data.xmat[2].reshape(3, 3) @ at
                data.xfrc_applied[2, 3:] = np.cross(point - data.xipos[2], pull)
            data.qfrc_applied[:] = u + torque(data.time, data.qpos, data.qvel, u)
            mujoco.mj_step(model, data)
    return logged(rows, sensed, felt)
