"""RESULTS.md: wrong rows first, then rates, then where they come from."""

from __future__ import annotations

from collections import Counter

from exam.marks import fine
from exam.rates import GOALS, QUESTIONS, by, count

BREAKDOWN = ("family", "place", "in_set", "unknown", "false_alarm", "pair_recall", "pair_precision")


def words(effects: list) -> str:
    return " + ".join(f"{f} at {p}" for f, p in effects) or "nothing"


def wrong_rows(rows: list[dict], figures: dict[str, str]) -> str:
    """Every wrong log with its figure, the clearest first."""
    wrong = [r for r in rows if not fine(r)]
    wrong.sort(key=lambda r: -max([0.0, *r["distinct"]]))
    lines = [
        f"## Wrong rows: {len(wrong)} of {len(rows)}",
        "",
        "| log | setting | hidden (χ² left after the nominal model's errors) | reported | |",
        "|---|---|---|---|---|",
    ]
    for r in wrong:
        setting = f"{r['robot']}, {r['motion']}, {r['engine']}, {r['rate']} Hz, {r['sensors']}"
        if r["wrong_model"]:
            setting += ", nominal off"
        hidden = " + ".join(
            f"{f} at {p} ({d:.3g})" for (f, p), d in zip(r["true"], r["distinct"], strict=True)
        )
        picture = f"![]({figures[r['log']]})" if r["log"] in figures else ""
        lines.append(
            f"| {r['log']} | {setting} | {hidden or 'nothing'} | {r['verdict']}: {words(r['found'])} | {picture} |"
        )
    return "\n".join(lines)


def rates(rows: list[dict], others: dict[str, list[dict]]) -> str:
    """All questions, ours beside the baselines."""
    names = ["diagnose", *others]
    lines = [
        "## Rates",
        "",
        "Wilson 95 % bounds. Single effects and unknown ones: the clear; pairs: their clear halves.",
        "",
        f"| | goal | {' | '.join(names)} |",
        "|---|---|" + "---|" * len(names),
    ]
    for name, ask in QUESTIONS.items():
        cells = " | ".join(str(ask(each)) for each in (rows, *others.values()))
        lines.append(f"| {name.replace('_', ' ')} | {GOALS.get(name, '')} | {cells} |")
    return "\n".join(lines)


def breakdowns(rows: list[dict]) -> str:
    """The main questions by robot, motion, engine and the rest."""
    parts = []
    for column in ("robot", "motion", "engine", "sensors", "wrong_model", "rate", "loud"):
        lines = [
            f"### By {column.replace('_', ' ')}",
            "",
            f"| {column.replace('_', ' ')} | logs | {' | '.join(n.replace('_', ' ') for n in BREAKDOWN)} |",
            "|---|---|" + "---|" * len(BREAKDOWN),
        ]
        for value, some in by(rows, column).items():
            cells = " | ".join(str(QUESTIONS[n](some)) for n in BREAKDOWN)
            lines.append(f"| {value} | {len(some)} | {cells} |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def families(rows: list[dict]) -> str:
    """Each family of single effects and each unknown mechanism."""
    lines = [
        "## By family",
        "",
        "| hidden | clear | named | place | in set | unknown | missed | faint: misled |",
    ]
    lines.append("|---|---|---|---|---|---|---|---|")
    alone = [r for r in rows if r["stratum"] in ("single", "unknown")]
    for name, some in sorted(by([r | {"f": r["true"][0][0]} for r in alone], "f").items()):
        clear = [r for r in some if r["clear"][0]]
        told = count([r["verdict"] == "unknown" for r in clear])
        cells = [QUESTIONS[n](some) for n in ("family", "place", "in_set")]
        cells += [told, count([r["verdict"] == "no_gap" for r in clear])]
        cells.append(QUESTIONS["misled_when_faint"](some))
        shown = " | ".join(f"{c.k}/{c.n}" if c.n else "–" for c in cells)
        lines.append(f"| {name} | {len(clear)} of {len(some)} | {shown} |")
    return "\n".join(lines)


def parameters(rows: list[dict]) -> str:
    """Median error and coverage of each number."""
    found: dict[tuple[str, str], list[dict]] = {}
    for row in rows:
        for p in row.get("parameters", []):
            found.setdefault((p["family"], p["name"]), []).append(p)
    lines = ["## Parameters", "", "| family | number | n | median error | within 10 % | covered |"]
    lines.append("|---|---|---|---|---|---|")
    for (family, name), some in sorted(found.items()):
        errors = sorted(p["error"] for p in some)
        lines.append(
            f"| {family} | {name} | {len(some)} | {errors[len(errors) // 2]:.3f} "
            f"| {count(e <= 0.1 for e in errors)} | {count(p['covers'] for p in some)} |"
        )
    return "\n".join(lines)


def confusion(rows: list[dict]) -> str:
    """What clear single effects were taken for, the right ones left out."""
    taken = Counter(
        (r["true"][0][0], r["found"][0][0] if r["found"] else r["verdict"])
        for r in rows
        if r["stratum"] in ("single", "unknown") and r["clear"][0]
    )
    lines = [
        "## Taken for something else",
        "",
        "| hidden | first reported | logs |",
        "|---|---|---|",
    ]
    lines += [f"| {t} | {f} | {n} |" for (t, f), n in sorted(taken.items()) if t != f]
    return "\n".join(lines)


def times(seconds: list[float]) -> str:
    if not seconds:
        return ""
    ordered = sorted(seconds)
    return (
        f"Median {ordered[len(ordered) // 2]:.1f} s a log with its test log, slowest {ordered[-1]:.0f} s, "
        f"{sum(ordered) / 3600:.2f} core hours in all."
    )
