"""The setting of one log of a robot as bought: robot, motions, rates, sensors, and the maker's loop."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.worlds.joint_physics import Law
from benchmarks.worlds.plant import Noise
from benchmarks.worlds.robots import CAD_ROBOTS, Robot

NUMBER = 20  # of this stratum, in the seeds
MUJOCO, PINOCCHIO = ENGINES = ("mujoco", "pinocchio")
"""What plays the world: `plant` with `joint_physics`' bristles, or `pinocchio_plant` with its slipping springs."""


@dataclass
class Setting:
    """One log's robot, motions, rates and sensors."""

    robot: Robot
    seed: list[int]
    rate: int
    duration: float
    test_duration: float
    kinds: tuple[str, str]
    bandwidth: float
    compensation: float
    counts: float
    options: dict
    good: bool = False
    """The nominal model has every joint's friction and rotor."""
    engine: str = MUJOCO
    window: tuple[float, float] | None = None
    """Sigmas that an odd effect is to have; drawn again outside of it, `as_bought.FURTHER` times at most."""
    validation: bool = False
    """A third run, as long as the other motion."""
    mount: np.ndarray | None = None
    """Gravity as it really is, in the base's axes [m/s²]; None: as the model has it."""

    @property
    def real(self) -> Robot:
        """The drawing, mounted as it really is."""
        if self.mount is None:
            return self.robot
        spec = mujoco.MjSpec.from_string(self.robot.xml)
        spec.option.gravity = self.mount
        spec.compile()
        return dataclasses.replace(self.robot, xml=spec.to_xml())


class JointLoop:
    """The maker's loop: nominal feed-forward, gains that suit the real inertia, part of the friction compensated.

    A joint that is mostly friction is held stiffer than its inertia asks for: full friction moves it 0.06 rad.
    """

    def __init__(self, s: Setting, inertia: np.ndarray, law: Law):
        self.model = s.real.model()
        self.data = mujoco.MjData(self.model)
        omega = s.bandwidth
        stiff = (law.coulomb + law.viscous) * omega / (12.0 * 0.06)
        self.kp = np.maximum(inertia * omega**2, stiff)
        self.kd = 1.6 * np.sqrt(self.kp * inertia)
        self.rub, self.limit = s.compensation * law.coulomb, 1.5 * s.robot.peak

    def __call__(self, k: int, t: float, q, v, base, target):
        q_ref, v_ref, a_ref = target
        d = self.data
        d.qpos[:], d.qvel[:], d.qacc[:] = q_ref, v_ref, a_ref
        mujoco.mj_inverse(self.model, d)
        tau = d.qfrc_inverse + self.kp * (q_ref - q) + self.kd * (v_ref - v)
        tau += self.rub * np.tanh(v_ref / 0.05)
        return np.clip(tau, -self.limit, self.limit), q_ref


Robots = dict[str, Callable[[], Robot]]


def draw_setting(seed: int, index: int, robots: Robots = CAD_ROBOTS) -> Setting:
    """Robot, motions, rate and sensors of one log."""
    rng = np.random.default_rng([seed, NUMBER, index, 0])
    names = tuple(robots)
    # The robots go round, so that a short set holds all of them.
    turn = np.random.default_rng([seed, NUMBER]).permutation(names)
    return Setting(
        robot=robots[str(turn[index % len(turn)])](),
        seed=[seed, NUMBER, index],
        rate=int(rng.choice([1000, 500, 250], p=[0.4, 0.35, 0.25])),
        duration=20.0,
        test_duration=float(rng.uniform(10.0, 15.0)),
        kinds=("exciting", str(rng.choice(["exciting", "ordinary"], p=[0.6, 0.4]))),
        bandwidth=float(rng.uniform(9.0, 15.0)),
        compensation=float(rng.uniform(0.4, 0.9)),
        counts=float(2 ** rng.integers(16, 21)) if rng.random() < 0.4 else 0.0,
        options={
            "tau_kind": str(rng.choice(["commanded", "current"], p=[0.6, 0.4])),
            "qvel": bool(rng.random() < 0.6),
            "sigma": bool(rng.random() < 0.5),
            "shuffle": bool(rng.random() < 0.2),
        },
    )


def draw_noise(s: Setting, scale: np.ndarray) -> Noise:
    """Encoders of 1e-5 to 1e-4 rad, torques of 0.2 to 0.5 % of the peak, as in the other strata."""
    rng = np.random.default_rng([*s.seed, 1])
    n = len(s.robot.joints)
    qpos = np.exp(rng.uniform(np.log(1e-5), np.log(1e-4))) * np.ones(n)
    qvel = qpos * rng.uniform(15.0, 40.0)
    tau = rng.uniform(0.002, 0.005) * scale
    pair = (np.zeros(n), tau) if s.options["tau_kind"] == "commanded" else (tau, np.zeros(n))
    return Noise(qpos, qvel, *pair, np.zeros(12), np.zeros(6))
