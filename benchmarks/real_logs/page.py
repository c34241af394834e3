"""Writes docs/real_robots.md from stored results; `--add` takes new ones in first.

    python benchmarks/real_logs/other_run.py OUT --tool
    python benchmarks/replay/real.py ../shared/data OUT/replay.json so101 go2 xl330
    python benchmarks/real_logs/page.py [--add OUT/other_run.json OUT/replay.json ...] [--commit HASH]

Stored in benchmarks/results/real_robots.json: a row for each robot, with the run that a tool saw and the one that it is
judged by.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
STORED, PAGE = (
    ROOT / "benchmarks" / "results" / "real_robots.json",
    ROOT / "docs" / "real_robots.md",
)
EQUAL = 1.02
"""Two errors within 2 % of each other are the same."""
HEAD = """# Real robots with a part withheld

Every robot of our collection of public logs, split by run: the tools see one part, the numbers are of the other.
Some of these logs were looked at while the method was made, so this is no sealed check. Written by
`benchmarks/real_logs/page.py` from `benchmarks/results/real_robots.json`; diagnosis of commit {commit}. Robots were
built and measured by others: `benchmarks/real_logs/ROBOTS.md` says what is known of each.
"""
TORQUE = """## Torque of the other run

Rms error [N m] over all joints in motion, 10 Hz. *As given*: the nominal model. *Least squares*: friction, rotor and
offset of every joint and every mass, all at once, 40 lines of NumPy. *Published*: the figures of who measured the
robot, with the same bodies. *Tool, as it states*: `diagnose`'s own forecast of that run, with all that helps it to
predict, a slow discrepancy and gains of motors among them. *Tool, as handed over*: report.json and corrected.xml
evaluated by a program that shares no code with it, each joint's gain (`joints.*.torque_gain`) included; what neither
holds as a number is lost.
"""
POSITIONS = """## Closed-loop replays of motions that no fit saw

Rms error [mrad] over joints and time of the robot's own targets, replayed in MuJoCo. *PACE-like*: rotor, damping,
friction, offset and gain of every joint and one delay by least squares over replays, without a choice of what is there.
The last column counts joints and motions where the tool is no worse than it (2 %).
"""


def take(stored: dict, file: Path) -> None:
    """Rows of other_run.json, or robots of replay/real.py's file, in place of older ones."""
    new = json.loads(file.read_text())
    if isinstance(new, list):
        rows = {r["name"]: r for r in stored["torque"]} | {r["name"]: r for r in new}
        stored["torque"] = list(rows.values())
    else:
        keep = ("cpu", "pace_cpu", "joints", "motions", "verdict", "effects")
        stored["positions"] |= {k: {x: v[x] for x in keep} for k, v in new.items()}


def torque_rows(rows: list[dict]) -> tuple[list[str], list[str]]:
    """Table, and in words where the tool is behind a baseline."""
    heads = ["run that is seen → judged", "as given", "least squares", "published"]
    heads += ["tool, as it states", "tool, as handed over", "verdict", "odd effects listed", "s"]
    lines, behind = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"], []
    for r in rows:
        tool = r.get("tool", {})
        stated, again = (tool.get("stated") or {}).get("after"), tool.get("measured")
        handed = again["rms"] if again else None
        others = {k: r[k]["rms"] for k in ("least_squares", "published") if r[k]}
        title = r["title"] + (" (raw unit)" if r["unit"] == "raw" else "")
        odd = [e for e in tool.get("effects", []) if not e.startswith(ORDINARY)]
        cells = [
            title,
            *(_number(r[k] and r[k]["rms"]) for k in ("nominal", "least_squares", "published")),
            _number(stated),
            _number(handed),
            tool.get("verdict") or tool.get("failed", "–")[:60],
            ", ".join(odd) or "none",
            _number(tool.get("seconds")),
        ]
        lines.append("| " + " | ".join(cells) + " |")
        if r["unit"] == "raw":
            continue
        for name, number in (("as it states", stated), ("as handed over", handed)):
            worse = [
                k.replace("_", " ") for k, x in others.items() if number and number > EQUAL * x
            ]
            if worse:
                behind.append(f"- {title}: {name} ({_number(number)}) behind {' and '.join(worse)}")
    return lines, behind


