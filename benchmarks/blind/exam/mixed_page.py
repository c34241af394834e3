"""Rates of a mixed examination, its page, and the numbers that other programs read."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from exam.rates import Share, count

POSITION = ("position", "position_torque", "imu")
TORQUE = ("sound", "one_effect", "bare", "bare_odd", "outside")
"""Strata that two engines make."""
STRATA = (*TORQUE, "misread", *POSITION)
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
DRAWS = 2000
SEALED = (
    "one_effect_family", "cad_precision", "cad_odd", "position_family", "sound_no_gap", "wrong_and_confident",
)  # fmt: skip
"""Shares that a sealed set is summed up by, beside two medians and the confidence's error."""


def of(rows: Iterable[dict], *strata: str) -> list[dict]:
    return [r for r in rows if r["stratum"] in strata]


Bounded = tuple[float | None, float | None, float | None]
"""A number and its 95 % bootstrap interval; None of nothing."""


def median(values: list[float]) -> Bounded:
    x = np.array(values)
    if not len(x):
        return None, None, None
    rng = np.random.default_rng(0)
    draws = np.median(rng.choice(x, (DRAWS, len(x))), axis=1)
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(np.median(x)), float(low), float(high)


def ratios(rows: list[dict], tool: str) -> list[float]:
    """Error after over before on the other motion, of robots as they are bought."""
    errors = [r["errors"] for r in of(rows, *CAD) if r.get("errors")]
    return [e[tool] / e["nominal"] for e in errors if e.get(tool) is not None]


def replay_ratios(rows: list[dict], beside: list[dict]) -> list[float]:
    """Closed-loop replay error on the other motion over that of another tool, of robots with something to correct."""
    other = {r["log"]: r["replay"]["tool"] for r in of(beside, "position")}
    hiding = [r for r in of(rows, "position") if r["hidden"] != "nothing" and r["log"] in other]
    return [r["replay"]["tool"] / other[r["log"]] for r in hiding]


def replay_shares(rows: list[dict], tool: str) -> list[float]:
    """Closed-loop replay error after over before on the other motion, of robots with something to correct."""
    hiding = [r["replay"] for r in of(rows, "position") if r["hidden"] != "nothing"]
    return [e[tool] / e["nominal"] for e in hiding]


def no_worse(rows: list[dict]) -> Share:
    """Than plain least squares, by 2 %, where the report's torque can be computed."""
    errors = [r["errors"] for r in of(rows, *CAD) if r.get("errors")]
    return count(e["tool"] <= 1.02 * e["least_squares"] for e in errors if e["tool"] is not None)


def _told(rows: list[dict]) -> np.ndarray:
    """(stated confidence, whether right) of each row that states one (N, 2)."""
    told = [(r["confidence"], r["right"]) for r in rows if r["confidence"] is not None]
    return np.array(told, float).reshape(-1, 2)


def _tenths(told: np.ndarray) -> list[tuple[float, float, int]]:
    tenth = np.minimum((10 * told[:, 0]).astype(int), 9)
    parts = [told[tenth == k] for k in range(10)]
    return [(*map(float, some.mean(0)), len(some)) for some in parts if len(some)]


def reliability(rows: list[dict]) -> list[tuple[float, float, int]]:
    """(mean stated, share right, logs) of each tenth of confidence."""
    return _tenths(_told(rows))


def confidence_error(rows: list[dict]) -> Bounded:
    """Mean |stated − observed| over tenths, weighted by their logs."""
    told = _told(rows)
    if not len(told):
        return None, None, None

    def mean(some: np.ndarray) -> float:
        return sum(abs(s - r) * n for s, r, n in _tenths(some)) / len(some)

    rng = np.random.default_rng(0)
    draws = [mean(told[rng.integers(len(told), size=len(told))]) for _ in range(DRAWS)]
    low, high = np.percentile(draws, [2.5, 97.5])
    return mean(told), float(low), float(high)


def shares(rows: list[dict]) -> dict[str, Share]:
    """Every rate by its machine-readable name."""
    asked = [r for r in rows if r["asked"]]
    return {
        "one_effect_family": count(r["found"] for r in of(asked, "one_effect")),
        "cad_precision": count(t for r in of(rows, *CAD) for t in r["there"]),
        "cad_odd": count(r["found"] for r in of(asked, "bare_odd")),
        "cad_odd_first": count(r.get("first") for r in of(asked, "bare_odd")),
        "cad_no_worse_than_least_squares": no_worse(rows),
        "outside_flagged": count(r["right"] for r in of(asked, "outside")),
        "misread_named": count(r["right"] for r in of(rows, "misread")),
        "position_family": count(x for r in of(rows, *POSITION) for x in r["named"]),
        "imu_mass_within_5_percent": count(
            abs(r["mass_error"] or 0.0) <= 0.05 and r["mass_error"] is not None
            for r in of(rows, "imu")
            if r["sigmas"]
        ),
        "imu_nothing_invented": count(not r["invented"] for r in of(rows, "imu")),
        "sound_no_gap": count(r["right"] for r in rows if r["hidden"] == "nothing"),
        "wrong_and_confident": count(r["confident_wrong"] for r in rows),
        "refused": count(r["verdict"] == "refused" for r in rows if r["stratum"] != "misread"),
    }


