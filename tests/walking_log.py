"""Quadruped robots that are told positions, simulated in MuJoCo C, with the log that their sensors would write.

Robots, gaits and sensors are of this file alone: nothing of the package makes them.
"""

import dataclasses

import mujoco
import numpy as np

LEGS = ("FL", "FR", "RL", "RR")


@dataclasses.dataclass(frozen=True)
class Quadruped:
    """Lengths in m, masses in kg, of a robot whose legs are abduction, hip, knee."""

    trunk: float = 6.0
    thigh: float = 0.21
    shank: float = 0.22
    hip_x: float = 0.19
    hip_y: float = 0.05
    aside: float = 0.08
    leg: tuple[float, float, float] = (0.6, 0.9, 0.25)
    foot: float = 0.022
    kp: float = 70.0
    kd: float = 2.0
    dry: float = 0.15
    soft: float = 0.008
    """Time constant of the ground's contact [s]."""
    imu: tuple[float, float, float] = (-0.03, 0.01, 0.05)

    @property
    def height(self) -> float:
        """Of the trunk over ground as it stands [m]."""
        return 0.75 * (self.thigh + self.shank)

    @property
    def xml(self) -> str:
        legs = "".join(map(self._leg, LEGS))
        motors = "".join(
            f'<position name="{leg}_{j}_motor" joint="{leg}_{j}" kp="{self.kp}" kv="{self.kd}"/>'
            for leg in LEGS
            for j in ("abd", "hip", "knee")
        )
        x, y, z = 0.25 * self.trunk / 6 * np.array([0.05, 0.2, 0.22])
        return f"""<mujoco model="quadruped">
  <compiler angle="radian"/>
  <option timestep="0.0005" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <default>
    <geom contype="0" conaffinity="0"/>
    <joint type="hinge" damping="0.02" frictionloss="{self.dry}" armature="0.008"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="9 9 1" contype="1" conaffinity="1"/>
    <body name="trunk" pos="0 0 {self.height}">
      <freejoint/>
      <inertial pos="0.012 -0.002 0.004" mass="{self.trunk}" diaginertia="{x:.6f} {y:.6f} {z:.6f}"/>
      <geom type="box" size="{self.hip_x} 0.08 0.05" mass="0"/>
      <site name="imu" pos="{self.imu[0]} {self.imu[1]} {self.imu[2]}"/>{legs}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
  <sensor><accelerometer name="acc" site="imu"/><gyro name="gyro" site="imu"/></sensor>
</mujoco>"""

    def _leg(self, leg: str) -> str:
        front, left = (1 if leg[0] == "F" else -1), (1 if leg[1] == "L" else -1)
        m, n, k = self.leg
        return f"""
      <body name="{leg}_hip" pos="{front * self.hip_x} {left * self.hip_y} 0">
        <inertial pos="{-0.005 * front} {0.01 * left} 0" mass="{m}" diaginertia="0.0006 0.0008 0.0005"/>
        <joint name="{leg}_abd" axis="1 0 0"/>
        <body name="{leg}_thigh" pos="0 {left * self.aside} 0">
          <inertial pos="-0.003 {-0.015 * left} {-0.15 * self.thigh}" mass="{n}" diaginertia="0.004 0.004 0.0008"/>
          <joint name="{leg}_hip" axis="0 1 0"/>
          <body name="{leg}_shank" pos="0 0 {-self.thigh}">
            <inertial pos="0.005 0 {-0.6 * self.shank}" mass="{k}" diaginertia="0.0012 0.0012 0.00004"/>
            <joint name="{leg}_knee" axis="0 1 0"/>
            <geom name="{leg}" type="sphere" size="{self.foot}" pos="0 0 {-self.shank}" contype="1"
              conaffinity="1" mass="0" friction="0.8 0.02 0.001" solref="{self.soft} 1" condim="3"/>
          </body>
        </body>
      </body>"""

    def angles(self, foot: np.ndarray, leg: str) -> np.ndarray:
        """Joint angles that put the centre of a foot where it is in the hip's frame [m]."""
        left = 1 if leg[1] == "L" else -1
        x, y, z = foot
        down = np.sqrt(max(y * y + z * z - self.aside**2, 1e-6))
        roll = np.arctan2(y, -z) - np.arctan2(left * self.aside, down)
        reach = min(np.hypot(x, down), 0.999 * (self.thigh + self.shank))
        bend = (reach**2 - self.thigh**2 - self.shank**2) / (2 * self.thigh * self.shank)
        knee = -np.arccos(np.clip(bend, -1, 1))
        lead = np.arctan2(self.shank * np.sin(-knee), self.thigh + self.shank * np.cos(knee))
        return np.array([roll, np.arctan2(-x, down) + lead, knee])


@dataclasses.dataclass(frozen=True)
class Sensors:
    """Standard deviation of one sample, and steps."""

    encoder: float = 2 * np.pi / 2**15
    gyro: float = 0.005
    accelerometer: float = 0.08
    bias: float = 0.1
    """Of the accelerometer, on each axis [m/s²]."""
    tilt: float = 0.002
    """Of the attitude [rad]."""
    torque: float = 0.06
    """Step of the logged torque [N m]."""


