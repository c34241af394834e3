"""ADDED.md and its figure: what was added to real logs, and what the diagnosis said."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from report import table

PAGE, FIGURE = "ADDED.md", "added.png"
# A size within this share of the true one is right.
NEAR = 0.25


@dataclass(frozen=True)
class Row:
    """One log: what was added, what was said."""

    case: str
    log: str
    answer: dict
    new: tuple[str, ...]
    """family@place of each effect that the log as recorded is not said to have, in the report's order."""
    listed: bool
    in_set: bool
    place: bool
    size: float | None
    """Found over true, where the effect is listed; of a gain, of its distance from one."""
    verdict: str
    seconds: float

    @classmethod
    def of(cls, case: str, folder: Path, report: dict, untouched: dict) -> Row:
        answer = json.loads((folder / "answer.json").read_text())
        wanted = key(answer["family"], answer["place"])
        before = {_key_of(e) for e in untouched["effects"]}
        new = tuple(k for k in map(_key_of, report["effects"]) if k not in before)
        hit = next((e for e in report["effects"] if _key_of(e) == wanted), None)
        return cls(
            case,
            folder.name,
            answer,
            new,
            hit is not None,
            wanted in said(report),
            any(k.split("@")[1] == answer["place"] for k in new),
            hit and _ratio(answer, hit["parameters"]),
            report["verdict"],
            json.loads((folder / "seconds.json").read_text()),
        )

    @property
    def wanted(self) -> str:
        return key(self.answer["family"], self.answer["place"])

    @property
    def first(self) -> bool:
        """Whether it leads what is new."""
        return self.new[:1] == (self.wanted,)

    @property
    def how(self) -> str:
        """How it was told, in a word."""
        if self.first:
            return "first"
        return "listed" if self.listed else "in the set" if self.in_set else "–"


def key(family: str, place: str) -> str:
    """An effect at its place, in a word."""
    return f"{family}@{place}"


def _key_of(effect: dict) -> str:
    return key(effect["family"], effect["location"]["name"])


def said(report: dict) -> set[str]:
    """All effects of a report, and what it declares equal to them."""
    return {_key_of(x) for e in report["effects"] for x in (e, *e["equivalent"])}


def _ratio(answer: dict, numbers: dict) -> float:
    if answer["number"] == "force":
        return (
            float(np.linalg.norm([numbers[f"force_{a}"]["value"] for a in "xyz"])) / answer["value"]
        )
    zero = 1.0 if answer["number"] == "gain" else 0.0
    return (numbers[answer["number"]]["value"] - zero) / (answer["value"] - zero)


def collect(out: Path) -> list[Row]:
    """Every log that was diagnosed."""
    rows = []
    for own in sorted(out.glob("*/as_recorded/report.json")):
        untouched, case = json.loads(own.read_text()), own.parents[1]
        for report in sorted(case.glob("[0-9]*/report.json")):
            rows.append(Row.of(case.name, report.parent, json.loads(report.read_text()), untouched))
    return rows


def line(row: Row) -> str:
    """One log in a line."""
    size = "" if row.size is None else f", size × {row.size:.2f}"
    return (
        f"  {row.case}/{row.log}: {row.wanted} at {row.answer['ratio']:.1f} of the gap: {row.how}{size}; "
        f"new: {', '.join(row.new) or 'nothing'}; {row.verdict}, {row.seconds:.0f} s"
    )


_HEAD = """# Effects added to real logs, and withheld

`python benchmarks/real_logs/added.py --out DIR --seed {seed}` writes this page. The logs of real robots are left as
they were recorded but for their torques, which get what one more effect asks of the drives for the same motion
(MuJoCo C's inverse dynamics, Dahl's friction; on the other run as well). So the robot's own friction, noise and errors
of its model are real, and one effect is known. It is drawn at random, at a place where the log as recorded is not said
to have it, {least:.1f} to {most:.1f} times as loud (rms) as what the model misses on the row where it is loudest. The
robot's reaction to the effect is not in the log: the controller is taken for perfect.

*Listed*: among the effects, by name and place. *First*: it leads those that the log as recorded is not said to have.
*In the set*: listed, or declared equal to one that is. *Place*: one of the new effects is there. *Size*: within {near}
of the true one, of those listed. *New, wrong*: what is listed beyond that and beyond the log as recorded."""


