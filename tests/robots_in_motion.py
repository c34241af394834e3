"""Logs of robots of every kind by MuJoCo C's forward dynamics, position loops and noise: nothing of the package."""

import mujoco
import numpy as np

import jax_inertia as ji

HEAD = """<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="implicitfast"/><worldbody>
"""


def _link(mass: float, centre: str, moments: str) -> str:
    return f'<inertial mass="{mass}" pos="{centre}" diaginertia="{moments}"/>'


# Joints' own dry friction, damping and rotor inertia are in every model.
LEG = (
    HEAD
    + """<body name="hip" pos="0 0 1">
<joint name="abduct" axis="1 0 0" damping="0.05" frictionloss="0.1" armature="0.01"/>"""
    + _link(0.9, "0 0.05 0", "0.001 0.001 0.001")
    + """<body name="thigh" pos="0 0.08 0">
<joint name="swing" axis="0 1 0" damping="0.05" frictionloss="0.1" armature="0.01"/>"""
    + _link(1.2, "0.01 0 -0.08", "0.006 0.006 0.001")
    + """<body name="shank" pos="0 0 -0.22">
<joint name="knee" axis="0 1 0" damping="0.03" frictionloss="0.05" armature="0.01"/>"""
    + _link(0.35, "0 0 -0.1", "0.002 0.002 0.0001")
    + "</body></body></body></worldbody></mujoco>"
)
CRANE = (
    HEAD
    + """<body name="tower"><joint name="slew" axis="0 0 1" damping="400" frictionloss="200" armature="50"/>"""
    + _link(1500, "0.2 0 1", "600 600 300")
    + """<body name="boom" pos="0 0 2">
<joint name="luff" axis="0 1 0" damping="900" frictionloss="300" armature="60"/>"""
    + _link(600, "2 0 0.1", "20 900 900")
    + """<body name="jib" pos="4 0 0">
<joint name="fold" axis="0 1 0" damping="300" frictionloss="100" armature="20"/>"""
    + _link(250, "1.2 0 0", "4 160 160")
    + """<body name="out" pos="2.4 0 0">
<joint name="extend" type="slide" axis="1 0 0" damping="200" frictionloss="80" armature="10"/>"""
    + _link(90, "0.6 0 0", "1 12 12")
    + "</body></body></body></body></worldbody></mujoco>"
)
RIG = (
    HEAD
    + """<body name="bar" pos="0 0 1">
<joint name="shaft" axis="0 1 0" damping="0.02" frictionloss="0.03" armature="0.002"/>"""
    + _link(0.8, "0.12 0 0", "0.0005 0.003 0.003")
    + "</body></worldbody></mujoco>"
)
GANTRY = (
    HEAD
    + """<body name="bridge"><joint name="x" type="slide" axis="1 0 0" damping="20" frictionloss="6" armature="4"/>"""
    + _link(30, "0 0.3 0", "2 1 2")
    + """<body name="trolley"><joint name="y" type="slide" axis="0 1 0" damping="15" frictionloss="4" armature="3"/>"""
    + _link(12, "0 0 0", "0.1 0.1 0.1")
    + """<body name="mast"><joint name="z" type="slide" axis="0 0 1" damping="15" frictionloss="4" armature="3"/>"""
    + _link(6, "0 0 -0.2", "0.08 0.08 0.01")
    + """<body name="elbow" pos="0 0 -0.5">
<joint name="nod" axis="0 1 0" damping="0.4" frictionloss="0.5" armature="0.05"/>"""
    + _link(4, "0.15 0 0", "0.01 0.04 0.04")
    + """<body name="wrist" pos="0.3 0 0">
<joint name="tip" axis="1 0 0" damping="0.1" frictionloss="0.1" armature="0.02"/>"""
    + _link(1.5, "0.05 0.06 0", "0.004 0.004 0.004")
    + "</body></body></body></body></body></worldbody></mujoco>"
)
SPRUNG = LEG.replace(
    'name="swing" axis="0 1 0"', 'name="swing" axis="0 1 0" stiffness="6"'
).replace('name="knee" axis="0 1 0"', 'name="knee" axis="0 1 0" stiffness="2" springref="0.5"')
ROBOTS = {
    "leg": (LEG, 0.001, (0.5, 0.7, 0.9), (0.1, 0.4, -0.9), (0.3, 0.7, 1.1)),
    "crane": (CRANE, 0.002, (0.7, 0.5, 0.7, 0.5), (0.0, -0.3, 0.6, 0.5), (0.06, 0.11, 0.17)),
    "rig": (RIG, 0.001, (1.6,), (0.3,), (0.2, 0.5, 0.9)),
    "gantry": (
        GANTRY,
        0.001,
        (0.4, 0.3, 0.2, 0.9, 1.2),
        (0.0, 0.0, 0.0, 0.3, 0.4),
        (0.25, 0.5, 0.8),
    ),
    "sprung": (SPRUNG, 0.001, (0.5, 0.7, 0.9), (0.1, 0.4, -0.9), (0.3, 0.7, 1.1)),
}


