"""The stratum `imu`: a robot on its feet that is told positions and knows its attitude and specific force alone.

MuJoCo C at 0.25 ms; the loop τ = kp (q* − q) − kd q̇ runs at 500 or 1000 Hz on the encoders, targets are held for 20 ms.
Dry friction is LuGre's bristle, exact over a step. Hidden is nothing, every joint's friction and rotor, a load on the
trunk, or both; bodies are 1 % off the model's, as those of a good drawing are. No contact wrench is logged and no place
of the base; a torque in half of the logs, flags of feet in a third.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.worlds.as_bought import Made
from benchmarks.worlds.effects import add_mass, editable
from benchmarks.worlds.feet.legs import WALKERS, Walker, sways, trots
from benchmarks.worlds.hidden import inertials_off, log_uniform
from benchmarks.worlds.own_robot import set_linear
from benchmarks.worlds.plant import Unstable

STRATUM = "imu"
KINDS = ("sound", "payload", "ordinary", "payload", "sound", "payload_bare")
STEP, TOLD, WARM, ATTEMPTS = 2.5e-4, 0.02, 1.5, 6  # s, s, s
LOAD = (1.0, 3.0)  # kg
SECONDS = (6.0, 4.0)  # of the log, of the other motion
TRUST = 0.01
"""Of a robot's weight: what an owner knows it by. A load's visibility is its weight over this."""


@dataclass
class Sensors:
    """Standard deviations of a sample, and steps."""

    encoder: float  # rad
    torque: float  # N m
    gyro: float = 0.005  # rad/s
    accelerometer: float = 0.08  # m/s²
    bias: float = 0.1  # m/s², each axis of the accelerometer
    tilt: float = 0.002  # rad, of the attitude


@dataclass
class Real:
    """What the robot is: joints (n), bodies, load (kg, place on the trunk, size)."""

    armature: np.ndarray
    damping: np.ndarray
    dry: np.ndarray
    presliding: np.ndarray
    inertials: dict[str, dict]
    load: tuple[float, np.ndarray, float] | None

    def model(self, robot: Walker) -> mujoco.MjModel:
        """Bodies, rotors and damping; dry friction is the simulation's own."""
        model = editable(mujoco.MjModel.from_xml_string(robot.xml))
        model.opt.timestep = STEP
        model.dof_armature[6:], model.dof_damping[6:] = self.armature, self.damping
        for name, off in self.inertials.items():
            b = model.body(name).id
            model.body_mass[b] *= 1.0 + off["mass"]
            model.body_inertia[b] *= (1.0 + off["mass"]) * (1.0 + off["inertia"])
            model.body_ipos[b] += off["com"]
        if self.load is not None:
            mass, place, size = self.load
            add_mass(model, model.body(robot.trunk).id, mass, place, mass * size**2 / 6 * np.eye(3))
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model


