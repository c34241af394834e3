"""The setting of one log: robot, motions, rate, noise, an imperfect model; and the log's format."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np
from control import Balance, ComputedTorque
from effects import Effect
from friction import KnownFriction
from motions import make_motion
from plant import PREROLL, Noise, Plant, disturb_base
from robots import ROBOTS, Robot
from strata import Stratum
from twomass import TwoMass


@dataclass
class Spec:
    """Everything about one log but its effects.

    `presliding`: the nominal friction loss is real, with bristles of this travel (rad); None leaves
    it to MuJoCo's soft constraint.
    """

    robot: Robot
    seed: list[int]
    rate: int
    duration: float
    test_duration: float
    kinds: tuple[str, str]
    bandwidth: float
    loud: bool
    wrong: bool
    noise: Noise | None = None
    preroll: float = PREROLL
    presliding: float | None = None
    options: dict = field(default_factory=dict)


def draw_spec(stratum: Stratum, seed: int, index: int) -> Spec:
    rng = np.random.default_rng([seed, stratum.number, index, 0])
    name = "quadruped" if stratum.legged else str(rng.choice(["arm7", "arm2"], p=[0.75, 0.25]))
    robot = ROBOTS[name]()
    if robot.floating:
        kinds = tuple(rng.choice(["squat", "sway", "trot"], 2, p=[0.35, 0.35, 0.3]))
        rate = int(rng.choice([500, 1000], p=[0.8, 0.2]))
    else:
        first = "ordinary" if rng.random() < stratum.ordinary else "exciting"
        other = {"ordinary": "exciting", "exciting": "ordinary"}[first]
        kinds = (first, first if rng.random() < 0.7 else other)
        rate = int(rng.choice([1000, 500, 250], p=[0.7, 0.18, 0.12]))
    return Spec(
        robot=robot,
        seed=[seed, stratum.number, index],
        rate=rate,
        duration=8.0 if robot.floating else 10.0,
        test_duration=7.0,
        kinds=(str(kinds[0]), str(kinds[1])),
        bandwidth=float(rng.uniform(10.0, 15.0)),
        loud=bool(rng.random() < stratum.loud),
        wrong=bool(rng.random() < stratum.wrong),
        presliding=float(10 ** rng.uniform(-4, -3)) if rng.random() < 0.6 else None,
        options={
            "tau_kind": str(rng.choice(["commanded", "current", "sensor"], p=[0.5, 0.35, 0.15])),
            "qvel": bool(rng.random() < 0.7),
            "sigma": bool(rng.random() < 0.7),
            "extras": bool(rng.random() < 0.5),
            "shuffle": bool(rng.random() < 0.2),
        },
    )


def draw_noise(spec: Spec, peak: np.ndarray) -> Noise:
    """Encoders of 1e-5 to 1e-4 rad, torques of 0.2 to 0.5 % of the peak; four times if loud."""
    rng = np.random.default_rng([*spec.seed, 1])
    robot, factor = spec.robot, 4.0 if spec.loud else 1.0
    n = len(robot.joints)
    qpos = factor * np.exp(rng.uniform(np.log(1e-5), np.log(1e-4))) * np.ones(n)
    qvel = qpos * rng.uniform(15.0, 40.0)
    tau = factor * rng.uniform(0.002, 0.005) * np.maximum(peak, 0.1 * robot.peak)
    base = factor * np.repeat([2e-4, 2e-4, 3e-3, 3e-3], 3) * rng.uniform(0.5, 1.0)
    wrench = factor * np.repeat([0.25, 0.004], 3) * rng.uniform(0.6, 1.5)
    silent = np.zeros(n)
    # A commanded torque is logged exactly; what the drive adds to it is the noise.
    if spec.options["tau_kind"] == "commanded":
        return Noise(qpos, qvel, silent, tau, base, wrench)
    return Noise(qpos, qvel, tau, silent, base, wrench)


def slightly_wrong(spec: Spec) -> mujoco.MjModel:
    """The real robot's model: the nominal one with 1 % masses, 1 mm centres, 5-10 % damping."""
    model = spec.robot.model()
    if not spec.wrong:
        return model
    rng = np.random.default_rng([*spec.seed, 2])
    for body in range(1, model.nbody):
        factor = 1.0 + rng.uniform(-0.01, 0.01)
        model.body_mass[body] *= factor
        model.body_inertia[body] *= factor
        model.body_ipos[body] += rng.uniform(-1e-3, 1e-3, 3)
    level = rng.uniform(0.05, 0.10)
    model.dof_damping[:] *= 1.0 + rng.uniform(-level, level, model.nv)
    return model


