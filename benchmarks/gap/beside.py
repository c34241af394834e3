"""Baselines beside the diagnosis: run on the same logs, scored the same way, one row for each stratum and method."""

from __future__ import annotations

import contextlib
import io
import json
import math
import traceback
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import baseline_sysid
import baselines
import numpy as np

ORACLE = "mujoco.sysid, told what to fit"
OURS = "diagnosis"
Score = Callable[[dict, dict], dict]


def others(folder: Path, truth: dict, score: Score) -> dict[str, dict]:
    """Score of every baseline on one log, by name; an error is a score without a finding."""
    out = {}
    try:
        for name, (report, seconds) in baselines.run(folder).items():
            out[name] = {**_kept(score(truth, report)), "seconds": seconds}
    except Exception:
        out["baselines"] = {"error": traceback.format_exc()[-800:]}
    oracle = _oracle(folder, truth, score)
    return out if oracle is None else {**out, ORACLE: oracle}


def _kept(row: dict) -> dict:
    """What the table needs; baselines have no intervals and no shrink."""
    names = ("found", "verdict", "right", "family", "place", "in_set")
    parameters = [{k: v for k, v in p.items() if k != "covers"} for p in row["parameters"]]
    return {**{n: row[n] for n in names}, "parameters": parameters}


def _oracle(folder: Path, truth: dict, score: Score) -> dict | None:
    """The parameter's error and the time of the oracle; None where it has no such parameter."""
    if len(truth["effects"]) != 1:
        return None
    e = truth["effects"][0]
    with contextlib.redirect_stdout(io.StringIO()):
        try:
            fitted = baseline_sysid.fit(
                folder, e["family"], e["location"]["kind"], e["location"]["name"]
            )
        except Exception:
            return {"error": traceback.format_exc()[-800:]}
    if fitted is None:
        return None
    effect, seconds = fitted
    return {**_kept(score(truth, baselines.as_report([effect]))), "seconds": seconds}


def add(job: tuple[str, str, str, Score]) -> tuple[str, str, dict]:
    """The baselines of one log: stratum, log, scores."""
    data, stratum, name, score = job
    truth = json.loads((Path(data) / stratum / "truth" / f"{name}.json").read_text())
    return stratum, name, others(Path(data) / stratum / "logs" / name, truth, score)


def table(rows: list[dict], share: Callable[[int, int], str]) -> str:
    """Markdown: for each stratum the diagnosis and each baseline, then the oracle's parameters."""
    rows = [r for r in rows if "error" not in r and "others" in r]
    if not rows:
        return ""
    head = "| stratum | method | family | place | exactly right | effects found / unknown | parameters ≤ 10 % | s |"
    lines = ["## Beside what an engineer would try", "", head, "|---|---|---|---|---|---|---|---|"]
    strata = defaultdict(list)
    for r in rows:
        strata[r["stratum"]].append(r)
    for stratum, some in sorted(strata.items()):
        for method in (OURS, *baselines.BASELINES):
            lines.append(_line(stratum, method, _of(some, method), share))
    return "\n".join([*lines, "", *_told(rows, share)]) + "\n"


def _of(rows: list[dict], method: str) -> list[dict]:
    if method == OURS:
        return rows
    return [
        r["others"][method] for r in rows if "error" not in r["others"].get(method, {"error": 1})
    ]


def _line(stratum: str, method: str, rows: list[dict], share: Callable[[int, int], str]) -> str:
    n = len(rows)
    errors = [p["error"] for r in rows for p in r["parameters"]]
    counts = [sum(bool(r[k]) for r in rows) for k in ("family", "place", "right")]
    if stratum in ("none", "legged_none"):
        cells, special = ["–"] * 3, share(sum(bool(r["found"]) for r in rows), n) + " alarms"
    else:
        cells = [share(k, n) for k in counts]
        special = share(sum(r["verdict"] == "unknown" for r in rows), n) + " unknown"
    if stratum == "unknown":
        cells[0] = cells[2] = "–"
    seconds = f"{np.median([r['seconds'] for r in rows]):.2g}" if rows else "–"
    near = share(sum(e < 0.1 for e in errors), len(errors))
    return f"| {stratum} | {method} | {' | '.join(cells)} | {special} | {near} | {seconds} |"


def _told(rows: list[dict], share: Callable[[int, int], str]) -> list[str]:
    """Errors and times of the oracle and of the diagnosis on the parameters that both have."""
    mine, its, seconds = [], [], []
    for r in rows:
        oracle = r["others"].get(ORACLE)
        if oracle is None or "error" in oracle:
            continue
        found = {(p["family"], p["name"]): p["error"] for p in r["parameters"]}
        for p in oracle["parameters"]:
            if (key := (p["family"], p["name"])) in found:
                mine.append(found[key])
                its.append(p["error"])
        seconds.append((r["seconds"], oracle["seconds"]))
    if not baseline_sysid.AVAILABLE:
        return ["`mujoco.sysid` was not installed (`mujoco[sysid]`): no oracle."]
    if not its:
        return ["`mujoco.sysid` had no parameter in common with the diagnosis."]
    ours, oracle = np.array(seconds).T
    text = (
        f"`mujoco.sysid`, told family and place, against the diagnosis, which had to find them: {len(its)} parameters "
        f"that both have, on {len(seconds)} logs with an effect that a spec can express (fixed base, one effect; "
        f"{baseline_sysid.WINDOWS} windows of {baseline_sysid.HORIZON:g} s)."
    )
    lines = [text, "", "| | within 10 % | median error | median s a log |", "|---|---|---|---|"]
    for name, errors, times in ((OURS, mine, ours), (ORACLE, its, oracle)):
        near = share(sum(e < 0.1 for e in errors), len(errors))
        median = float(np.median(errors))
        shown = "–" if math.isnan(median) else f"{100 * median:.2g} %"
        lines.append(f"| {name} | {near} | {shown} | {np.median(times):.2g} |")
    return lines
