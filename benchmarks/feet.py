"""Robots on their feet that log encoders, torques and an IMU, and no contact force: what is found, in how many seconds.

    python -m benchmarks.feet OUT                 # makes the logs of `PLAN` and diagnoses each
    python -m benchmarks.feet OUT --weigh         # mass and centre of the trunk instead, by `estimate`

Robots, controller and sensors are of this file alone. MuJoCo C at 0.5 ms. Controller at 500 Hz: forces of the standing
feet that balance the trunk (least squares, virtual springs on height and attitude), through Jᵀ, and joint springs about
inverse kinematics. Each joint has LuGre friction [Canudas de Wit et al., IEEE TAC 40(3), 1995], exact over a step; the
model has its level. The ground is harder than the model's.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.worlds.feet.standing import foot_loads

STEP, LOOP, WARM = 5e-4, 4, 1.5  # s, steps of a period of the controller and of the log, s
HARD = "0.006 1"
"""`solref` of the plant's feet; the model has MuJoCo's 0.02."""
MOTIONS = ("sway", "squat", "trot")
HIDDEN = ("sound", "payload", "friction", "rotors", "tilt")
LOAD, PLACE = 2.0, np.array([0.12, -0.06, 0.18])  # kg, m on the trunk
TILT = np.radians(2.0)
MORE_FRICTION, MORE_ROTOR = 1.0, 1.0
"""What every joint has beyond the model, of the model's own."""


@dataclass(frozen=True)
class Robot:
    """Legs of a robot: hips on the trunk (x, y), lengths of thigh and shank; lengths in m, masses in kg."""

    name: str
    hips: dict[str, tuple[float, float]]
    thigh: float
    shank: float
    trunk: float
    leg: tuple[float, float, float]
    sole: tuple[float, float, float] | None = None
    """Half sizes of a box under an ankle of two axes; none for a ball."""
    welded: bool = False
    """Whether feet are bodies of their own, welded to the shanks."""
    rotor: float = 0.01
    dry: float = 0.3

    @property
    def height(self) -> float:
        """Of the hips over the ankles, as it stands."""
        return 0.82 * (self.thigh + self.shank)

    @property
    def aside(self) -> float:
        return 0.0 if self.sole else 0.08

    @property
    def mass(self) -> float:
        return self.trunk + len(self.hips) * sum(self.leg)

    @property
    def feet(self) -> tuple[str, ...]:
        """Bodies that touch the ground."""
        link = "foot" if self.sole or self.welded else "shank"
        return tuple(f"{leg}_{link}" for leg in self.hips)

    def xml(self, solref: str = "0.02 1") -> str:
        legs = "".join(self._leg(leg, solref) for leg in self.hips)
        x, y = (max(abs(v[k]) for v in self.hips.values()) + 0.04 for k in (0, 1))
        z = 0.25 if self.sole else 0.06
        up = 0.8 * z if self.sole else 0.005
        i = self.trunk / 3 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
        return f"""<mujoco model="{self.name}">
  <compiler angle="radian"/>
  <option timestep="{STEP}" integrator="implicitfast" cone="elliptic"/>
  <default>
    <joint armature="{self.rotor}" damping="{self.dry / 10}" frictionloss="{self.dry}"/>
    <geom mass="0" friction="0.8 0.02 0.001"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="9 9 1"/>
    <body name="trunk" pos="0 0 {self.height + 0.3}">
      <freejoint/>
      <inertial pos="0.01 -0.002 {up}" mass="{self.trunk}" diaginertia="{_text(i)}"/>
      <geom type="box" size="{x} {y} {z}" pos="0 0 {up}"/>
      <site name="imu" pos="-0.03 0.01 0.04"/>{legs}
    </body>
  </worldbody>
  <sensor><accelerometer name="acc" site="imu"/><gyro name="gyro" site="imu"/></sensor>
</mujoco>"""

    def _leg(self, leg: str, solref: str) -> str:
        (x, y), (m, n, k) = self.hips[leg], self.leg
        side, a, b = np.sign(y), self.thigh, self.shank
        touch = f'friction="0.8 0.02 0.001" solref="{solref}"'
        if self.sole:
            size = np.array(self.sole)
            end = f"""<body name="{leg}_ankle" pos="0 0 {-b}">{_inertial(0.1 * k, (0, 0, 0), 0.02)}
              <joint name="{leg}_ankle_pitch" axis="0 1 0"/>
              <body name="{leg}_foot">{_inertial(0.3 * k, (0.02, 0, -0.03), 0.05)}
                <joint name="{leg}_ankle_roll" axis="1 0 0"/><site name="{leg}" pos="0 0 -0.05"/>
                <geom type="box" size="{_text(size)}" pos="0.03 0 {size[2] - 0.05}" {touch}/></body></body>"""
            k = 0.6 * k
        else:
            end = f'<geom type="sphere" size="0.022" pos="0 0 {-b}" {touch}/><site name="{leg}" pos="0 0 {-b}"/>'
            if self.welded:
                end = f'<body name="{leg}_foot">{_inertial(0.2 * k, (0, 0, -b), 0.02)}{end}</body>'
                k = 0.8 * k
        twist = f'<joint name="{leg}_yaw" axis="0 0 1"/>' if self.sole else ""
        return f"""
      <body name="{leg}_hip" pos="{x} {y} 0">{_inertial(m, (-0.01 * np.sign(x), 0.01 * side, 0), 0.04)}
        {twist}<joint name="{leg}_roll" axis="1 0 0"/>
        <geom type="cylinder" size="0.04 0.03" euler="1.5708 0 0"/>
        <body name="{leg}_thigh" pos="0 {side * self.aside} 0">
          {_inertial(n, (-0.005, -0.015 * side, -0.2 * a), 0.35 * a)}
          <joint name="{leg}_pitch" axis="0 1 0"/>
          <geom type="capsule" size="0.025" fromto="0 0 0 0 0 {-a}"/>
          <body name="{leg}_shank" pos="0 0 {-a}">{_inertial(k, (0.006, 0, -0.45 * b), 0.3 * b)}
            <joint name="{leg}_knee" axis="0 1 0"/>
            <geom type="capsule" size="0.012" fromto="0 0 0 0 0 {-0.9 * b}"/>{end}
          </body>
        </body>
      </body>"""


