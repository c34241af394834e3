"""One log of a mixed examination (`worlds/strata.py`): the hidden truth beside what was said.

Any tool can be marked: from it come report.json and corrected.xml, or one line that refuses the log
(blind/PROTOCOL.md). An effect counts as found where one that is listed, or one stated equivalent to it, is the true one
or one that theory says is the same there. Effects that change the torque by less than `SEEN` standard deviations of
what else is uncertain (friction's form, the drawing's tolerances, the sensors) are not asked for: silence is right
there.
"""

from __future__ import annotations

import json
import re
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.exam import imu_marks, position_marks, torque_marks
from benchmarks.exam.report_torque import ORDINARY
from benchmarks.exam.torque_marks import SEEN, key, keys_of, terms

WORDS = {
    "no_gravity": r"gravity",
    "amperes": r"tau-unit|not N m|current",
    "motor_side": r"tau-unit|not N m|gear",
    "late_torque": r"shift-torque|behind|ahead|late",
    "turned_sign": r"sign",
    "other_order": r"is what|order",
    "degrees": r"degrees",
    "other_zero": r"zero",
    "turned_mount": r"mount",
}
"""What a line has to say of each fault; `misread` of a report may name it instead."""
SHOWN = 300
"""Characters of what was printed that a row keeps."""


def mark_all(folders: list[Path], found: Path, jobs: int) -> list[dict]:
    """Rows of logs, by what a tool wrote to `found`/results."""
    places = [found / "results" / f.name for f in folders]
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        return list(pool.map(mark, folders, places))


def mark(folder: Path, place: Path) -> dict:
    """A flat row. `folder` holds the log and truth.json, `place` what a tool made of it; malformed reports are none."""
    report, said, seconds = _answer(place)
    try:
        return _row(folder, place, report, said, seconds)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        if report is None:
            raise
        return _row(folder, place, None, f"report.json: {error!r}", seconds)


def _row(folder: Path, place: Path, report: dict | None, said: str, seconds: float | None) -> dict:
    truth = json.loads((folder / "truth.json").read_text())
    row = {
        "log": folder.name,
        "stratum": truth["stratum"],
        "robot": truth["robot"],
        "engine": truth.get("engine", "mujoco"),
        "validation": truth.get("validation", False),
        "verdict": "refused" if report is None else report["verdict"],
        "confidence": None if report is None else report.get("confidence"),
        "log_odds": None if report is None else report.get("log_odds"),
        "said": said[-SHOWN:],
        "seconds": seconds,
    }
    if truth["stratum"] in position_marks.STRATA:
        return row | position_marks.marks(folder, place, truth, report)
    if truth["stratum"] == imu_marks.STRATUM:
        return row | imu_marks.marks(truth, report)
    odd, stratum = truth["odd"], truth["stratum"]
    seen = bool(odd) and odd["visibility"]["sigmas"] >= SEEN
    row |= {
        "hidden": _hidden(truth),
        "sigmas": odd["visibility"]["sigmas"] if odd else 0.0,
        "asked": seen if stratum in ("one_effect", "bare_odd", "outside") else True,
        "listed": [] if report is None else [list(key(e)) for e in report["effects"]],
    }
    if stratum == "misread":
        return row | _of_fault(truth, report, said)
    return row | _of_effects(truth, report, row) | _errors(folder, place, truth, report)


def _answer(place: Path) -> tuple[dict | None, str, float | None]:
    """Report, what was printed, and how long it took [s]."""
    file, run = place / "report.json", place / "run.json"
    report = json.loads(file.read_text()) if file.exists() else None
    said = json.loads(run.read_text()) if run.exists() else {}
    text = f"{said.get('console', '')} {said.get('error', '')}"
    return report, " ".join(text.split()), said.get("seconds")


def _hidden(truth: dict) -> str:
    if truth.get("fault"):
        return truth["fault"]
    odd = truth["odd"]
    if not odd:
        return "nothing" if truth["stratum"] == "sound" else "ordinary physics"
    return f"{odd.get('mechanism', odd['family'])} at {odd['location']['name']}"


