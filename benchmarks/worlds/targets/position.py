"""The position-controlled robots of a mixed examination: any robot of the fleet, or one's own, with a position loop.

Log `number` of a stratum goes the generator's own round: sound, ordinary physics alone, one odd effect or number
(three of six), two. What theory calls the same there is stated, and how visible each effect is: what ordinary numbers
of its joint cannot absorb, over what the encoder and a clock of a millisecond leave unsaid.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from benchmarks.worlds.as_bought import Made
from benchmarks.worlds.robots import Robot as Bought
from benchmarks.worlds.targets.drawn import ATTEMPTS, Drawn, drawn, without_torque
from benchmarks.worlds.targets.plant import Robot, Truth, Unstable

STRATA = ("position", "position_torque")
SECONDS = 9.0  # of both runs
CLOCK, SEEN_IN, ALIKE = 1e-3, 6.0, 1.0  # s
AT_RATED = 0.2  # rad by which a joint lags that needs its rated torque
SLOWEST, FASTEST = 12.0, 60.0  # rad/s: bandwidths of a loop
SWING = 0.4  # of the range, either way


def make(number: int, seed: list[int], torque: bool, bought: Bought) -> Made:
    """Both logs of robot `number`, with torque or without; RuntimeError where every draw flies off."""
    robot = told_positions(bought)
    for attempt in range(ATTEMPTS):
        try:
            one = drawn(number, np.random.default_rng([*seed, attempt]), robot, SECONDS)
            if torque:
                # A torque is held from its row to the next, as the protocol says of commanded ones.
                one.log_hz = one.loop_hz
            logs = [one.log(which) for which in (0, 1)]
            truth = described(one, logs[0])
        except Unstable:
            continue
        logs = logs if torque else [without_torque(x) for x in logs]
        return Made(*logs, one.robot.xml, truth)
    raise RuntimeError(f"position {number}: every attempt flew off")


def described(one: Drawn, log: dict[str, np.ndarray]) -> dict:
    """truth.json: each effect with its ties and its visibility."""
    truth = one.said() | {"seconds": float(log["time"][-1])}
    after = log
    for k in reversed(range(len(one.entries))):
        before = one.log(0, k)
        entry = one.entries[k]
        kind, name = entry.pop("kind"), entry.pop("name")
        entry["location"] = {"kind": kind, "name": name}
        entry["equivalent"] = equivalents(entry, one.robot)
        entry["visibility"] = {"sigmas": sigmas(one, k, before, after)}
        after = before
    return truth


def equivalents(entry: dict, robot: Robot) -> list[dict]:
    """What no log of positions tells from an effect."""
    family, (only, *more) = entry["family"], robot.joints
    if more:
        return []
    joint = {"kind": "joint", "name": only}
    if family == "target_delay":
        return [{"family": family, "location": joint}]
    if family == "payload":
        # Inertia and weight in proportion: the same motion as of gains, friction and rotor that are less.
        return [{"family": "kp_scale", "location": joint}]
    return []


def sigmas(one: Drawn, k: int, before: dict, after: dict) -> float:
    """Of effect `k`: the change that no ordinary number of its joint makes, over what is uncertain there.

    As `worlds/truth` has it: what is uncertain is alike over a second, so that a log has as many samples as seconds.
    """
    rows = np.flatnonzero(after["time"] < SEEN_IN)
    was, now, time = before["qpos"][rows], after["qpos"][rows], after["time"][rows]
    change, speed = now - was, np.gradient(now, time, axis=0)
    loose = np.hypot(one.counts / np.sqrt(12.0), CLOCK * np.sqrt(np.mean(speed**2, axis=0)))
    steps = _ordinary_steps(one, k)
    like = [(one.run(x, 0, SEEN_IN)["qpos"][rows] - was) / loose for x in steps]
    columns = np.stack([x.ravel() for x in like], axis=1)
    y = (change / loose).ravel()
    left = y - columns @ np.linalg.lstsq(columns, y, rcond=1e-9)[0]
    independent = (after["time"][-1] - after["time"][0]) / ALIKE
    return float(np.sqrt(np.mean(left.reshape(change.shape) ** 2, axis=0).sum() * independent))


def _ordinary_steps(one: Drawn, k: int) -> list[Truth]:
    """The robot before effect `k` with each ordinary number of that joint a little off, but the effect's own."""
    truth, entry, robot = one.truths[k], one.entries[k], one.robot
    names = {"joint": robot.joints, "body": robot.bodies}.get(entry["location"]["kind"], ())
    j = names.index(entry["location"]["name"]) if names else 0
    kp, kd = robot.kp[j], robot.kd[j]
    steps = {
        "armature": ("armature", 0.1 * kd**2 / kp),
        "viscous_friction": ("damping", 0.1 * kd),
        "coulomb_friction": ("dry", 0.01 * kp),
        "encoder_offset": ("offset", 0.01),
        "kp_scale": ("kp", 0.05 * kp),
        "target_delay": ("delay", 0.003),
    }
    out = []
    for family, (name, step) in steps.items():
        if family != entry["family"]:
            whole = getattr(truth, name).copy()
            whole[j] += step
            out.append(replace(truth, **{name: whole}))
    return out


def told_positions(bought: Bought) -> Robot:
    """A robot with a position loop that holds its weight and suits its inertia."""
    model = bought.model()
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    middle = 0.5 * (bought.lower + bought.upper)
    data.qpos[:] = middle
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    inertia = np.diagonal(full)
    kp = np.clip(bought.peak / AT_RATED, inertia * SLOWEST**2, inertia * FASTEST**2)
    swing = SWING * (bought.upper - bought.lower)
    return Robot(
        name=bought.name,
        xml=bought.xml,
        joints=bought.joints,
        bodies=bought.bodies,
        kp=kp,
        kd=1.4 * np.sqrt(kp * inertia),
        middle=middle,
        swing=swing,
        fastest=float(np.clip(np.min(bought.max_speed / (2 * np.pi * swing)), 0.5, 2.0)),
    )