def known_friction(spec: Spec, model: mujoco.MjModel, effects: list[Effect]) -> list[Effect]:
    """Bristles in the place of the model's friction loss, where the draw says so."""
    if spec.presliding is None:
        return []
    # A two-mass joint takes its friction to the motor itself.
    taken = {e.name for e in effects if isinstance(e, TwoMass)}
    levels = {j: float(model.joint(j).frictionloss[0]) for j in spec.robot.joints}
    return [
        KnownFriction("joint", j, {"coulomb": level, "presliding": spec.presliding})
        for j, level in levels.items()
        if level > 0.0 and j not in taken
    ]


def simulate(spec: Spec, effects: list[Effect], which: int, duration: float) -> dict:
    """One clean log (with the noise beside it) of motion 0 (log) or 1 (test)."""
    robot = spec.robot
    motion = make_motion(robot, spec.kinds[which], [*spec.seed, 3, which])
    model = slightly_wrong(spec)
    plant = Plant(robot, model, effects + known_friction(spec, model, effects))
    if robot.floating:
        controller = Balance(robot, motion)
        start = (controller.start(), np.zeros(plant.model.nv))
    else:
        controller = ComputedTorque(robot, spec.bandwidth)
        start = motion(-spec.preroll)[:2]
    rng = np.random.default_rng([*spec.seed, 4, which])
    noise = spec.noise or Noise.none(len(robot.joints))
    return plant.run(controller, motion, start, spec.rate, duration, noise, rng, spec.preroll)


def to_contract(spec: Spec, log: dict, duration: float) -> dict[str, np.ndarray]:
    """The log as the diagnosis gets it: noisy, cut to length, with the arrays of the contract."""
    rows, noise, o = round(duration * spec.rate), log["noise"], spec.options
    order = np.arange(len(spec.robot.joints))
    if o["shuffle"]:
        order = np.random.default_rng([*spec.seed, 5]).permutation(order)
    out = {
        "time": log["time"],
        "qpos": (log["qpos"] + noise["qpos"])[:, order],
        "tau": (log["tau"] + noise["tau"])[:, order],
    }
    if o["qvel"]:
        out["qvel"] = (log["qvel"] + noise["qvel"])[:, order]
    if o["extras"]:
        out["qpos_target"], out["tau_command"] = log["qpos_target"][:, order], log["tau"][:, order]
    if spec.robot.floating:
        pairs = zip(log["base"], noise["base"], strict=True)
        base = np.array([disturb_base(b, e) for b, e in pairs])
        out["base_pos"], out["base_quat"] = base[:, :3], base[:, 3:7]
        out["base_linvel"], out["base_angvel"] = base[:, 7:10], base[:, 10:]
        out["contact_wrench"] = log["contact_wrench"] + noise["wrench"]
    out = {name: np.ascontiguousarray(x[:rows]) for name, x in out.items()}
    out["joint_names"] = np.array(spec.robot.joints)[order]
    out["tau_kind"] = np.array(o["tau_kind"])
    if spec.robot.floating:
        out["contact_bodies"] = log["contact_bodies"]
    if o["sigma"]:
        out["sigma_qpos"] = spec.noise.qpos[order]
        out["sigma_tau"] = np.hypot(spec.noise.tau, spec.noise.ripple)[order]
    return out
