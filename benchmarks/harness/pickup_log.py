"""Logs of arms whose light wrist link picks up a load: torques by MuJoCo C's inverse dynamics along a planned motion.

Nothing of this project takes part in them. Joints lose a dry and a viscous friction and read an offset where asked for.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from jax_inertia.logs.log import Log

# Turns of the joints, lengths and masses of the links, the wrist last.
ARMS = {
    "spherical": ("zyyxyz", (0.16, 0.42, 0.38, 0.1, 0.1, 0.08), (4.0, 8.4, 2.3, 1.2, 1.2, 0.19)),
    "planar": ("yyy", (0.3, 0.25, 0.1), (2.4, 1.6, 0.25)),
    "long": ("zyyy", (0.2, 0.6, 0.5, 0.12), (6.0, 5.0, 3.0, 0.3)),
    "small": ("zyyxy", (0.06, 0.12, 0.12, 0.05, 0.04), (0.3, 0.25, 0.2, 0.1, 0.06)),
}
WRIST = "wrist"


def shape(kind: str) -> tuple[str, Sequence[float], Sequence[float]]:
    """Turns, lengths [m] and masses [kg] of an arm of `ARMS`, or of one drawn by chance: "drawn 7" is the seventh."""
    if kind in ARMS:
        return ARMS[kind]
    rng = np.random.default_rng([71, int(kind.removeprefix("drawn "))])
    joints, size = int(rng.integers(3, 8)), np.exp(rng.uniform(np.log(0.1), np.log(0.6)))
    turns = [str(rng.choice(list("xyz")))]
    while len(turns) < joints:  # Two that turn alike may follow each other, three may not.
        turns.append(str(rng.choice([t for t in "xyz" if turns[-2:] != [t, t]])))
    taper = np.linspace(1.0, rng.uniform(0.2, 0.5), joints) * rng.uniform(0.6, 1.4, joints)
    lengths = size * taper
    masses = rng.uniform(10.0, 40.0) * size**1.5 * taper**2
    return "".join(turns), lengths.tolist(), masses.tolist()


def arm(kind: str = "spherical") -> mujoco.MjModel:
    """An arm of `shape`: rods along their own z, a ball at the end of the last."""
    turns, lengths, masses = shape(kind)
    xml, at = "", 0.0
    for k, (turn, length, mass) in enumerate(zip(turns, lengths, masses, strict=True)):
        axis = " ".join("1" if turn == x else "0" for x in "xyz")
        name = WRIST if k == len(turns) - 1 else f"link{k}"
        side, along = mass * (0.15 * length + 0.02) ** 2, mass * length**2 / 12 + 1e-6
        along = max(along, 0.8 * side)
        xml += (
            f'<body name="{name}" pos="0 0 {at}"><joint name="j{k}" axis="{axis}"/>'
            f'<inertial mass="{mass}" pos="0.01 -0.005 {0.45 * length}"'
            f' diaginertia="{along} {along} {side}"/>'
        )
        at = length
    xml = f"<mujoco><worldbody>{xml}{'</body>' * len(turns)}</worldbody></mujoco>"
    model = mujoco.MjModel.from_xml_string(xml)
    # Centres and axes of inertia are edited below: the body's own axes are no short cut then.
    model.body_sameframe[:] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    return model


def loaded(kind: str, load: float, at: Sequence[float] = (0.0, 0.02, 0.09), radius: float = 0.03):
    """The arm with a ball [kg] of a radius of gyration [m] held at a point of its wrist [m]."""
    model = arm(kind)
    if load > 0:
        b = model.body(WRIST).id
        own, centre, point = float(model.body_mass[b]), model.body_ipos[b].copy(), np.array(at)
        both = (own * centre + load * point) / (own + load)
        inertia = np.diag(model.body_inertia[b]) + load * radius**2 * np.eye(3)
        for m, p in ((own, centre), (load, point)):
            d = p - both
            inertia += m * (d @ d * np.eye(3) - np.outer(d, d))
        size, axes = np.linalg.eigh(inertia)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        model.body_mass[b], model.body_ipos[b], model.body_inertia[b] = own + load, both, size
        mujoco.mju_mat2Quat(model.body_iquat[b], axes.ravel())
    return model


def motion(kind: str, time: np.ndarray, seed: int, pace: float = 1.0):
    """(q, v, a) of a smooth motion: three sines a joint."""
    rng, n = np.random.default_rng(seed), len(shape(kind)[0])
    frequency = pace * rng.uniform(0.1, 0.7, (3, n))
    phase, size = rng.uniform(0, 2 * np.pi, (2, 3, n))
    size = (0.25 + 0.3 * size / (2 * np.pi)) / (1 + frequency)
    w = 2 * np.pi * frequency
    angle = w * time[:, None, None] + phase
    mean = rng.uniform(-0.6, 0.6, n)
    mean[1] += 0.8
    q = mean + np.sum(size * np.sin(angle), axis=1)
    return q, np.sum(size * w * np.cos(angle), axis=1), -np.sum(size * w**2 * np.sin(angle), axis=1)


def torques(model: mujoco.MjModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """τ of `mj_inverse`, sample by sample [N m]."""
    data, out = mujoco.MjData(model), np.empty_like(q)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out


def picked_up(
    kind: str = "spherical",
    load: float = 0.0,
    *,
    at: float = 0.0,
    seconds: float = 10.0,
    rate: float = 200.0,
    seed: int = 0,
    noise: float = 0.002,
    friction: float = 0.0,
    pace: float = 1.0,
    off: Sequence[float] = (0.0, 0.02, 0.09),
) -> Log:
    """The arm takes up `load` [kg] after `at` [s]; torque noise and friction in parts of each joint's largest torque.

    `friction`: of the dry level; as much again is viscous at 1 rad/s, and offsets are up to half of it.
    """
    time = np.arange(round(seconds * rate)) / rate
    q, v, a = motion(kind, time, seed, pace)
    # Two decimals of the two models' shapes: one inverse dynamics each, joined at the pick-up.
    with_it = torques(loaded(kind, load, off), q, v, a)
    tau = np.where((time < at)[:, None], torques(arm(kind), q, v, a), with_it)
    rng, n = np.random.default_rng(seed + 1000), q.shape[1]
    limit = (
        2.0 * np.abs(torques(loaded(kind, 0.0), q, v, a)).max(axis=0).max() * np.linspace(1, 0.2, n)
    )
    level, viscous, offset = (
        friction
        * limit
        * np.array([rng.uniform(0.5, 1.5, n), rng.uniform(0.5, 1.5, n), rng.uniform(-0.5, 0.5, n)])
    )
    tau = tau + level * np.tanh(v / 0.002) + viscous * v + offset
    tau = tau + noise * limit * rng.standard_normal(tau.shape)
    return Log(
        time=time,
        joint_names=tuple(f"j{k}" for k in range(n)),
        qpos=q + 1e-5 * rng.standard_normal(q.shape),
        qvel=v + 1e-4 * rng.standard_normal(q.shape),
        tau=tau,
    )


def own_mass(kind: str) -> float:
    """Of the bare wrist [kg]."""
    return shape(kind)[2][-1]
