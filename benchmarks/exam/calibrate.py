"""The map from a search's log odds to a probability, fitted on opened sets, and how it does on robots left out.

    python -m benchmarks.exam.handed_over run OUT --n 48 --seed 701
    python -m benchmarks.exam.calibrate store OUT/rows.json [...] --seeds 701 [...] --commit HASH
    python -m benchmarks.exam.calibrate sealed benchmarks/results/sealed_rows.json
    python -m benchmarks.exam.calibrate write [--check]

`store` keeps in benchmarks/results/calibration.json, of every odd effect that was listed or considered and of every
verdict, its log odds before calibration and whether it was right; `sealed` adds verdicts by torque of an opened sealed
set. `write` fits p = 1 / (1 + exp(−a asinh L − b)) and writes jax_inertia/diagnosis/certainty/calibration.json, which
the package reads, and docs/how_sure.md: what was so on each robot by a map that was fitted on the others. `--check`
writes nothing and fails where either would be another.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from benchmarks.exam.handed_over import CLEAR, OUTSIDE, found

ROOT = Path(__file__).resolve().parents[2]
STORED = ROOT / "benchmarks" / "results" / "calibration.json"
MAP = ROOT / "jax_inertia" / "diagnosis" / "certainty" / "calibration.json"
PAGE = ROOT / "docs" / "how_sure.md"
PAGE_TEXT = """# How sure

What a report calls the probability of an effect, and the confidence of a verdict, is

    p = 1 / (1 + exp(−a asinh L − b))

L are the log odds of the search in nats (`log_odds` of report.json), −ln(e^−E + Σ e^−c): E is the evidence of the
effect against nothing in its place, c by how much each alternative is behind it, both the less of what fitted rows say
and of what rows say that no number was fitted to. So the probability falls where something else predicts those rows as
well. Of a verdict L sums what stands against it: that an effect is not there, that another one is, that a joint's
error is beyond its border, as sure as its samples make that.

Of effects b = 0 and a = {slope}, fitted on {sets}, {logs} logs diagnosed at commit `{commit}`
({date}): {effects_listed} odd effects that were listed and {effects_not_listed} that were considered and not listed
(`not_listed` of report.json). Of verdicts a = {slope_of_verdicts} and b = {offset_of_verdicts}, fitted on the same logs
and {further}. Both maps stand in
`jax_inertia/diagnosis/certainty/calibration.json`, which `benchmarks/exam/calibrate.py` writes with this page. Below,
each robot's probabilities are by a map that was fitted on the other robots.

## Odd effects, listed and not: {all_count}

{all}

## Those that are listed: {listed_count}

{listed}

Listed and not there: {wrong}.

## Verdicts: {verdicts_count}

{verdicts}