def _of_fault(truth: dict, report: dict | None, said: str) -> dict:
    """A fault is named in the line, or in the report's notes; a confident verdict on such a log is wrong."""
    text = said if report is None else f"{said} {json.dumps(report.get('notes', ''))}"
    named = bool(re.search(WORDS[truth["fault"]], text, re.IGNORECASE))
    named |= report is not None and report.get("misread") == truth["fault"]
    confident = report is not None and report["verdict"] in ("explained", "no_gap")
    return {"right": named and not confident, "confident_wrong": confident, "named": named}


def _of_effects(truth: dict, report: dict | None, row: dict) -> dict:
    stratum, verdict = truth["stratum"], row["verdict"]
    if report is None:
        return {"right": False, "confident_wrong": False, "found": False, "there": []}
    odd, good = truth["odd"], stratum in ("sound", "one_effect")
    declared = keys_of(odd) if odd and odd["family"] != "unknown" else set()
    present = {key(e) for e in truth["present"]}
    there, hits, strange = [], [], []
    for e in report["effects"]:
        hit = bool(keys_of(e) & declared)
        ordinary = e["family"] in ORDINARY or e.get("ordinary", False)
        known = (ordinary and not good) or key(e) in present
        there.append(hit or known)
        if not ordinary:
            hits.append(hit)
        if not (hit or known):
            strange.append(e)
    found = any(hits)
    right = {
        "sound": verdict == "no_gap",
        "one_effect": found or not row["asked"],
        "bare": verdict != "no_gap" and not strange,
        "bare_odd": found or not row["asked"],
        "outside": verdict in ("unknown", "partly") or not row["asked"],
    }[stratum]
    wrong = {
        "sound": verdict == "explained",
        "one_effect": row["asked"] and not found and verdict in ("explained", "no_gap"),
        "bare": verdict == "no_gap" or (verdict == "explained" and bool(strange)),
        "bare_odd": row["asked"] and not found and verdict in ("explained", "no_gap"),
        "outside": row["asked"] and verdict in ("explained", "no_gap"),
    }[stratum]
    return {
        "right": right,
        "confident_wrong": wrong,
        "found": found,
        "first": bool(hits) and hits[0],
        "there": there,
    }


def _errors(folder: Path, place: Path, truth: dict, report: dict | None) -> dict:
    """Torque error of the test run's moving rows [N m]: as given, least squares, the truth in such forms, as reported.

    `stated`: after over before by the report itself, on rows of its own log.
    """
    errors = torque_marks.errors(folder, truth)
    out = {name: errors[name]["rms"] for name in ("nominal", "least_squares", "oracle")}
    out |= {"tool": None, "stated": None}
    if report is None:
        return {"errors": out}
    try:
        own = torque_marks.own_error(place, folder, report)
    except (KeyError, ValueError, TypeError):
        own = None
    out["tool"] = own["rms"] if own else None
    held = (report.get("shrink") or {}).get("heldout") or {}
    if held.get("before") and held.get("after") is not None:
        out["stated"] = held["after"] / held["before"]
    return {"errors": out} | _intervals(truth, report)


def _intervals(truth: dict, report: dict) -> dict:
    """`covers`: whether each interval of an ordinary number holds the true one; `width`: over the truth's own."""
    told = [t for t in terms(truth, report) if t["covers"] is not None]
    ratios = []
    for t in told:
        one = report.get("joints", {}).get(t["joint"], {}).get(t["family"], {})
        sigma = truth["joints"][t["joint"]][t["family"]]["sigma"]
        if one.get("ci95") and sigma > 0:
            ratios.append((one["ci95"][1] - one["ci95"][0]) / (2 * 1.96 * sigma))
    return {
        "covers": [sum(t["covers"] for t in told), len(told)],
        "width": float(np.median(ratios)) if ratios else None,
    }
