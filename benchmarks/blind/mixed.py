"""What a mixed examination holds: one log of a stratum, with all that was hidden.

| stratum | the nominal model | hidden |
|---|---|---|
| `sound` | friction and rotor of every joint in it | nothing |
| `one_effect` | the same | one effect of the library |
| `bare` | bodies alone, 2 % off | friction, rotor and offset of every joint |
| `bare_odd` | the same | and one effect more |
| `outside` | the same | and one that no library has |
| `misread` | the same | the log means something else than the model (`gap/misread.py`) |

Robots are `gap/cad_robots`, or any that one names (`gap/own_robot`). A log depends on the seed and its index alone.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "gap"))

import cad
from cad_draw import ODD, OUTSIDE
from cad_robots import CAD_ROBOTS, bare
from many import write_folder
from misread import FAULTS, misread, mount
from own_robot import own_robot, rated_torque
from robots import Robot

SHARES = {
    "sound": 0.15,
    "one_effect": 0.15,
    "bare": 0.15,
    "bare_odd": 0.30,
    "outside": 0.10,
    "misread": 0.15,
}


@dataclass(frozen=True)
class Task:
    """One log to be made."""

    stratum: str
    kind: str
    """Family, mechanism or fault; nothing in strata without one."""
    seed: int
    index: int
    robots: tuple[str, ...] = ()
    """Files of the robots; none for the generator's own."""
    fix_base: bool = False


def plan(seed: int, count: int, robots: tuple[str, ...] = (), fix_base: bool = False) -> list[Task]:
    """Which log holds what: strata by their shares, kinds in turn, both in an order of the seed's."""
    rng = np.random.default_rng([seed, 0])
    quota = {s: share * count for s, share in SHARES.items()}
    names: list[str] = []
    for _ in range(count):
        # The stratum that is furthest behind its share: a short set holds every one of them.
        behind = {s: quota[s] - names.count(s) for s in SHARES}
        names.append(max(behind, key=lambda s: behind[s]))
    names = [str(x) for x in rng.permutation(names)]
    turns = {s: list(rng.permutation(kinds)) for s, kinds in KINDS.items()}
    tasks = []
    for index, stratum in enumerate(names):
        kinds = turns.get(stratum)
        before = names[:index].count(stratum)
        kind = str(kinds[before % len(kinds)]) if kinds else ""
        tasks.append(Task(stratum, kind, seed, index, robots, fix_base))
    return tasks


KINDS = {"one_effect": ODD, "bare_odd": ODD, "outside": OUTSIDE, "misread": FAULTS}


def library(task: Task) -> cad.Robots:
    """Robots by name, without friction and rotors."""
    if not task.robots:
        return CAD_ROBOTS
    return {
        f"own{k}": lambda path=Path(file): _own(path, task.fix_base)
        for k, file in enumerate(task.robots)
    }


def _own(path: Path, fix_base: bool) -> Robot:
    robot = bare(own_robot(path, fix_base))
    return dataclasses.replace(robot, peak=rated_torque(robot))


def make(task: Task) -> cad.Made:
    """Both logs, the nominal model and the truth. RuntimeError where no draw of the effect keeps the loop stable."""
    setting = cad.draw_setting(task.seed, task.index, library(task))
    setting.good = task.stratum in ("sound", "one_effect")
    kind = task.kind
    if kind == "joint_coupling" and len(setting.robot.joints) < 2:
        kind = "joint_spring"
    fault = kind if task.stratum == "misread" else ""
    if fault == "other_order" and len(setting.robot.joints) < 2:
        fault = "degrees"
    if fault == "turned_mount":
        setting.mount = mount(setting.robot, np.random.default_rng([*setting.seed, 8]))
    made = cad.simulated(setting, "" if fault else kind)
    if fault:
        seed = [*setting.seed, 9]
        made.log, made.test = (
            misread(x, fault, setting.robot, seed) for x in (made.log, made.test)
        )
    made.truth |= {"stratum": task.stratum, "fault": fault}
    return made


def write(task: Task, folder: Path) -> None:
    """One log on disk, whole or not at all."""
    if (folder / "truth.json").exists():
        return
    made = make(task)
    texts = {"nominal.xml": made.nominal, "truth.json": json.dumps(made.truth, indent=1)}
    write_folder(folder, made.log, made.test, texts)