def write(folder: Path, rows: list[Row], seed: int, machine: str) -> None:
    """The page and its figure."""
    head = [
        "robot",
        "logs",
        "listed",
        "first",
        "in the set",
        "place",
        "size",
        "new, wrong",
        "median s",
    ]
    robots = list(dict.fromkeys(r.case for r in rows))
    counts = [_count(name, [r for r in rows if r.case == name]) for name in robots]
    ratios = [r.answer["ratio"] for r in rows]
    wanted = ["log", "added", "of the gap", "", "size", "new, as listed", "verdict"]
    parts = [
        _HEAD.format(seed=seed, least=min(ratios), most=max(ratios), near=f"{100 * NEAR:.0f} %"),
        table(head, [*counts, _count("all", rows)]),
        f"![size found over true against how loud the effect is]({FIGURE})",
        table(wanted, [_told(r) for r in rows]),
        f"Times include compiling; {machine}, shared with other work at the time.",
    ]
    (folder / PAGE).write_text("\n\n".join(parts) + "\n")
    _figure(folder / FIGURE, rows)


def _count(name: str, rows: list[Row]) -> list[str]:
    def count(of: Callable[[Row], bool]) -> str:
        return str(sum(of(r) for r in rows))

    sized = [r for r in rows if r.size is not None]
    return [
        name,
        str(len(rows)),
        count(lambda r: r.listed),
        count(lambda r: r.first),
        count(lambda r: r.in_set),
        count(lambda r: r.place),
        f"{sum(_near(r) for r in sized)} of {len(sized)}",
        str(sum(len(set(r.new) - {r.wanted}) for r in rows)),
        f"{np.median([r.seconds for r in rows]):.0f}",
    ]


def _near(row: Row) -> bool:
    return row.size is not None and abs(row.size - 1.0) <= NEAR


def _told(row: Row) -> list[str]:
    return [
        f"{row.case}/{row.log}",
        row.wanted.replace("@", " at "),
        f"{row.answer['ratio']:.1f}",
        row.how,
        "–" if row.size is None else f"{row.size:.2f}",
        ", ".join(k.replace("@", " at ") for k in row.new) or "nothing",
        row.verdict,
    ]


def _figure(path: Path, rows: list[Row]) -> None:
    """Size found over true against loudness; what is not listed lies on the floor."""
    fig, ax = plt.subplots(figsize=(7, 3.6), layout="constrained")
    ax.axhspan(1 - NEAR, 1 + NEAR, color="0.92")
    ax.axhline(1.0, color="0.6", lw=0.8)
    for k, name in enumerate(dict.fromkeys(r.case for r in rows)):
        some = [r for r in rows if r.case == name]
        sizes = [0.0 if r.size is None else float(np.clip(r.size, 0.05, 2.0)) for r in some]
        ratios = [r.answer["ratio"] for r in some]
        ax.scatter(ratios, sizes, label=name, color=f"C{k}", marker="osD^v"[k % 5], s=36)
        for r, x, y in zip(some, ratios, sizes, strict=True):
            if not y:
                ax.annotate(
                    r.answer["family"], (x, y), xytext=(0, 6), textcoords="offset points",
                    fontsize=6, rotation=60, color=f"C{k}",
                )  # fmt: skip
    ax.set_xscale("log")
    ax.set_xticks([0.5, 1, 2, 3], ["0.5", "1", "2", "3"])
    ax.minorticks_off()
    ax.set_ylim(-0.1, 2.1)
    ax.set_xlabel("torque added / missing torque of the log as recorded (rms, loudest row)")
    ax.set_ylabel("size found / true (0: not listed)")
    ax.legend(fontsize=7, frameon=False, loc="upper right")
    fig.savefig(path, dpi=130)
    plt.close(fig)