QUAD = {"FL": (0.19, 0.05), "FR": (0.19, -0.05), "RL": (-0.19, 0.05), "RR": (-0.19, -0.05)}
WIDE = {leg: (1.5 * x, 2.0 * y) for leg, (x, y) in QUAD.items()}
ROBOTS = {
    "dog": Robot("dog", QUAD, 0.21, 0.21, 6.5, (0.6, 1.0, 0.25)),
    "hound": Robot("hound", WIDE, 0.30, 0.31, 20.0, (1.8, 2.6, 0.8), welded=True, rotor=0.05, dry=0.8),
    "biped": Robot("biped", {"L": (0.0, 0.09), "R": (0.0, -0.09)}, 0.30, 0.30, 16.0, (1.5, 2.8, 2.4),
                   sole=(0.11, 0.045, 0.012), rotor=0.04, dry=0.8),
}  # fmt: skip
PLAN = (
    *(("dog", motion, hidden) for motion in MOTIONS for hidden in HIDDEN),
    *(("hound", "trot", "sound"), ("hound", "squat", "payload"), ("hound", "trot", "payload")),
    *(("biped", "sway", "sound"), ("biped", "squat", "payload")),
)


def _text(x) -> str:
    return " ".join(f"{v:.6g}" for v in np.ravel(x))


def _inertial(mass: float, centre, gyration: float) -> str:
    i = mass * gyration**2 * np.array([1.0, 1.05, 0.4])
    return f'<inertial pos="{_text(centre)}" mass="{mass:.6g}" diaginertia="{_text(i)}"/>'


