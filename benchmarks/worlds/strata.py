"""What a mixed examination holds: one log of a stratum, with all that was hidden.

| stratum | the nominal model | hidden |
|---|---|---|
| `sound` | friction and rotor of every joint in it | nothing |
| `one_effect` | the same | one effect of the library |
| `bare` | bodies alone, 2 % off | friction, rotor and offset of every joint |
| `bare_odd` | the same | and one effect more |
| `outside` | the same | and one that no library has |
| `misread` | the same | the log means something else than the model (`misread.py`) |
| `position` | bodies alone | a robot that is told positions, no torque: nothing, friction and more, effects |
| `position_torque` | the same | the same, with the torques of its motors |
| `imu` | as `sound`, or bodies alone | a robot on its feet without base pose and wrenches: nothing, friction, a load |

Some logs of `TWO_ENGINES` are Pinocchio's forward dynamics with another law of dry friction (`pinocchio_plant`),
all others are MuJoCo's; the truth says which. An odd effect is drawn again until the log shows it by 3 to 30 sigma.
Robots are `fleet`'s and those of `feet/legs`, or any that one names (`own_robot`). Some logs are of an ordinary
motion, some keep 50 or 100 rows a second of a loop that is faster, and every sixth comes with a validation run. A log
depends on the seed and its index alone.
"""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.worlds import fleet, odd
from benchmarks.worlds.as_bought import Made, simulated, write_folder
from benchmarks.worlds.feet import standing
from benchmarks.worlds.misread import FAULTS, misread, mount
from benchmarks.worlds.own_robot import own_robot, rated_torque
from benchmarks.worlds.robots import Robot, bare
from benchmarks.worlds.setting import ENGINES, MUJOCO, Robots, draw_setting
from benchmarks.worlds.targets import position

SHARES = {
    "sound": 0.11,
    "one_effect": 0.19,
    "bare": 0.11,
    "bare_odd": 0.21,
    "outside": 0.12,
    "misread": 0.08,
    "position": 0.09,
    "position_torque": 0.04,
    "imu": 0.05,
}
OUTSIDE = (*odd.OUTSIDE, *odd.FURTHER)
AT_WEIGHT = ("backlash", "joint_elasticity", "backlash", "joint_elasticity", "joint_coupling")
"""Come more often than other effects, as do delays and lags."""
ONE = (*odd.ODD, *AT_WEIGHT, "time_delay", "actuator_lag")
TWO_ENGINES = ("sound", "one_effect", "bare", "bare_odd", "outside")
EVERY = 6
"""Which of their logs are the second engine's: the second of each six. The third of each six has a validation run."""
SLOW, ORDINARY = 0.2, 0.25
"""Shares of logs that keep some rows of the loop alone, and whose motion is an ordinary one."""
RATES = (50, 100)
LATE = ("time_delay", "actuator_lag")
"""Not of slow logs: where within a row the torque acted, they do not say. Test runs keep every row."""
LOOPS, SECONDS, OTHER = (500, 250), 12.0, 8.0
WINDOW = (3.0, 30.0)  # sigmas


@dataclass(frozen=True)
class Task:
    """One log to be made."""

    stratum: str
    kind: str
    """Family, mechanism or fault; nothing in strata without one, and of positions the generator's number."""
    seed: int
    index: int
    robots: tuple[str, ...] = ()
    """Files of the robots; none for the generator's own."""
    fix_base: bool = False
    engine: str = MUJOCO
    validation: bool = False


def plan(
    seed: int,
    count: int,
    robots: tuple[str, ...] = (),
    fix_base: bool = False,
    engines: tuple[str, ...] = ENGINES,
) -> list[Task]:
    """Which log holds what: strata by their shares, kinds in turn, both in an order of the seed's.

    One's own robots have a fixed base: no `imu` among them.
    """
    rng = np.random.default_rng([seed, 0])
    shares = {s: x for s, x in SHARES.items() if not (robots and s == standing.STRATUM)}
    # Exactly rounded: from Python 3.12 on `sum` rounds otherwise, and ties of quotas would turn.
    whole = math.fsum(shares.values())
    quota = {s: share * count / whole for s, share in shares.items()}
    names: list[str] = []
    for _ in range(count):
        # The stratum that is furthest behind its share: a short set holds every one of them.
        behind = {s: quota[s] - names.count(s) for s in shares}
        names.append(max(behind, key=lambda s: behind[s]))
    names = [str(x) for x in rng.permutation(names)]
    turns = {s: list(rng.permutation(kinds)) for s, kinds in KINDS.items()}
    first = int(rng.integers(2520))
    tasks = []
    for index, stratum in enumerate(names):
        kinds = turns.get(stratum)
        before = names[:index].count(stratum)
        kind = str(kinds[before % len(kinds)]) if kinds else ""
        if stratum in (*position.STRATA, standing.STRATUM):
            kind = str(first + before)
        # A kind is not always the same engine's.
        turn = before
        if kinds and math.gcd(len(kinds), EVERY) > 1:
            turn += before // len(kinds)
        place = turn % EVERY if stratum in TWO_ENGINES else -1
        engine = engines[-1] if place == 1 else engines[0]
        tasks.append(Task(stratum, kind, seed, index, robots, fix_base, engine, place == 2))
    return tasks


