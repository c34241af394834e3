"""Rates of a sealed set, its page, and the numbers that other programs read; all from stored rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np

from benchmarks.exam.rates import Bounded, Share, confidence_error, count, median, tenths, worded

TARGETS, FEET = ("position", "position_torque"), "imu"
TORQUE = ("sound", "one_effect", "bare", "bare_odd", "outside")
"""Strata that two engines make."""
STRATA = (*TORQUE, "misread", *TARGETS, FEET)
CAD = ("bare", "bare_odd", "outside")
MEANING = {
    "sound": "nothing is hidden, and `no_gap` is said",
    "one_effect": "the one effect is listed, its place right, ties counted",
    "bare": "ordinary physics is listed, and nothing that is not there",
    "bare_odd": "the odd effect is listed beside it",
    "outside": "`unknown` or `partly`",
    "misread": "the fault is named, and no confident verdict given",
    "position": "`no_gap` of a sound robot; every effect listed, its place right, ties counted; else nothing invented",
    "position_torque": "the same",
    "imu": "the same",
}
SOFT = ("backlash", "joint_elasticity")
GOALS = {
    "one_effect_family": "≥ 0.99", "play_and_elasticity": "≥ 0.95", "cad_precision": "≥ 0.98", "cad_odd": "≥ 0.95",
    "sound_no_gap": "≥ 0.99", "position_family": "≥ 0.95", "feet_family": "≥ 0.9",
    "handed_over_vs_least_squares": "≤ 0.3", "handed_over_vs_stated": "≤ 1.1", "position_replay_vs_pace": "≤ 0.5",
    "wrong_and_confident": "≤ 0.01", "confidence_error": "≤ 0.05",
}  # fmt: skip
"""What sealed.json holds beside the number of logs, and what was asked of each."""
PACE, SQUARES = "pace_like", "least_squares"
Rows = list[dict]


def of(rows: Iterable[dict], *strata: str) -> Rows:
    return [r for r in rows if r["stratum"] in strata]


def _errors(rows: Rows, strata: tuple[str, ...] = CAD) -> Rows:
    """Torque errors of logs whose report can be computed again."""
    made = [r["errors"] for r in of(rows, *strata) if r.get("errors")]
    return [e for e in made if e["tool"] is not None]


def _replays(rows: Rows) -> Rows:
    """Of robots without torque that hide something."""
    return [r for r in of(rows, "position") if r["hidden"] != "nothing"]


def _invented(row: dict) -> bool:
    return not all(row["there"])


def _confident(rows: Rows) -> np.ndarray:
    told = [(r["confidence"], r["right"]) for r in rows if r["confidence"] is not None]
    return np.array(told, float).reshape(-1, 2)


def reliability(rows: Rows) -> list[tuple[float, float, int]]:
    """(mean stated, share right, logs) of each tenth of confidence."""
    return tenths(_confident(rows))


def shares(rows: Rows) -> dict[str, Share]:
    """Every rate by its machine-readable name."""
    asked = [r for r in rows if r["asked"]]
    soft = [r for r in of(asked, "one_effect", "bare_odd") if r["hidden"].split(" at ")[0] in SOFT]
    cover = [r["covers"] for r in of(rows, *CAD) if r.get("covers")]
    return {
        "one_effect_family": count(r["found"] for r in of(asked, "one_effect")),
        "play_and_elasticity": count(r["found"] for r in soft),
        "cad_precision": count(t for r in of(rows, *CAD) for t in r["there"]),
        "cad_odd": count(r["found"] for r in of(asked, "bare_odd")),
        "cad_odd_first": count(r.get("first") for r in of(asked, "bare_odd")),
        "cad_inventions": count(_invented(r) for r in of(rows, "bare")),
        "no_worse_than_least_squares": count(
            e["tool"] <= 1.02 * e["least_squares"] for e in _errors(rows)
        ),
        "interval_coverage": Share(sum(k for k, _ in cover), sum(n for _, n in cover)),
        "outside_flagged": count(r["right"] for r in of(asked, "outside")),
        "misread_named": count(r["right"] for r in of(rows, "misread")),
        "sound_no_gap": count(r["right"] for r in rows if r["hidden"] == "nothing"),
        "position_family": count(x for r in of(rows, *TARGETS) for x in r["named"]),
        "position_inventions": count(_invented(r) for r in of(rows, *TARGETS)),
        "feet_family": count(x for r in of(rows, FEET) for x in r["named"]),
        "feet_inventions": count(_invented(r) for r in of(rows, FEET)),
        "feet_mass_within_5_percent": count(
            r["mass_error"] is not None and abs(r["mass_error"]) <= 0.05
            for r in of(rows, FEET)
            if r["sigmas"]
        ),
        "wrong_and_confident": count(r["confident_wrong"] for r in rows),
        "refused": count(r["verdict"] == "refused" for r in rows if r["stratum"] != "misread"),
    }


def medians(rows: Rows, pace: Rows) -> dict[str, Bounded]:
    """Every median likewise; `pace`: rows of the PACE-like fit on the same logs, whose refusals are no match."""
    errors = _errors(rows)
    fitted = [r for r in of(pace, "position") if r["verdict"] != "refused"]
    other = {r["log"]: r["replay"]["tool"] for r in fitted}
    replays = [r for r in _replays(rows) if r["log"] in other]
    stated = [e for e in errors if e["stated"]]
    return {
        "handed_over_vs_least_squares": median(e["tool"] / e["least_squares"] for e in errors),
        "handed_over_vs_stated": median(e["tool"] / e["nominal"] / e["stated"] for e in stated),
        "handed_over": median(e["tool"] / e["nominal"] for e in errors),
        "handed_over_by_the_truth": median(e["oracle"] / e["nominal"] for e in errors),
        "interval_width_vs_truth": median(r["width"] for r in of(rows, *CAD) if r.get("width")),
        "position_replay_vs_pace": median(r["replay"]["tool"] / other[r["log"]] for r in replays),
        "position_replay": median(
            r["replay"]["tool"] / r["replay"]["nominal"] for r in _replays(rows)
        ),
        "seconds": median(r["seconds"] for r in rows if r["seconds"]),
    }


def numbers(rows: Rows, pace: Rows) -> dict[str, Bounded]:
    """What the goals are about."""
    every: dict[str, Bounded] = {k: (s.rate, *s.bounds) for k, s in shares(rows).items()}
    every |= medians(rows, pace)
    every["confidence_error"] = confidence_error(_confident(rows))
    return {name: every[name] for name in GOALS}


def summary(rows: Rows, pace: Rows) -> dict[str, float | int | None]:
    """What sealed.json holds, each number with its bounds."""
    out: dict[str, float | int | None] = {"logs": len(rows)}
    for name, (value, low, high) in numbers(rows, pace).items():
        out |= {name: value, f"{name}_low": low, f"{name}_high": high}
    return out


def met(name: str, value: float | None) -> bool:
    sign, goal = GOALS[name].split()
    if value is None:
        return False
    return value >= float(goal) if sign == "≥" else value <= float(goal)


def leaderboard(tools: dict[str, Rows]) -> list[str]:
    """Markdown: a row a question, a column a tool, all on the same logs."""
    pace = tools.get(PACE, [])
    lines = [f"| | {' | '.join(tools)} |", "|---" * (len(tools) + 1) + "|"]
    every = {tool: shares(rows) for tool, rows in tools.items()}
    for name in next(iter(every.values())):
        cells = " | ".join(str(s[name]) for s in every.values())
        lines.append(f"| {name.replace('_', ' ')} | {cells} |")
    middle = {tool: medians(rows, pace) for tool, rows in tools.items()}
    for name in next(iter(middle.values())):
        cells = " | ".join(worded(m[name]) for m in middle.values())
        lines.append(f"| {name.replace('_', ' ')}, median | {cells} |")
    return lines


def goals(rows: Rows, pace: Rows) -> list[str]:
    """Markdown: what was asked, what was found, and what falls short."""
    found, counts = numbers(rows, pace), shares(rows)
    found = {name: number for name, number in found.items() if number[0] is not None}
    short = [name for name, (value, *_) in found.items() if not met(name, value)]
    lines = ["| | with its 95 % interval | asked | |", "|---|---|---|---|"]
    for name, number in found.items():
        text = str(counts[name]) if name in counts else worded(number)
        flag = "**short**" if name in short else ""
        lines.append(f"| {name.replace('_', ' ')} | {text} | {GOALS[name]} | {flag} |")
    return [*lines, "", f"{len(found) - len(short)} of {len(found)} are as asked."]


def page(about: dict, tools: dict[str, Rows]) -> str:
    """Markdown; the first tool is the one that is examined."""
    first, rows = next(iter(tools.items()))
    pace = tools.get(PACE, [])
    lines = [f"# Sealed set {about['set']}: {len(rows)} logs, {first}", ""]
    lines += [line for note in about["head"] for line in (note, "")]
    lines += [
        *goals(rows, pace),
        "",
        "## By stratum",
        "",
        "| stratum | logs | right | what right means |",
        "|---|---|---|---|",
    ]
    for stratum in STRATA:
        if some := of(rows, stratum):
            right = count(r["right"] for r in some)
            lines.append(f"| {stratum} | {len(some)} | {right} | {MEANING[stratum]} |")
    for column in ("engine", "robot", "validation"):
        lines += _by(rows, column)
    lines += _kinds(rows)
    lines += ["", "## Beside other tools, on the same logs", "", *leaderboard(tools)]
    lines += ["", "## Confidence", "", "| stated | right | logs |", "|---|---|---|"]
    lines += [f"| {s:.2f} | {r:.2f} | {n} |" for s, r, n in reliability(rows)]
    lines += ["", "## Wrong rows", "", "| log | robot | hidden | said | |", "|---|---|---|---|---|"]
    lines += [_wrong(r) for r in rows if not r["right"]]
    return "\n".join(lines) + "\n"


def further(note: str, rows: Rows) -> list[str]:
    """Of logs of the set that were diagnosed once its seed was open: what was run, the goals, and the wrong rows."""
    wrong = [_wrong(r) for r in rows if not r["right"]]
    head = ["| log | robot | hidden | said | |", "|---|---|---|---|---|"]
    return [
        f"**{len(rows)} further logs.** {note}",
        "",
        *goals(rows, []),
        "",
        *head,
        *wrong,
        "",
        "",
    ]


def _by(rows: Rows, column: str) -> list[str]:
    some = of(rows, *TORQUE)
    values = sorted({str(r.get(column)) for r in some})
    lines = ["", f"| {column}, strata with torque | logs | right |", "|---|---|---|"]
    for value in values:
        mine = [r for r in some if str(r.get(column)) == value]
        lines.append(f"| {value} | {len(mine)} | {count(r['right'] for r in mine)} |")
    return lines


def _kinds(rows: Rows) -> list[str]:
    """Families and mechanisms that were asked for and missed at least once."""
    lines = ["", "| hidden, of 3 σ and more | logs | right |", "|---|---|---|"]
    some = [r for r in of(rows, "one_effect", "bare_odd", "outside", "misread") if r["asked"]]
    for kind, n in sorted(Counter(r["hidden"].split(" at ")[0] for r in some).items()):
        mine = [r["right"] for r in some if r["hidden"].split(" at ")[0] == kind]
        lines.append(f"| {kind} | {n} | {count(mine)} |")
    return lines


def _wrong(r: dict) -> str:
    listed = ", ".join(f"{f} at {p}" for f, p in r["listed"] if f) or "nothing"
    said = f"{r['verdict']}: {listed if r['verdict'] != 'refused' else r['said'][-160:]}"
    flag = "**wrong and confident**" if r["confident_wrong"] else ""
    size = f" ({r['sigmas']:.1f} σ)" if r["sigmas"] else ""
    cells = (r["log"], r["robot"], f"{r['stratum']}: {r['hidden']}{size}", said, flag)
    return "| " + " | ".join(c.replace("|", "/") for c in cells) + " |"
