"""Rates of a mixed examination, its page, and the numbers that other programs read."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from exam.rates import Share, count

STRATA = ("sound", "one_effect", "bare", "bare_odd", "outside", "misread")
CAD = ("bare", "bare_odd", "outside")
MEANING = {
    "sound": "nothing is hidden, and `no_gap` is said",
    "one_effect": "the one effect is listed, its place right, ties counted",
    "bare": "ordinary physics is listed, and nothing that is not there",
    "bare_odd": "the odd effect is listed beside it",
    "outside": "`unknown` or `partly`",
    "misread": "the fault is named, and no confident verdict given",
}
DRAWS = 2000


def of(rows: Iterable[dict], *strata: str) -> list[dict]:
    return [r for r in rows if r["stratum"] in strata]


def median(values: list[float]) -> tuple[float | None, float | None, float | None]:
    """Median and its 95 % bootstrap interval; None of nothing."""
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


def no_worse(rows: list[dict]) -> Share:
    """Than plain least squares, by 2 %, where the report's torque can be computed."""
    errors = [r["errors"] for r in of(rows, *CAD) if r.get("errors")]
    return count(e["tool"] <= 1.02 * e["least_squares"] for e in errors if e["tool"] is not None)


def reliability(rows: list[dict]) -> list[tuple[float, float, int]]:
    """(mean stated, share right, logs) of each tenth of confidence."""
    told = [(r["confidence"], r["right"]) for r in rows if r["confidence"] is not None]
    out = []
    for k in range(10):
        some = [(c, ok) for c, ok in told if min(int(10 * c), 9) == k]
        if some:
            stated, right = np.mean(some, axis=0)
            out.append((float(stated), float(right), len(some)))
    return out


def confidence_error(rows: list[dict]) -> float | None:
    """Mean |stated − observed| over tenths, weighted by their logs."""
    parts = reliability(rows)
    total = sum(n for *_, n in parts)
    return sum(abs(s - r) * n for s, r, n in parts) / total if total else None


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
        "sound_no_gap": count(r["right"] for r in of(rows, "sound")),
        "wrong_and_confident": count(r["confident_wrong"] for r in rows),
        "refused": count(r["verdict"] == "refused" for r in rows if r["stratum"] != "misread"),
    }


def summary(rows: list[dict]) -> dict[str, float | int | None]:
    """What sealed.json holds: each number with its bounds."""
    out: dict[str, float | int | None] = {"logs": len(rows)}
    for name, share in shares(rows).items():
        out[name] = share.rate
        out[f"{name}_low"], out[f"{name}_high"] = share.bounds
    for name, tool in (("cad_after_before", "tool"), ("cad_least_squares", "least_squares")):
        out[name], out[f"{name}_low"], out[f"{name}_high"] = median(ratios(rows, tool))
    out["confidence_error"] = confidence_error(rows)
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
    middles = []
    for rows in tools.values():
        middle, low, high = median(ratios(rows, "tool"))
        middles.append("–" if middle is None else f"{middle:.3f} [{low:.3f}, {high:.3f}]")
    lines.append(f"| torque error of another motion, after / before | {' | '.join(middles)} |")
    return "\n".join(lines) + "\n"


def page(rows: list[dict], title: str, head: str = "") -> str:
    """Markdown: strata, rates, every wrong row."""
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
            told = count(r["right"] for r in some)
            lines.append(f"| {stratum} | {len(some)} | {told} | {MEANING[stratum]} |")
    lines += ["", "| | |", "|---|---|"]
    for name, share in shares(rows).items():
        if share.n:
            lines.append(f"| {name.replace('_', ' ')} | {share} |")
    for name, tool in (
        ("as reported", "tool"),
        ("plain least squares", "least_squares"),
        ("truth in these forms", "oracle"),
    ):
        middle, low, high = median(ratios(rows, tool))
        if middle is not None:
            lines.append(
                f"| torque error of another motion, after / before, median: {name} "
                f"| {middle:.3f} [{low:.3f}, {high:.3f}] |"
            )
    if (error := confidence_error(rows)) is not None:
        lines.append(f"| confidence: mean distance of stated and observed | {error:.3f} |")
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