KINDS = {"one_effect": ONE, "bare_odd": odd.ODD, "outside": OUTSIDE, "misread": FAULTS}


def library(task: Task) -> Robots:
    """Robots by name, without friction and rotors."""
    if not task.robots:
        return fleet.robots(task.seed)
    return {
        f"own{k}": lambda path=Path(file): _own(path, task.fix_base)
        for k, file in enumerate(task.robots)
    }


def _own(path: Path, fix_base: bool) -> Robot:
    robot = bare(own_robot(path, fix_base))
    return dataclasses.replace(robot, peak=rated_torque(robot))


def make(task: Task) -> Made:
    """Both logs, the nominal model and the truth. RuntimeError where no draw of the effect keeps the loop stable."""
    if task.stratum in position.STRATA:
        return _of_positions(task)
    if task.stratum == standing.STRATUM:
        return standing.make(int(task.kind), [task.seed, STANDING, task.index])
    setting = draw_setting(task.seed, task.index, library(task))
    rng = np.random.default_rng([*setting.seed, 10])
    setting.duration, setting.test_duration = SECONDS, OTHER
    setting.window, setting.validation = WINDOW, task.validation
    setting.rate = int(rng.choice(LOOPS, p=[0.3, 0.7]))
    if rng.random() < ORDINARY:
        setting.kinds = ("ordinary", "exciting")
    slow = int(rng.choice(RATES)) if rng.random() < SLOW else None
    if task.kind in LATE:
        slow = None
    if slow:
        # Of a row that is kept, the torque until the next one is not known.
        setting.options["tau_kind"] = "current"
    setting.engine = task.engine
    setting.good = task.stratum in ("sound", "one_effect")
    kind = task.kind
    if kind == "joint_coupling" and len(setting.robot.joints) < 2:
        kind = "joint_spring"
    fault = kind if task.stratum == "misread" else ""
    if fault == "other_order" and len(setting.robot.joints) < 2:
        fault = "degrees"
    if fault == "turned_mount":
        setting.mount = mount(setting.robot, np.random.default_rng([*setting.seed, 8]))
    made = simulated(setting, "" if fault else kind)
    if slow:
        every = setting.rate // slow
        made.log = kept(made.log, every)
        made.validation = made.validation and kept(made.validation, every)
        made.truth["rate_hz"] = setting.rate / (setting.rate // slow)
    if fault:
        seed = [*setting.seed, 9]
        made.log, made.test = (
            misread(x, fault, setting.robot, seed) for x in (made.log, made.test)
        )
    made.truth |= {"stratum": task.stratum, "fault": fault, "validation": task.validation}
    return made


def _of_positions(task: Task) -> Made:
    number, robots = int(task.kind), library(task)
    names = tuple(robots) if task.robots else fleet.LIGHT
    bought = robots[names[(number // 6 + 2 * number) % len(names)]]()
    torque = task.stratum == "position_torque"
    made = position.make(number, [task.seed, POSITION, task.index], torque, bought)
    made.truth |= {"stratum": task.stratum, "engine": MUJOCO}
    return made


POSITION, STANDING = 30, 31  # in the seeds


def kept(log: dict[str, np.ndarray], every: int) -> dict[str, np.ndarray]:
    """Each so many rows of what has rows."""
    rows = len(log["time"])
    return {k: x[::every] if x.ndim and len(x) == rows else x for k, x in log.items()}


def write(task: Task, folder: Path) -> None:
    """One log on disk, whole or not at all."""
    if (folder / "truth.json").exists():
        return
    made = make(task)
    texts = {"nominal.xml": made.nominal, "truth.json": json.dumps(made.truth, indent=1)}
    write_folder(folder, made.log, made.test, texts, made.validation)