def pose(robot: Robot, motion: str, t: float, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where trunk (x, y, z, roll, pitch, yaw) and feet (x, y, z) are from where they stand, at a time [s]."""
    fade = np.clip((t + WARM) / 1.0, 0.0, 1.0)
    sizes = {
        "sway": [0.025, 0.025, 0.012, 0.06, 0.05, 0.06],
        "squat": [0.012, 0.012, 0.05, 0.03, 0.05, 0.03],
        "trot": [0.0] * 6,
    }
    size = np.array(sizes[motion]) * [1.0, 1.0, 1.0, 1.0, 1.0, 0.0 if robot.sole else 1.0]
    wave = (
        2 * np.pi * np.array([[0.31, 0.42, 0.55, 0.37, 0.48, 0.27], [0.8, 0.7, 1.0, 0.9, 1.1, 0.6]])
    )
    trunk = fade * (size * robot.height / 0.34 * [[0.6], [0.4]] * np.sin(wave * t + phase)).sum(0)
    feet = np.zeros((len(robot.hips), 3))
    if motion == "trot":
        for k, leg in enumerate(robot.hips):
            s = (t / 0.52 + (0.0 if leg in ("FL", "RR") else 0.5)) % 1.0
            swing = s < 0.42
            ahead = s / 0.42 - 0.5 if swing else 0.5 - (s - 0.42) / 0.58
            feet[k] = fade * np.array(
                [0.07 * ahead, 0.0, 0.055 * np.sin(np.pi * s / 0.42) ** 2 * swing]
            )
    return trunk, feet


@dataclass
class Truth:
    """What the robot has that its model has not."""

    hidden: str

    def plant(self, robot: Robot) -> mujoco.MjModel:
        spec = mujoco.MjSpec.from_string(robot.xml(HARD))
        if self.hidden == "payload":
            load = spec.body("trunk").add_body(name="load", pos=PLACE)
            load.ipos = np.zeros(3)
            load.mass, load.inertia, load.explicitinertial = LOAD, [2e-3 * LOAD] * 3, True
        model = spec.compile()
        # Friction is the bristle's.
        model.dof_frictionloss[:] = 0.0
        model.dof_armature[6:] *= 1.0 + MORE_ROTOR * (self.hidden == "rotors")
        return model


def angles(robot: Robot, motion: str, times: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Joint angles that put the feet where they belong, by Gauss-Newton on the model's kinematics."""
    model = mujoco.MjModel.from_xml_string(robot.xml())
    data = mujoco.MjData(model)
    sites = [model.site(leg).id for leg in robot.hips]
    home = [
        np.array([x, y + np.sign(y) * robot.aside, -robot.height - 0.05 * bool(robot.sole)])
        for x, y in robot.hips.values()
    ]
    for k in range(model.njnt):
        name = model.joint(k).name
        start = {"pitch": 0.6, "knee": -1.2, "ankle_pitch": 0.6}
        for end, value in start.items():
            if name.endswith(f"_{end}") and not (end == "pitch" and "ankle" in name):
                data.qpos[model.jnt_qposadr[k]] = value
    out, jac, turn = [], np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for t in times:
        trunk, feet = pose(robot, motion, t, phase)
        data.qpos[:3] = trunk[:3]
        mujoco.mju_euler2Quat(data.qpos[3:7], trunk[3:], "xyz")
        for _ in range(20 if not out else 4):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            error, rows = [], []
            for site, at, foot in zip(sites, home, feet, strict=True):
                mujoco.mj_jacSite(model, data, jac, turn, site)
                error.append(at + foot - data.site_xpos[site])
                rows.append(jac[:, 6:].copy())
                if robot.sole:
                    upright = data.site_xmat[site].reshape(3, 3)
                    error.append(-0.5 * np.array([upright[2, 1] - upright[1, 2], upright[0, 2] - upright[2, 0],
                                                  upright[1, 0] - upright[0, 1]]))  # fmt: skip
                    rows.append(turn[:, 6:].copy())
            j = np.concatenate(rows)
            step = j.T @ np.linalg.solve(j @ j.T + 1e-6 * np.eye(len(j)), np.concatenate(error))
            data.qpos[7:] += np.clip(step, -0.2, 0.2)
        out.append(data.qpos[7:].copy())
    return np.array(out)


def simulated(robot: Robot, motion: str, hidden: str, seconds: float, seed: int) -> dict[str, Any]:
    """The log's arrays by name, and `true_force` of each foot [N]; RuntimeError where the robot falls."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, (2, 6))
    truth = Truth(hidden)
    model = truth.plant(robot)
    data = mujoco.MjData(model)
    sites = [model.site(leg).id for leg in robot.hips]
    feet = [model.body(name).id for name in robot.feet]
    times = np.arange(-WARM, seconds, STEP * LOOP)
    wanted = angles(robot, motion, times, phase)
    speeds = np.gradient(wanted, STEP * LOOP, axis=0)
    data.qpos[7:] = wanted[0]
    mujoco.mj_kinematics(model, data)
    data.qpos[2] -= data.site_xpos[sites, 2].min() - (0.0 if robot.sole else 0.022)
    level = float(data.qpos[2])
    dry = robot.dry * (1.0 + MORE_FRICTION * (hidden == "friction"))
    bristle, stiff = np.zeros(model.nv - 6), dry / 1e-3
    loss = 0.8 * np.sqrt(stiff * (model.dof_armature[6:] + 0.01))
    kp = 40.0 * (robot.mass / 14.0) * (robot.height / 0.34) * (8.0 if robot.sole else 1.0)
    kd = 0.035 * kp
    rows: dict[str, list] = {}
    for n, t in enumerate(times):
        trunk, lifted = pose(robot, motion, t, phase)
        mujoco.mj_step1(model, data)
        push = _stance(robot, model, data, sites, trunk, lifted, level)
        tau = kp * (wanted[n] - data.qpos[7:]) + kd * (speeds[n] - data.qvel[6:]) + push
        for k in range(LOOP):
            if k:
                mujoco.mj_step1(model, data)
            v = data.qvel[6:]
            rate = np.abs(v) / 1e-3 * STEP + 1e-12
            new = bristle * np.exp(-rate) + v * STEP * -np.expm1(-rate) / rate
            rub = stiff * new + loss * np.exp(-((v / 0.02) ** 2)) * (new - bristle) / STEP
            bristle = new
            data.qfrc_applied[6:] = tau - rub
            row = {"time": t, "qpos": data.qpos[7:], "tau": tau, "base_quat": data.qpos[3:7],
                   "base_angvel": data.sensor("gyro").data}  # fmt: skip
            row = {name: np.copy(x) for name, x in row.items()}
            mujoco.mj_step2(model, data)
            if not k and t >= -1e-9:
                row["base_linacc"] = data.sensor("acc").data.copy()
                row["true_force"] = foot_loads(model, data, feet)
                for name, x in row.items():
                    rows.setdefault(name, []).append(x)
        if data.qpos[2] < 0.6 * level or data.xmat[1][8] < 0.85:
            raise RuntimeError(f"{robot.name} fell in its {motion} at {t:.2f} s")
    return _sensed(robot, {name: np.array(x) for name, x in rows.items()}, hidden, rng)


def _stance(robot, model, data, sites, trunk, lifted, level) -> np.ndarray:
    """Torques of the forces by which standing feet balance the trunk, as the controller believes it."""
    standing = lifted[:, 2] < 1e-6
    weight, turned = 9.81 * robot.mass, np.zeros(3)
    mujoco.mju_quat2Vel(turned, data.qpos[3:7], 1.0)
    goal = np.array(
        [
            0.0,
            0.0,
            weight
            + 20 * robot.mass * (level + trunk[2] - data.qpos[2])
            - 3 * robot.mass * data.qvel[2],
        ]
    )
    spring = robot.mass * robot.height**2
    moment = (
        15 * spring * (trunk[3:] - turned)
        - 3 * spring * data.xmat[1].reshape(3, 3) @ data.qvel[3:6]
    )
    centre = data.xipos[1]
    arms = data.site_xpos[sites] - centre
    grasp = np.zeros((6, 3 * len(sites)))
    for k, arm in enumerate(arms):
        if standing[k]:
            grasp[:3, 3 * k : 3 * k + 3] = np.eye(3)
            grasp[3:, 3 * k : 3 * k + 3] = [
                [0, -arm[2], arm[1]],
                [arm[2], 0, -arm[0]],
                [-arm[1], arm[0], 0],
            ]
    force = np.linalg.lstsq(grasp, np.concatenate([goal, moment]), rcond=1e-3)[0].reshape(-1, 3)
    out, jac = np.zeros(model.nv), np.zeros((3, model.nv))
    for site, f in zip(sites, force, strict=True):
        mujoco.mj_jacSite(model, data, jac, None, site)
        out -= jac.T @ f
    return out[6:]


def _sensed(robot: Robot, rows: dict, hidden: str, rng) -> dict[str, Any]:
    """15-bit encoders; noise of torque, gyro, accelerometer (and its bias) and attitude; an IMU that is not level."""

    def noise(like):
        return rng.standard_normal(like.shape)

    bit, peak = 2 * np.pi / 2**15, np.abs(rows["tau"]).max()
    axis = rng.standard_normal(3) * [1.0, 1.0, 0.0]
    mount = np.zeros(4)
    angle = TILT * (hidden == "tilt")
    mujoco.mju_axisAngle2Quat(mount, axis / np.linalg.norm(axis), angle)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, mount)
    turn = turn.reshape(3, 3)
    small = np.column_stack([np.ones(len(rows["time"])), 0.001 * noise(rows["base_angvel"])])
    quat, half = np.empty_like(rows["base_quat"]), np.empty(4)
    for k, clean in enumerate(rows["base_quat"]):
        mujoco.mju_mulQuat(half, clean, mount)
        mujoco.mju_mulQuat(quat[k], half, small[k])
    felt = rows["base_linacc"] @ turn
    return {
        "time": rows["time"],
        "joint_names": np.array(_joints(robot)),
        "qpos": bit * np.round(rows["qpos"] / bit),
        "tau": rows["tau"] + 0.002 * peak * noise(rows["tau"]),
        "tau_kind": np.array("current"),
        "base_quat": quat / np.linalg.norm(quat, axis=1, keepdims=True),
        "base_angvel": rows["base_angvel"] @ turn + 0.005 * noise(rows["base_angvel"]),
        "base_linacc": felt + 0.05 * rng.choice([-1.0, 1.0], 3) + 0.06 * noise(felt),
        "imu_body": np.array("trunk"),
        "imu_pos": np.array([-0.03, 0.01, 0.04]),
        "true_force": rows["true_force"],
    }


def _joints(robot: Robot) -> list[str]:
    model = mujoco.MjModel.from_xml_string(robot.xml())
    return [model.joint(k).name for k in range(1, model.njnt)]


def made(out: Path, name: str, motion: str, hidden: str, seconds: float) -> tuple[Path, Path]:
    """Files of a log and of its model."""
    robot = ROBOTS[name]
    log, model = out / f"{name}_{motion}_{hidden}.npz", out / f"{name}.xml"
    model.write_text(robot.xml())
    if not log.exists():
        seed = 100 * PLAN.index((name, motion, hidden)) + 7
        np.savez(log, **simulated(robot, motion, hidden, seconds, seed))
    return log, model


FAMILIES = {"payload": {"payload"}, "friction": {"coulomb_friction", "viscous_friction"}, "rotors": {"armature"},
            "tilt": {"gravity_tilt"}, "sound": set()}  # fmt: skip
SURE = 0.9
"""Probability from which an effect that is not there is wrong and confident."""


def diagnosed(log: Path, model: Path, hidden: str) -> dict:
    """Verdict, effects, whether what is hidden was found and something else stated as sure, CPU seconds."""
    import jax_inertia as ji

    start = time.process_time()
    try:
        found = ji.to_report(ji.diagnose(ji.load_model(model), ji.read_log(log)))
    except ValueError as error:
        return {"refused": str(error), "cpu_s": time.process_time() - start}
    effects = found["effects"]
    wanted = FAMILIES[hidden]
    # What every joint has is found where most joints have it.
    least = 1 if hidden in ("payload", "tilt") else len(found["joints"]) // 2
    there = sum(e["family"] in wanted for e in effects) >= least if wanted else not effects
    wrong = any(e["family"] not in wanted and e["probability"] >= SURE for e in effects)
    keys = ("family", "location", "parameters", "probability")
    return {"verdict": found["verdict"], "found": there, "wrong": wrong,
            "effects": [{k: e[k] for k in keys} for e in effects],
            "cpu_s": time.process_time() - start}  # fmt: skip


def weighed(log: Path, model: Path, robot: Robot, hidden: str) -> dict:
    """Errors of the trunk's mass [%] and centre [mm] by `estimate`, their standard deviations, CPU seconds."""
    import jax_inertia as ji

    start = time.process_time()
    found = ji.estimate(ji.load_model(model), ji.read_log(log), ["trunk"])
    own = mujoco.MjModel.from_xml_string(robot.xml()).body("trunk")
    load = LOAD * (hidden == "payload")
    mass = float(own.mass[0]) + load
    centre = (own.mass[0] * own.ipos + load * PLACE) / mass
    pi, (sigma, of_centre) = np.asarray(found.pi["trunk"]), found.filter_sigma(0)
    return {
        "mass_percent": 100 * (float(pi[0]) / mass - 1),
        "sigma_percent": 100 * float(sigma[0]) / mass,
        "centre_mm": (1e3 * (pi[1:4] / pi[0] - centre)).round(1).tolist(),
        "sigma_mm": (1e3 * of_centre).round(1).tolist(),
        "cpu_s": time.process_time() - start,
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--only", default="", help="part of a log's name")
    parser.add_argument("--weigh", action="store_true", help="the trunk's mass and centre")
    parser.add_argument("--make", action="store_true", help="make the logs and stop")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    for name, motion, hidden in PLAN:
        if args.only not in f"{name}_{motion}_{hidden}":
            continue
        log, model = made(args.out, name, motion, hidden, args.seconds)
        if args.make:
            continue
        kind = "weighed" if args.weigh else "diagnosed"
        row = (
            weighed(log, model, ROBOTS[name], hidden)
            if args.weigh
            else diagnosed(log, model, hidden)
        )
        log.with_suffix(f".{kind}.json").write_text(json.dumps(row, indent=1) + "\n")
        print(log.stem, json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