ORDINARY = ("viscous_friction", "coulomb_friction", "armature", "torque_bias")


def position_rows(robots: dict[str, dict]) -> tuple[list[str], list[str]]:
    """Table, and in words where the tool is behind the PACE-like fit or the nominal model."""
    heads = ["robot", "motion", "as given", "PACE-like", "tool", "tool / PACE-like", "no worse"]
    lines, behind = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"], []
    for robot, found in robots.items():
        for motion, errors in found["motions"].items():
            each = {k: 1e3 * np.array(errors[k]) for k in ("nominal", "pace", "ours")}
            rms = {k: float(np.sqrt(np.mean(x**2))) for k, x in each.items()}
            good = int((each["ours"] <= EQUAL * each["pace"]).sum())
            ratio = rms["ours"] / rms["pace"]
            cells = [NAMES[robot], motion, *(f"{rms[k]:.2f}" for k in ("nominal", "pace", "ours"))]
            cells += [f"{ratio:.2f}", f"{good} of {len(each['ours'])}"]
            lines.append("| " + " | ".join(cells) + " |")
            worse = [
                f"{joint} ({b:.1f} for {a:.1f})"
                for joint, a, b in zip(found["joints"], each["pace"], each["ours"], strict=True)
                if b > EQUAL * a
            ]
            if worse:
                behind.append(
                    f"- {NAMES[robot]}, {motion}: behind the PACE-like fit at {', '.join(worse)}"
                )
            if rms["ours"] > EQUAL * rms["nominal"]:
                behind.append(f"- {NAMES[robot]}, {motion}: worse than the model as given")
    return lines, behind


NAMES = {"so101": "SO-101 arm", "go2": "Go2 in the air", "xl330": "XL330 servo"}


def effects(robots: dict[str, dict]) -> list[str]:
    """Verdict and what was listed beyond the ordinary numbers, a line a robot."""
    out = []
    for robot, found in robots.items():
        odd = [
            f"{e['family']} at {e['location']['name']}"
            for e in found["effects"]
            if not e.get("ordinary")
        ]
        told = ", ".join(odd) or "ordinary numbers alone"
        seconds = f"CPU {found['cpu']:.0f} s, PACE-like {found['pace_cpu']:.0f} s"
        out.append(f"- {NAMES[robot]}: `{found['verdict']}`; {told}. {seconds}.")
    return out


def page(stored: dict) -> str:
    torque, lost_torque = torque_rows(stored["torque"])
    loops, lost_loops = position_rows(stored["positions"])
    parts = [HEAD.format(commit=f"`{stored['commit']}`"), TORQUE, "\n".join(torque) + "\n"]
    parts += ["**Behind a baseline**\n", "\n".join(lost_torque or ["- nowhere"]) + "\n"]
    if stored["positions"]:
        parts += [
            POSITIONS,
            "\n".join(loops) + "\n",
            "\n".join(effects(stored["positions"])) + "\n",
        ]
        parts += ["**Behind a baseline**\n", "\n".join(lost_loops or ["- nowhere"]) + "\n"]
    return "\n".join(parts + stored.get("notes", [])).rstrip() + "\n"


def _number(x: float | None) -> str:
    return "–" if x is None else f"{x:.3g}"


def main() -> None:
    """Of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--add", nargs="+", type=Path, default=[])
    parser.add_argument("--commit", help="of the diagnosis that made them")
    args = parser.parse_args()
    stored = {"commit": "", "torque": [], "positions": {}, "notes": []}
    if STORED.exists():
        stored |= json.loads(STORED.read_text())
    for file in args.add:
        take(stored, file)
    stored["commit"] = args.commit or stored["commit"]
    STORED.write_text(json.dumps(stored, indent=1) + "\n")
    PAGE.write_text(page(stored))


if __name__ == "__main__":
    main()
