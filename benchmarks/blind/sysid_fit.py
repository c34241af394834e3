"""MuJoCo's own `mujoco.sysid` as a tool of the protocol, told what to fit: every joint's three numbers and every mass.

Armature, damping and friction loss of each joint and a factor of each body's mass and inertia, by its Gauss–Newton over
rollouts of a quarter of a second from states of the log, driven by the logged torque, or by the targets through a
position actuator where no torque is logged. Fixed bases. Needs the extra `mujoco[sysid]`.
"""

from __future__ import annotations

import contextlib

import mujoco
import numpy as np
from mujoco import sysid
from scipy import signal

# Without the extra the module is empty.
AVAILABLE = hasattr(sysid, "optimize")
WINDOWS, HORIZON = 24, 0.25  # s
CUTOFF = 10.0  # Hz
MISSING = "mujoco.sysid lacks its libraries; pip install 'mujoco[sysid]'"
ITERATIONS = 12
FIRST = 0.2  # of its unit, what a number starts from that the model has none of: not at its bound
HEAVIER = 2.0  # most that a mass may be, as a factor, or least by its inverse
UNITS = 20.0  # most that a number of a joint may be, in its own unit


def fit(spec: mujoco.MjSpec, log: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """What each joint's numbers lack in the model (n, 4), and the power of their torques (n, 4).

    Damping, friction, armature, and 0 for an offset; joints in the model's order. The spec is left with what was
    fitted: one actuator a joint, masses, and joint numbers.
    Raises ValueError where the libraries of `mujoco.sysid` are absent.
    """
    if not AVAILABLE:
        raise ValueError(MISSING)
    plain = spec.compile()
    joints = [plain.joint(j).name for j in range(plain.njnt)]
    column = [[str(x) for x in log["joint_names"]].index(name) for name in joints]
    told = _actuate(spec, joints, column, log)
    rate = 1.0 / float(np.median(np.diff(log["time"])))
    q = smooth(log["qpos"], rate)[:, column]
    v = np.gradient(q, 1.0 / rate, axis=0)
    a = np.gradient(v, 1.0 / rate, axis=0)
    if "tau" in log:
        torque = log["tau"][:, column]
    else:
        torque = log["kp"][column] * (log["qpos_target"][:, column] - q) - log["kd"][column] * v
    rms = lambda x: np.sqrt(np.mean(x**2, axis=0)) + 1e-9  # noqa: E731
    # A tenth of the joint's torque each, or half of its inertia.
    unit = np.stack([0.1 * rms(torque) / rms(v), 0.1 * rms(torque), 0.5 * _inertia(plain)], axis=1)
    own = np.stack([plain.dof_damping, plain.dof_frictionloss, plain.dof_armature], axis=1)
    bodies = [
        plain.body(b).name
        for b in range(1, plain.nbody)
        if plain.body_weldid[b] and plain.body_mass[b] > 0
    ]

    def write_joints(s: mujoco.MjSpec, numbers: np.ndarray) -> None:
        for name, (damping, friction, armature) in zip(joints, numbers, strict=True):
            joint = s.joint(name)
            first = np.array(joint.damping, float)
            first[0] = damping
            joint.damping, joint.frictionloss, joint.armature = first, friction, armature

    def write_bodies(s: mujoco.MjSpec, factors: np.ndarray) -> None:
        for name, factor in zip(bodies, factors, strict=True):
            b, body = plain.body(name).id, s.body(name)
            body.mass, body.fullinertia = factor * plain.body_mass[b], np.full(6, np.nan)
            body.inertia, body.iquat = factor * plain.body_inertia[b], plain.body_iquat[b]

    parameters = sysid.ParameterDict()
    start = np.maximum(own / unit, FIRST)
    parameters.add(
        sysid.Parameter(
            "joints", start.ravel(), np.zeros(start.size), np.maximum(UNITS, 2.0 * start).ravel(),
            modifier=lambda s, p: write_joints(s, p.value.reshape(-1, 3) * unit),
        )
    )  # fmt: skip
    one = np.ones(len(bodies))
    parameters.add(
        sysid.Parameter(
            "bodies", one, one / HEAVIER, one * HEAVIER, modifier=lambda s, p: write_bodies(s, p.value)
        )
    )  # fmt: skip
    # Its optimiser prints every iteration, whatever it is told.
    with contextlib.redirect_stdout(None):
        found, _ = sysid.optimize(
            initial_params=parameters,
            residual_fn=sysid.build_residual_fn(
                models_sequences=[windows(spec, log, told)], n_threads=1
            ),
            optimizer="mujoco",
            verbose=False,
            max_iters=ITERATIONS,
        )
    numbers = found["joints"].value.reshape(-1, 3) * unit
    write_joints(spec, numbers)
    write_bodies(spec, found["bodies"].value)
    lacking = np.concatenate([numbers - own, np.zeros((len(joints), 1))], axis=1)
    power = np.stack([rms(v), np.ones(len(joints)), rms(a), np.ones(len(joints))], axis=1)
    return lacking, (lacking * power) ** 2


def _actuate(spec: mujoco.MjSpec, joints: list[str], column: list[int], log: dict) -> str:
    """One actuator a joint; the array that drives it."""
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for name, k in zip(joints, column, strict=True):
        actuator = spec.add_actuator(name=f"{name}_drive", target=name)
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        if "tau" in log:
            actuator.set_to_motor()
        else:
            actuator.set_to_position(kp=float(log["kp"][k]), kv=float(log["kd"][k]))
    return "tau" if "tau" in log else "qpos_target"


def _inertia(model: mujoco.MjModel) -> np.ndarray:
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    return full.diagonal().copy()


def smooth(x: np.ndarray, rate: float) -> np.ndarray:
    """Zero-phase low-pass along the leading axis."""
    return signal.sosfiltfilt(signal.butter(3, CUTOFF, fs=rate, output="sos"), x, axis=0)


def windows(
    spec: mujoco.MjSpec, log: dict[str, np.ndarray], told: str = "tau"
) -> sysid.ModelSequences:
    """The log in short windows, each from a state of its own, `told` as controls and joint positions as sensors."""
    rate = 1.0 / float(np.median(np.diff(log["time"])))
    joints = [str(n) for n in log["joint_names"]]
    for name in joints:
        spec.add_sensor(
            name=f"{name}_at",
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=name,
        )
    model = spec.compile()
    order = [joints.index(model.joint(model.actuator_trnid[k, 0]).name) for k in range(model.nu)]
    clean = smooth(log["qpos"], rate)
    speed = np.gradient(clean, 1.0 / rate, axis=0)
    length = round(HORIZON * rate)
    starts = np.linspace(0.3 * rate, len(clean) - length - 0.3 * rate, WINDOWS).astype(int)
    data = mujoco.MjData(model)
    states, controls, sensors = [], [], []
    for k in starts:
        span = slice(k, k + length)
        when = np.arange(length) / rate
        for j, name in enumerate(joints):
            data.joint(name).qpos, data.joint(name).qvel = clean[k, j], speed[k, j]
        states.append(sysid.create_initial_state(model, data.qpos, data.qvel, data.act))
        controls.append(sysid.TimeSeries(when, log[told][span][:, order]))
        sensors.append(sysid.TimeSeries.from_names(when, log["qpos"][span], model))
    names = [f"from {k}" for k in starts]
    return sysid.ModelSequences("robot", spec, names, states, controls, sensors)