def trot(robot: Quadruped, t: float, period: float = 0.5, lift: float = 0.06, stride: float = 0.08):
    """Targets of a trot, diagonal legs in turn."""
    out = []
    for leg in LEGS:
        phase = (t / period + (0.0 if leg in ("FL", "RR") else 0.5)) % 1.0
        swing = phase < 0.45
        s = phase / 0.45 if swing else (phase - 0.45) / 0.55
        x = stride * ((s - 0.5) if swing else (0.5 - s))
        z = lift * np.sin(np.pi * s) ** 2 if swing else 0.0
        out.append(_foot(robot, leg, x, 0.0, z))
    return np.concatenate(out)


def shifts(robot: Quadruped, t: float, size: float = 0.015):
    """Targets of a trunk that sways, squats and turns over four standing feet."""
    ramp = min(1.0, t)
    x = ramp * size * np.sin(2 * np.pi * 0.7 * t)
    y = ramp * size * np.sin(2 * np.pi * 0.53 * t + 1)
    z = ramp * size * np.sin(2 * np.pi * 1.1 * t + 2)
    pitch = ramp * 0.3 * size * np.sin(2 * np.pi * 0.83 * t)
    out = []
    for leg in LEGS:
        front = 1 if leg[0] == "F" else -1
        out.append(_foot(robot, leg, x, y, z + pitch * front))
    return np.concatenate(out)


def _foot(robot: Quadruped, leg: str, x: float, y: float, z: float) -> np.ndarray:
    left = 1 if leg[1] == "L" else -1
    at = np.array([x, left * robot.aside + y, z - robot.height + robot.foot])
    return robot.angles(at, leg)


def walked(
    robot: Quadruped,
    gait,
    *,
    seconds: float = 4.0,
    rate: float = 500.0,
    loop: float = 1000.0,
    policy: float = 50.0,
    load: float = 0.0,
    at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    sensors: Sensors = Sensors(),
    seed: int = 0,
) -> dict[str, np.ndarray]:
    """The log's arrays by name, and the truth under names that begin with `true_`; `load` [kg] at `at` on the trunk."""
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec.from_string(robot.xml)
    if load:
        body = spec.body("trunk").add_body(name="load", pos=at)
        body.mass, body.inertia, body.explicitinertial = load, [1e-3 * load] * 3, True
    model = spec.compile()
    data = mujoco.MjData(model)
    model.actuator_gainprm[:], model.actuator_biasprm[:] = 0, 0
    model.actuator_gainprm[:, 0] = 1
    step = model.opt.timestep
    each = {"loop": round(1 / loop / step), "log": round(1 / rate / step)}
    data.qpos[7:] = gait(robot, 0.0)
    warm = 1.5
    feet = [model.geom(leg).id for leg in LEGS]
    bias = sensors.bias * rng.choice([-1.0, 1.0], 3)
    rows: dict[str, list] = {}
    for k in range(round((warm + seconds) / step)):
        t = k * step
        held = np.floor(t * policy + 1e-9) / policy
        target = gait(robot, held)
        if k % each["loop"] == 0:
            data.ctrl[:] = robot.kp * (target - data.qpos[7:]) - robot.kd * data.qvel[6:]
        mujoco.mj_forward(model, data)
        if t >= warm and k % each["log"] == 0:
            _write(rows, model, data, target, t - warm, feet)
        mujoco.mj_step(model, data)
    out = {name: np.array(x) for name, x in rows.items()}
    return _sensed(out, model, sensors, bias, rng)


def _write(rows, model, data, target, t, feet):
    force = np.zeros(len(feet))
    for i in range(data.ncon):
        pair, wrench = data.contact[i].geom, np.zeros(6)
        mujoco.mj_contactForce(model, data, i, wrench)
        for j, foot in enumerate(feet):
            force[j] += wrench[0] * (foot in pair)
    for name, value in {
        "time": t,
        "qpos": data.qpos[7:],
        "qpos_target": target,
        "tau": data.ctrl,
        "base_quat": data.qpos[3:7],
        "base_angvel": data.sensor("gyro").data,
        "base_linacc": data.sensor("acc").data,
        "contact_force": force,
        "true_pos": data.qpos[:3],
        "true_linvel": data.qvel[:3],
        "true_linacc": data.qacc[:3],
    }.items():
        rows.setdefault(name, []).append(np.copy(value))


def _sensed(out, model, sensors: Sensors, bias, rng) -> dict[str, np.ndarray]:
    def noise(like):
        return rng.standard_normal(like.shape)

    out["qpos"] = sensors.encoder * np.round(out["qpos"] / sensors.encoder)
    out["tau"] = sensors.torque * np.round(out["tau"] / sensors.torque)
    out["base_angvel"] = out["base_angvel"] + sensors.gyro * noise(out["base_angvel"])
    out["base_linacc"] = (
        out["base_linacc"] + bias + sensors.accelerometer * noise(out["base_linacc"])
    )
    quat, small = out["base_quat"], 0.5 * sensors.tilt * noise(out["base_angvel"])
    turned = np.empty_like(quat)
    for k in range(len(quat)):
        mujoco.mju_mulQuat(turned[k], quat[k], np.array([1.0, *small[k]]))
    out["base_quat"] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    out["contact_flag"] = (out["contact_force"] > 5.0).astype(float)
    out["contact_bodies"] = np.array([f"{leg}_shank" for leg in LEGS])
    out["joint_names"] = np.array([model.joint(j).name for j in range(1, model.njnt)])
    out["tau_kind"], out["tau_unit"] = np.array("current"), np.array("N m")
    return out