A verdict is right where it is `explained`, all that is listed is there and no effect of 3 sigma is missed, or where it
is `partly` or `unknown` and an effect outside the library is there; in a sealed set by that set's own marks (an effect
that was hidden is found, nothing is `no_gap`, what is outside the library is not `explained`). These robots are
simulated: on real ones equations err more. Replays use both
maps, which were not fitted on them. Of 79 logs of targets of S1 (56 verdicts right) a product of chances that stood in
the place of the second map had a log loss of 1.24; the map, of log odds that are those of the product, has 0.71. Of 12
of S2 (10 right) they have 0.71 and 0.48.
"""
BY_TORQUE = ("sound", "one_effect", "bare", "bare_odd", "outside")
"""Strata of a sealed set that are diagnosed by torque and may hold an effect."""
EDGES = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 1.0)


def effects_of(row: dict) -> list[dict]:
    """Each odd effect that was listed, or considered and not: its log odds, and whether it is there.

    Of one that is listed, or one that it is tied with. What is there and small at a joint (`present`) may be listed; as
    one that is not, it counts neither way.
    """
    small = {(p["family"], p["location"]["name"]) for p in row["present"]}
    hidden = set()
    if row["odd"] and row["odd"][0] not in OUTSIDE:
        hidden = {(row["odd"][0], row["odd"][1])}
        hidden |= {(e["family"], e["location"]["name"]) for e in row["equiv"]}
    out = [
        {"what": f"{f} at {n}", "odds": odds, "listed": True}
        | {"so": bool({(f, n), *map(tuple, ties)} & (hidden | small))}
        for f, n, _, ties, odds in row["listed"]
    ]
    out += [
        {"what": "", "odds": odds, "listed": False, "so": (f, n) in hidden}
        for f, n, odds in row["not_listed"]
        if (f, n) not in small and (f, n) not in {tuple(x[:2]) for x in row["listed"]}
    ]
    return [{"robot": row["robot"], "log": row["name"]} | e for e in out]


def verdict_of(row: dict) -> dict | None:
    """The verdict's log odds, and whether it is right; None where an effect is too faint to be asked for.

    `explained` is right where all that is listed is there and nothing clear is missed, `partly` and `unknown` where an
    effect outside the library is.
    """
    outside = bool(row["odd"]) and row["odd"][0] in OUTSIDE
    if row["odd"] and row["odd"][2] < CLEAR:
        return None
    if outside:
        so = row["verdict"] in ("partly", "unknown")
    else:
        sound = all(e["so"] for e in effects_of(row) if e["listed"])
        sound &= row["odd"] is None or found(row)
        so = row["verdict"] == "explained" and sound
    return {"robot": row["robot"], "what": row["verdict"], "odds": row["log_odds"], "so": so}


def sealed(rows: list[dict]) -> list[dict]:
    """Verdicts by torque of an opened sealed set (`../blind/score.py`), by its own marks."""
    given = [r for r in rows if r["stratum"] in BY_TORQUE and r.get("log_odds") is not None]
    return [
        {"robot": r["robot"], "what": r["verdict"], "odds": r["log_odds"], "so": r["right"]}
        for r in given
    ]


def fitted(rows: list[dict], offset: bool = False) -> tuple[float, float]:
    """(a, b) by maximum likelihood with Platt's targets: (N₊ + 1)/(N₊ + 2) and 1/(N₋ + 2); b = 0 without `offset`."""
    x, so = np.arcsinh([r["odds"] for r in rows]), np.array([r["so"] for r in rows])
    target = np.where(so, (so.sum() + 1) / (so.sum() + 2), 1 / ((~so).sum() + 2))

    def loss(ab: np.ndarray) -> float:
        z = ab[0] * x + ab[1]
        return float(np.mean(np.logaddexp(0.0, z) - target * z))

    free = (-10.0, 10.0) if offset else (0.0, 0.0)
    a, b = minimize(loss, [0.5, 0.0], bounds=[(0.0, 10.0), free]).x
    return round(float(a), 4), round(float(b), 4)


def stated(ab: tuple[float, float], rows: list[dict]) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-ab[0] * np.arcsinh([r["odds"] for r in rows]) - ab[1]))


def left_out(
    rows: list[dict], fitted_to: list[dict], offset: bool
) -> tuple[np.ndarray, np.ndarray]:
    """(p, p of a constant): each robot's by what was fitted on the others."""
    p, constant = np.zeros(len(rows)), np.zeros(len(rows))
    robots = np.array([r["robot"] for r in rows])
    for robot in np.unique(robots):
        own = robots == robot
        others = [r for r in fitted_to if r["robot"] != robot]
        p[own] = stated(fitted(others, offset), [r for r in rows if r["robot"] == robot])
        same = [r["so"] for r in rows if r["robot"] != robot]
        constant[own] = (sum(same) + 1) / (len(same) + 2)
    return p, constant


def log_loss(p: np.ndarray, so: np.ndarray) -> float:
    return float(-np.mean(np.where(so, np.log(p), np.log1p(-p))))