def make(number: int, seed: list[int]) -> Made:
    """Both logs of robot `number`; RuntimeError where it falls whatever is drawn."""
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([*seed, attempt])
        kind = KINDS[number % len(KINDS)]
        robot = WALKERS["biped" if (number // len(KINDS) + number) % 3 == 2 else "quadruped"](rng)
        real = _draw(robot, kind, rng)
        setting = _setting(robot, rng)
        try:
            logs = [_log(robot, real, setting, which, rng) for which in (0, 1)]
        except Unstable:
            continue
        good = kind in ("sound", "payload")
        nominal = _nominal(robot, real) if good else robot.xml
        return Made(*logs, nominal, _truth(robot, real, setting, kind, logs[0]))
    raise RuntimeError(f"imu {number}: every attempt fell")


def _draw(robot: Walker, kind: str, rng: np.random.Generator) -> Real:
    n, peak = len(robot.joints), 0.2 * robot.kp
    load = None
    if kind.startswith("payload"):
        centre = mujoco.MjModel.from_xml_string(robot.xml).body(robot.trunk).ipos
        place = centre + rng.uniform([-0.1, -0.05, 0.0], [0.1, 0.05, 0.1])
        load = (float(rng.uniform(*LOAD)), place, float(rng.uniform(0.05, 0.12)))
    inertials = inertials_off(rng, robot.bodies, 0.5)
    size = (robot.height / 0.33) ** 2
    return Real(
        armature=size * log_uniform(rng, 0.006, 0.02) * np.ones(n),
        damping=peak * log_uniform(rng, 0.002, 0.006) * rng.uniform(0.8, 1.2, n),
        dry=peak * log_uniform(rng, 0.008, 0.025) * rng.uniform(0.7, 1.3, n),
        presliding=log_uniform(rng, 5e-4, 2e-3, n),
        inertials=inertials,
        load=load,
    )


def _setting(robot: Walker, rng: np.random.Generator) -> dict:
    loop = int(rng.choice([500, 1000]))
    kinds = ["sways" if robot.ankles or rng.random() < 0.6 else "trots" for _ in range(2)]
    return {
        "motion": kinds,
        "loop_hz": loop,
        "rate_hz": int(rng.choice([200, 500])),
        "torque": bool(rng.random() < 0.5),
        "flags": bool(rng.random() < 0.33),
        "encoder_bits": int(rng.integers(14, 18)),
    }


def _log(robot: Walker, real: Real, s: dict, which: int, rng) -> dict[str, np.ndarray]:
    motion = {"sways": sways, "trots": trots}[s["motion"][which]](robot, rng)
    rows = simulate(robot, real, motion, SECONDS[which], s["loop_hz"], s["rate_hz"])
    sensors = Sensors(2 * np.pi / 2 ** s["encoder_bits"], 0.0006 * float(robot.kp.max()))
    return sensed(robot, rows, sensors, s, rng)


def simulate(robot: Walker, real: Real, motion, seconds: float, loop: int, rate: int) -> dict:
    """Clean rows by name; raises Unstable where it falls."""
    model = real.model(robot)
    data = mujoco.MjData(model)
    each, every = round(1 / (loop * STEP)), round(1 / (rate * STEP))
    data.qpos[7:] = target = motion(-WARM)
    z, stiff = np.zeros_like(target), real.dry / real.presliding
    loss = 0.8 * np.sqrt(stiff * (real.armature + 0.01))
    feet, first = [model.body(x).id for x in robot.feet], -round(WARM / STEP)
    rows: dict[str, list] = {}
    tau = np.zeros_like(target)
    for k in range(first, round(seconds / STEP)):
        t = k * STEP
        mujoco.mj_step1(model, data)
        q, v = data.qpos[7:], data.qvel[6:]
        if k % round(TOLD / STEP) == 0:
            target = motion(t)
        if k % each == 0:
            tau = robot.kp * (target - q) - robot.kd * v
        # The bristle, exactly over a step of this speed (LuGre).
        rate_z = np.abs(v) / real.presliding * STEP + 1e-12
        new = z * np.exp(-rate_z) + v * STEP * -np.expm1(-rate_z) / rate_z
        rub = stiff * new + loss * np.exp(-((v / 0.02) ** 2)) * (new - z) / STEP
        z = new
        data.qfrc_applied[6:] = tau - rub
        keep = k >= 0 and k % every == 0
        if keep:
            row = {"time": t, "qpos": q, "qpos_target": target, "tau": tau, "base_quat": data.qpos[3:7],
                   "base_angvel": data.sensor("gyro").data, "true_pos": data.qpos[:3]}  # fmt: skip
            for name, value in row.items():
                rows.setdefault(name, []).append(np.copy(value))
        mujoco.mj_step2(model, data)
        if keep:
            # Of the state before this step, as the positions above.
            rows.setdefault("base_linacc", []).append(data.sensor("accelerometer").data.copy())
            rows.setdefault("load", []).append(foot_loads(model, data, feet))
        if k % 400 == 0 and (data.qpos[2] < 0.5 * robot.height or data.xmat[1][8] < 0.85):
            raise Unstable(f"fell at {t:.2f} s")
    return {name: np.array(x) for name, x in rows.items()}


def foot_loads(model: mujoco.MjModel, data: mujoco.MjData, feet: list[int]) -> np.ndarray:
    """Normal force on each foot [N]."""
    out, wrench = np.zeros(len(feet)), np.zeros(6)
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, wrench)
        for geom in data.contact[i].geom:
            if (body := int(model.geom_bodyid[geom])) in feet:
                out[feet.index(body)] += wrench[0]
    return out


def sensed(robot: Walker, rows: dict, sensors: Sensors, s: dict, rng) -> dict[str, np.ndarray]:
    """The log as a diagnosis gets it."""

    def noise(like: np.ndarray) -> np.ndarray:
        return rng.standard_normal(like.shape)

    bias = sensors.bias * rng.choice([-1.0, 1.0], 3)
    small = 0.5 * sensors.tilt * noise(rows["base_angvel"])
    quat = np.empty_like(rows["base_quat"])
    for k, clean in enumerate(rows["base_quat"]):
        mujoco.mju_mulQuat(quat[k], clean, np.array([1.0, *small[k]]))
    force = rows["base_linacc"]
    out = {
        "time": rows["time"],
        "joint_names": np.array(robot.joints),
        "qpos": sensors.encoder * np.round(rows["qpos"] / sensors.encoder),
        "qpos_target": rows["qpos_target"],
        "kp": robot.kp,
        "kd": robot.kd,
        "base_quat": quat / np.linalg.norm(quat, axis=1, keepdims=True),
        "base_angvel": rows["base_angvel"] + sensors.gyro * noise(rows["base_angvel"]),
        "base_linacc": force + bias + sensors.accelerometer * noise(force),
        "imu_body": np.array(robot.trunk),
        "imu_pos": robot.imu,
    }
    if s["torque"]:
        out["tau"] = rows["tau"] + sensors.torque * noise(rows["tau"])
        held = s["rate_hz"] == s["loop_hz"]
        out["tau_kind"] = np.array("commanded" if held else "current")
    if s["flags"]:
        out["contact_bodies"] = np.array(robot.feet)
        out["contact_flag"] = (rows["load"] > 5.0).astype(float)
    return out


def _nominal(robot: Walker, real: Real) -> str:
    """The drawing with every joint's friction and rotor in it."""
    spec = mujoco.MjSpec.from_string(robot.xml)
    for k, name in enumerate(robot.joints):
        joint = spec.joint(name)
        set_linear(joint, "damping", float(real.damping[k]))
        joint.frictionloss, joint.armature = float(real.dry[k]), float(real.armature[k])
    spec.compile()
    return spec.to_xml()


def _truth(robot: Walker, real: Real, s: dict, kind: str, log: dict) -> dict:
    own = mujoco.MjModel.from_xml_string(robot.xml)
    weight = float(own.body_mass.sum())
    effects = []
    if real.load is not None:
        # A scale tells the load and what bodies weigh more than drawn: nobody can tell these apart.
        more = sum(x["mass"] * own.body(b).mass[0] for b, x in real.inertials.items())
        mass, place, _ = real.load
        parameters = {
            "mass": {"value": float(mass + more), "unit": "kg"},
            "own_mass": {"value": mass, "unit": "kg"},
            "com": {"value": [float(x) for x in place], "unit": "m"},
        }
        effects = [
            {"family": "payload", "location": {"kind": "body", "name": robot.trunk}, "equivalent": [],
             "parameters": parameters, "visibility": {"sigmas": float(mass / (TRUST * weight))}}
        ]  # fmt: skip
    numbers = {k: getattr(real, k) for k in ("armature", "damping", "dry", "presliding")}
    said = {"payload": "alone", "payload_bare": "single"}
    return {
        "schema": 1, "stratum": STRATUM, "robot": robot.name, "engine": "mujoco", "kind": said.get(kind, kind),
        "effects": effects, "mass": weight, "inertials": real.inertials,
        "joints": {k: dict(zip(robot.joints, map(float, x), strict=True)) for k, x in numbers.items()},
        "seconds": float(log["time"][-1]), **s,
    }  # fmt: skip