def summary(rows: list[dict], pace: list[dict]) -> dict[str, float | int | None]:
    """What sealed.json holds, each number with its bounds; `pace`: rows of the PACE-like fit on the same logs."""
    out: dict[str, float | int | None] = {"logs": len(rows)}
    numbers = {name: (s.rate, *s.bounds) for name, s in shares(rows).items() if name in SEALED}
    numbers["cad_after_before"] = median(ratios(rows, "tool"))
    numbers["position_replay_vs_pace"] = median(replay_ratios(rows, pace))
    numbers["confidence_error"] = confidence_error(rows)
    for name, (value, low, high) in numbers.items():
        out |= {name: value, f"{name}_low": low, f"{name}_high": high}
    return out


def leaderboard(tools: dict[str, list[dict]]) -> str:
    """Markdown: a row a question, a column a tool, all on the same logs."""
    lines = [
        f"| | {' | '.join(tools)} |",
        "|---|" + "---|" * len(tools),
    ]
    for name in next(iter(map(shares, tools.values()))):
        cells = " | ".join(str(shares(rows)[name]) for rows in tools.values())
        lines.append(f"| {name.replace('_', ' ')} | {cells} |")
    for name, of_tool in (("torque error", ratios), ("closed-loop replay error", replay_shares)):
        middles = [told(median(of_tool(rows, "tool"))) for rows in tools.values()]
        lines.append(f"| {name} of another motion, after / before | {' | '.join(middles)} |")
    return "\n".join(lines) + "\n"


def told(number: Bounded) -> str:
    """With its interval, or a dash."""
    return "–" if number[0] is None else "{:.3f} [{:.3f}, {:.3f}]".format(*number)


def engines(rows: list[dict]) -> list[str]:
    """Lines of a table: a row a stratum, a column an engine, of the strata that both make."""
    names = sorted({r["engine"] for r in of(rows, *TORQUE)})
    if len(names) < 2:
        return []
    lines = ["", f"| right, world by | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for stratum in TORQUE:
        shares = [count(r["right"] for r in of(rows, stratum) if r["engine"] == e) for e in names]
        lines.append(f"| {stratum} | {' | '.join(map(str, shares))} |")
    return lines


def page(rows: list[dict], pace: list[dict], title: str, head: str = "") -> str:
    """Markdown: strata, rates, every wrong row; `pace` as of `summary`."""
    lines = [
        f"# {title}",
        "",
        head,
        "",
        "| stratum | logs | right | what right means |",
        "|---|---|---|---|",
    ]
    for stratum in STRATA:
        if some := of(rows, stratum):
            right = count(r["right"] for r in some)
            lines.append(f"| {stratum} | {len(some)} | {right} | {MEANING[stratum]} |")
    lines += engines(rows)
    lines += ["", "| | |", "|---|---|"]
    for name, share in shares(rows).items():
        if share.n:
            lines.append(f"| {name.replace('_', ' ')} | {share} |")
    torque, loop = "torque error of another motion", "closed-loop replay error of another motion"
    medians = {
        f"{torque}, after / before, median: as reported": ratios(rows, "tool"),
        f"{torque}: plain least squares": ratios(rows, "least_squares"),
        f"{torque}: truth in these forms": ratios(rows, "oracle"),
        f"{loop}, after / before, median": replay_shares(rows, "tool"),
        f"{loop}, over the PACE-like fit's, median": replay_ratios(rows, pace),
    }
    for name, values in medians.items():
        if values:
            lines.append(f"| {name} | {told(median(values))} |")
    if (error := confidence_error(rows))[0] is not None:
        lines.append(f"| confidence: mean distance of stated and observed | {told(error)} |")
    lines += ["", "## Wrong rows", "", "| log | robot | hidden | said | |", "|---|---|---|---|---|"]
    for r in rows:
        if not r["right"]:
            listed = ", ".join(f"{f} at {p}" for f, p in r["listed"] if f) or "nothing"
            said = f"{r['verdict']}: {listed if r['verdict'] != 'refused' else r['said'][-200:]}"
            flag = "**wrong and confident**" if r["confident_wrong"] else ""
            size = f" ({r['sigmas']:.1f} σ)" if r["sigmas"] else ""
            lines.append(
                f"| {r['log']} | {r['robot']} | {r['stratum']}: {r['hidden']}{size} | {said} | {flag} |"
            )
    return "\n".join(lines) + "\n"