def table(rows: list[dict], fitted_to: list[dict], offset: bool) -> list[str]:
    """Reliability on robots left out, and what the odds add to one probability for all."""
    p, constant = left_out(rows, fitted_to, offset)
    so = np.array([r["so"] for r in rows])
    lines = ["| stated | mean stated | so |", "|---|---|---|"]
    for low, high in itertools.pairwise(EDGES):
        own = (p >= low) & (p < high)
        if own.any():
            lines.append(
                f"| {low:g} to {high:g} | {p[own].mean():.2f} | {so[own].sum()} of {own.sum()} |"
            )
    text = (
        f"Log loss {log_loss(p, so):.3f}; of one probability for all {log_loss(constant, so):.3f}."
    )
    return [*lines, "", text]


def mapping(kept: dict) -> dict:
    """calibration.json."""
    listed = sum(e["listed"] for e in kept["effects"])
    slope, offset = fitted(kept["verdicts"], offset=True)
    return {
        "slope": fitted(kept["effects"])[0],
        "slope_of_verdicts": slope,
        "offset_of_verdicts": offset,
        "fitted_by": "benchmarks/exam/calibrate.py",
        "sets": kept["sets"],
        "further": kept["further"],
        "logs": kept["logs"],
        "effects_listed": listed,
        "effects_not_listed": len(kept["effects"]) - listed,
        "date": kept["date"],
        "commit": kept["commit"],
    }


def page(kept: dict) -> str:
    """docs/how_sure.md."""
    effects = kept["effects"]
    listed = [e for e in effects if e["listed"]]
    wrong = [f"{e['what']} ({e['robot']}, {e['odds']:.1f} nats)" for e in listed if not e["so"]]
    parts = {
        "all": effects,
        "listed": listed,
        "verdicts": kept["verdicts"],
    }
    given = {
        name: "\n".join(table(rows, *((rows, True) if name == "verdicts" else (effects, False))))
        for name, rows in parts.items()
    }
    counts = {f"{name}_count": len(rows) for name, rows in parts.items()}
    return PAGE_TEXT.format(**mapping(kept), **given, **counts, wrong="; ".join(wrong) or "none")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    store = commands.add_parser("store")
    store.add_argument("rows", nargs="+", type=Path)
    store.add_argument("--seeds", nargs="+", required=True)
    store.add_argument("--commit", required=True)
    store.add_argument("--date", default=time.strftime("%Y-%m-%d"))
    commands.add_parser("sealed").add_argument("rows", type=Path)
    commands.add_parser("write").add_argument("--check", action="store_true")
    args = parser.parse_args()
    if args.command == "store":
        rows = [r for f in args.rows for r in json.loads(f.read_text()) if "failed" not in r]
        kept = {
            "sets": f"robots as bought ({' and '.join(args.seeds)} as seed of benchmarks/worlds/as_bought.py)",
            "logs": len(rows),
            "date": args.date,
            "commit": args.commit,
            "further": "none of a sealed set",
            "effects": [e for r in rows for e in effects_of(r)],
            "verdicts": [v for r in rows if (v := verdict_of(r))],
        }
        STORED.write_text(json.dumps(kept, indent=1) + "\n")
        return
    kept = json.loads(STORED.read_text())
    if args.command == "sealed":
        given = json.loads(args.rows.read_text())
        more = sealed(next(iter(given["tools"].values())))
        kept["verdicts"] += more
        kept["further"] = f"on {len(more)} by torque of sealed set {given['about']['set']}, opened"
        STORED.write_text(json.dumps(kept, indent=1) + "\n")
        return
    texts = {MAP: json.dumps(mapping(kept), indent=1) + "\n", PAGE: page(kept)}
    if args.check:
        raise SystemExit(int(any(p.read_text() != text for p, text in texts.items())))
    for path, text in texts.items():
        path.write_text(text)


if __name__ == "__main__":
    main()