def model_of(name: str) -> str:
    """The nominal model's MJCF."""
    xml, step, *_ = ROBOTS[name]
    return xml.format(step=step)


def robot_of(name: str) -> ji.Robot:
    return ji.load_model(mujoco.MjModel.from_xml_string(model_of(name)))


def log_of(
    name: str,
    *,
    seed: int = 1,
    seconds: float = 12.0,
    noise: float = 0.003,
    load: float = 0.0,
    change=lambda spec: None,
    slower: float = 1.0,
    by_targets: bool = False,
) -> ji.Log:
    """A log of the robot, told smooth positions by a stiff loop; `load` is a share of its last link's mass, at its end.

    `change` edits the real robot's spec; `noise` is of each joint's largest torque, `slower` stretches the motion.
    `by_targets`: the loop is soft, knows nothing of the model and holds each target for a sample; its targets and gains
    are logged, and no torque.
    """
    xml, step, reach, middle, tones = ROBOTS[name]
    spec = mujoco.MjSpec.from_string(xml.format(step=step))
    if load:
        last = spec.bodies[-1]
        body = last.add_body(name="load", pos=[2.0 * x for x in last.ipos])
        body.explicitinertial, body.mass = True, load * last.mass
        body.inertia = [0.02 * x * load for x in last.inertia]
    change(spec)
    model = spec.compile()
    data, n = mujoco.MjData(model), model.nv
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, (n, len(tones)))
    pace = 2 * np.pi * np.array(tones) * (1.0 + 0.1 * rng.normal(size=(n, len(tones)))) / slower
    size = np.array(reach)[:, None] / len(tones) / np.sqrt(np.arange(1, len(tones) + 1))
    inertia = np.zeros((n, n))
    data.qpos[:] = middle
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    stiff = (
        40.0**2 * np.diag(inertia)
        if slower == 1.0 and name != "crane"
        else 15.0**2 * np.diag(inertia)
    )
    if by_targets:
        stiff = 15.0**2 * np.diag(inertia)
    damp = (1.4 if by_targets else 2.0) * np.sqrt(stiff * np.diag(inertia))

    def wanted(t: float) -> tuple[np.ndarray, np.ndarray]:
        angle = pace * t + phase
        return middle + np.sum(size * np.sin(angle), axis=1), np.sum(
            size * pace * np.cos(angle), axis=1
        )

    data.qpos[:], data.qvel[:] = wanted(0.0)
    keep = max(round(0.004 / step), 1)
    seconds = seconds if name != "crane" else 4.0 * seconds
    rows = []
    for k in range(round(seconds / step)):
        q, v = wanted((k - k % keep if by_targets else k) * step)
        mujoco.mj_forward(model, data)
        data.qfrc_applied[:] = stiff * (q - data.qpos) - damp * data.qvel
        if not by_targets:
            data.qfrc_applied[:] += damp * v + data.qfrc_bias - data.qfrc_passive
        if k % keep == 0:
            rows.append((k * step, data.qpos.copy(), data.qfrc_applied.copy(), q))
        mujoco.mj_step(model, data)
    time, q, tau, target = (np.array(x)[200:] for x in zip(*rows, strict=True))
    tau = tau + noise * np.abs(tau).max(axis=0) * rng.normal(size=tau.shape)
    q = q + 1e-5 * rng.normal(size=q.shape)
    driven = {"qpos_target": target, "kp": stiff, "kd": damp} if by_targets else {"tau": tau}
    return ji.Log(
        time=time - time[0],
        joint_names=tuple(model.joint(j).name for j in range(n)),
        qpos=q,
        **driven,
    )
