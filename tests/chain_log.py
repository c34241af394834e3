"""Logs of a chain of five joints in MuJoCo C, with friction by bristles and motors that miss their command."""

import mujoco
import numpy as np

from jax_inertia.logs.log import Log, TorqueKind

JOINTS = 5
DAMPING = np.array([1.2, 1.5, 0.8, 0.3, 0.2])
FRICTION = np.array([0.8, 1.0, 0.5, 0.2, 0.15])
QPOS, TAU = 2e-5, np.array([0.02, 0.03, 0.02, 0.005, 0.003])
GAINS = np.array([400.0, 400.0, 200.0, 50.0, 20.0])


def chain_xml(friction):
    axes, out = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0"), ""
    for k in range(JOINTS):
        mass, length = 4.0 * 0.65**k, 0.3 - 0.03 * k
        spin = mass * length**2 / 10
        out += (
            f'<body name="segment{k + 1}" pos="0 0 {0.0 if k == 0 else 0.33 - 0.03 * k}">'
            f'<joint name="axis{k + 1}" axis="{axes[k]}" damping="{DAMPING[k]}" '
            f'frictionloss="{friction[k]}" armature="{0.1 * 0.6**k}"/>'
            f'<inertial mass="{mass}" pos="0.01 0.02 {0.5 * length}" '
            f'diaginertia="{spin} {spin} {0.3 * spin}"/>'
        )
    return (
        '<mujoco><option timestep="0.0005" integrator="RK4"/><worldbody>'
        + out
        + "</body>" * JOINTS
        + "</worldbody></mujoco>"
    )


def wave(t, seed):
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(0.1, 0.7, (3, JOINTS)), rng.uniform(0, 6.28, (3, JOINTS))
    size = 0.35 / (1 + frequency)
    angle = 2 * np.pi * frequency * t + phase
    return np.sum(size * np.sin(angle), 0), np.sum(size * 2 * np.pi * frequency * np.cos(angle), 0)


def simulate(
    damping=DAMPING,
    friction=0.0,
    stops=False,
    seed=1,
    seconds=7.0,
    motors=None,
    gain=1.0,
    reach=3e-4,
    braking=0.1,
    creep=np.inf,
    soft=0.0,
    encoder=QPOS,
    listens=False,
    jitter=None,
    push=None,
):
    """A log at 250 Hz; with `stops`, every joint but the first slows down and stands from 2 to 4 s.

    `motors`: torque noise that the log does not show, of a log that states none; `gain` of all motors; `reach` of the
    friction's bristles; `braking`: the controller's gain of speed over that of position; `creep`: time constant of
    bristles that straighten while the joints stand [s]; `soft`: friction loss by MuJoCo's own constraint;
    `encoder`: noise of the positions logged [rad]; `listens`: the controller's speeds are those positions' differences;
    `jitter`: noise of the commands of a loop twice as quick as the log, which holds every other one; `push`: a force on
    segment3 [N, world axes] that swells and fades from 3.0 to 3.3 s.
    """
    model = mujoco.MjModel.from_xml_string(chain_xml(np.zeros(JOINTS)))
    model.dof_damping[:] = damping
    model.dof_frictionloss[:] = soft
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = wave(0.0, seed)
    rng = np.random.default_rng(seed + 50)
    bristle = np.zeros(JOINTS)
    time, qpos, tau = [], [], []
    clock = 0.0
    for k in range(round(seconds * 2000)):
        if k % 8 == 0:
            target, speed = wave(data.time, seed)
            if stops:
                pace = np.clip(abs(data.time - 3.0) / 0.5 - 2.0, 0.0, 1.0)
                later, faster = wave(clock, seed)
                target[1:], speed[1:] = later[1:], pace * faster[1:]
                clock += pace * 8 * 0.0005
            time.append(data.time)
            qpos.append(data.qpos + encoder * rng.standard_normal(JOINTS))
            v = (qpos[-1] - qpos[-2]) / 0.004 if listens and len(qpos) > 1 else data.qvel
            u = GAINS * (target - data.qpos) + braking * GAINS * (speed - v)
            u += data.qfrc_bias
            smooth = u.copy()
            if jitter is not None:
                u += jitter * rng.standard_normal(JOINTS)
            if motors is None:
                tau.append(u + TAU * rng.standard_normal(JOINTS))
            else:
                tau.append(u.copy())
                u += motors * rng.standard_normal(JOINTS)
        elif k % 8 == 4 and jitter is not None:
            u = smooth + jitter * rng.standard_normal(JOINTS)
        # A bristle's law, not the sign of the velocity that the model's friction is taken for.
        bristle = np.clip(bristle + data.qvel * 0.0005 / reach, -1, 1)
        bristle *= np.where(np.abs(data.qvel) < 0.01, np.exp(-0.0005 / creep), 1.0)
        data.qfrc_applied[:] = gain * u - friction * bristle
        if push is not None:
            swells = np.sin(np.pi * np.clip((data.time - 3.0) / 0.3, 0.0, 1.0)) ** 2
            data.xfrc_applied[3, :3] = swells * np.asarray(push)
        mujoco.mj_step(model, data)
    return Log(
        time=np.array(time),
        joint_names=tuple(f"axis{k + 1}" for k in range(JOINTS)),
        qpos=np.array(qpos),
        tau=np.array(tau),
        tau_kind=TorqueKind.COMMANDED,
        sigma_qpos=np.full(JOINTS, encoder) if motors is None else None,
        sigma_tau=TAU if motors is None else None,
    )
