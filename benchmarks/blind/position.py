"""The position-controlled robots of a mixed examination: those of `../replay`, or one's own with a position loop.

Log `number` of a stratum goes the generator's own round: sound, ordinary physics alone, one odd effect or number
(three of six), two. What theory calls the same there is stated, and how visible each effect is: its rms on the joint
that shows it best, over what the encoder and a clock of a millisecond leave unsaid.
"""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1]))
sys.path.append(str(Path(__file__).resolve().parents[1] / "gap"))

from cad import Made
from replay.generate import ATTEMPTS, Drawn, drawn, without_torque
from replay.plant import Unstable
from replay.robots import Robot
from robots import Robot as Bought

STRATA = ("position", "position_torque")
CLOCK = 1e-3  # s
AT_RATED = 0.2  # rad by which a joint lags that needs its rated torque
SLOWEST, FASTEST = 12.0, 60.0  # rad/s: bandwidths of a loop
SWING = 0.4  # of the range, either way


def make(number: int, seed: list[int], torque: bool, bought: Bought | None = None) -> Made:
    """Both logs of robot `number`, with torque or without; RuntimeError where every draw flies off."""
    robot = None if bought is None else told_positions(bought)
    for attempt in range(ATTEMPTS):
        try:
            one = drawn(number, np.random.default_rng([*seed, attempt]), robot)
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
        entry["visibility"] = {"sigmas": sigmas(before, after, one.counts)}
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


def sigmas(before: dict, after: dict, counts: float) -> float:
    """Rms of what an effect changes, over what is uncertain there, on the joint that shows it best."""
    change = np.sqrt(np.mean((after["qpos"] - before["qpos"]) ** 2, axis=0))
    speed = np.gradient(after["qpos"], after["time"], axis=0)
    loose = np.hypot(counts / np.sqrt(12.0), CLOCK * np.sqrt(np.mean(speed**2, axis=0)))
    return float((change / loose).max())


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
