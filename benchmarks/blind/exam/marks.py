"""One log: the hidden truth beside what was reported.

An effect is *clear* where its χ², after likely errors of the nominal model had their share, is at least `CLEAR`:
fixed before any log was diagnosed, the same figure as of the development data. Fainter ones are asked for as well
(sizes start below what can be seen), and reported apart: there, silence is right, too.
"""

from __future__ import annotations

import math

CLEAR = 150.0
NEAR = 0.10
AT_FLOOR = 1.2
SKIPPED = ("phase", "rest_angle")
"""Numbers whose relative error says nothing: an angle's zero is a convention."""

Key = tuple[str, str]


def key(effect: dict) -> Key:
    return effect["family"], effect["location"]["name"]


def mark(answer: dict, report: dict | None, other: dict | None = None) -> dict:
    """A flat row: the setting, the truth, what was found, and every question with True, False or None (not asked).

    `other`: torque error of the run that the tool never saw, {"before", "after"}, of the files as written.
    """
    truth = answer["truth"]
    setting, effects = truth["setting"], truth["effects"]
    row = {
        "stratum": setting["stratum"],
        "robot": setting["robot"],
        "engine": setting["engine"],
        "motion": setting["motions"][0],
        "rate": setting["rate"],
        "loud": setting["loud"],
        "wrong_model": setting["wrong"],
        "sensors": _habit(truth["sensors"]),
        "true": [[e["mechanism"], e["location"]["name"]] for e in effects],
        "clear": [e["visibility"]["distinct"] >= CLEAR for e in effects],
        "chi2": [e["visibility"]["chi2"] for e in effects],
        "distinct": [e["visibility"]["distinct"] for e in effects],
    }
    if report is None:
        return row | {"failed": True, "found": [], "verdict": "failed", **_answered(truth, _FAILED)}
    found = [list(key(e)) for e in report["effects"]]
    row |= {"failed": False, "found": found, "verdict": report["verdict"]}
    return row | _answered(truth, report) | _numbers(truth, report, other)


_FAILED = {"verdict": "failed", "effects": [], "gap": {"share": {}}, "shrink": {}}


def _habit(s: dict) -> str:
    words = [s["law"]] if s["law"] != "normal" else []
    words += ["drops"] if s["drops"] else []
    words += ["coarse"] if s["coarse"] else []
    return "+".join(words) or "plain"


def accepted(truth: dict) -> list[set[Key]]:
    """For each true effect: itself, and what theory says explains the same log exactly."""
    return [
        {key(e), *((f, n) for f, n in twins)}
        for e, twins in zip(truth["effects"], truth["equivalents"], strict=True)
    ]


def _answered(truth: dict, report: dict) -> dict:
    """The questions. None where one does not apply to the log."""
    stratum, verdict = truth["setting"]["stratum"], report["verdict"]
    right = accepted(truth)
    clear = [e["visibility"]["distinct"] >= CLEAR for e in truth["effects"]]
    found = [key(e) for e in report["effects"]]
    sets = [{key(e), *map(key, e.get("equivalent", []))} for e in report["effects"]]
    out: dict = dict.fromkeys(
        ["false_alarm", "family", "place", "in_set", "exact", "false_unknown", "unknown", "missed"]
    )
    out |= dict.fromkeys(["unknown_place", "pair_recall", "pair_precision", "pair_both"])
    out |= dict.fromkeys(["pair_in_set", "misled"])
    if stratum == "none":
        out["false_alarm"] = verdict != "no_gap"
        return out
    if stratum == "unknown":
        if clear[0]:
            # One effect of the library may be the same there, by theory.
            out["unknown"] = verdict == "unknown" or (bool(found) and found[0] in right[0])
            out["unknown_place"] = _points_at(truth["effects"][0]["location"], report)
        return out
    hits = [any(f in r for f in found) for r in right]
    if stratum == "single":
        first, one = (found[0] if found else ("", "")), right[0]
        if not clear[0]:
            out["misled"] = bool(found) and first not in one and not (sets[0] & one)
            return out
        out["family"] = first[0] in {f for f, _ in one}
        out["place"] = first[1] in {p for _, p in one}
        out["in_set"] = bool(sets) and bool(sets[0] & one)
        out["exact"] = len(found) == 1 and first in one and verdict != "unknown"
        out["false_unknown"] = verdict == "unknown"
        out["missed"] = verdict == "no_gap"
        return out
    asked = [h for h, c in zip(hits, clear, strict=True) if c]
    if asked:
        out["pair_recall"] = asked
        out["pair_precision"] = [any(f in r for r in right) for f in found]
        out["false_unknown"] = verdict == "unknown"
    if len(asked) == 2:
        out["pair_both"] = all(asked) and len(found) == 2
        out["pair_in_set"] = len(found) == 2 and all(any(s & r for s in sets) for r in right)
    return out


def _points_at(location: dict, report: dict) -> bool | None:
    """Whether an unknown effect's place is told: by the first effect, the row with most of the gap, or the body."""
    if location["kind"] == "global":
        return None
    told = {key(e)[1] for e in report["effects"][:1]}
    if share := report["gap"]["share"]:
        told.add(max(share, key=lambda name: share[name]))
    bodies = (report.get("where") or {}).get("bodies") or []
    told |= {b["body"] for b in bodies[:1]}
    return location["name"] in told


def _numbers(truth: dict, report: dict, other: dict | None) -> dict:
    """Parameters of effects that both name, shrink predicted and achieved, rollouts, probability."""
    parameters = []
    for t in truth["effects"]:
        for e in report["effects"]:
            if key(t) == key(e):
                parameters += _compared(t, e)
    shrink = report["shrink"]
    own = shrink.get("heldout") or {}
    held = _shrunk(own)
    test = _shrunk(other and other | {"noise": own.get("noise")})
    lasting = all(e["lasting"] for e in truth["effects"])
    near = None
    if report["effects"] and lasting and held is not None and test is not None:
        near = abs(held - test) <= NEAR
    rolled = shrink.get("rollout")
    at_floor = None
    if rolled and report["effects"] and report["verdict"] != "unknown" and rolled["floor"]:
        at_floor = rolled["after"] <= AT_FLOOR * rolled["floor"]
    first = report["effects"][0] if report["effects"] else None
    return {
        "parameters": parameters,
        "predicted": held,
        "achieved": test,
        "shrink_within_10": near,
        "rollout_at_floor": at_floor,
        "probability": first["probability"] if first else None,
        "confidence": report["confidence"],
    }


def _shrunk(s: dict | None) -> float | None:
    """Noise-corrected share of the gap that went away; None where there was hardly a gap."""
    if not s or s["before"] is None or s["after"] is None:
        return None
    noise = s.get("noise") or 0.0
    if s["before"] < 1.5 * noise:
        return None
    return 1.0 - _above(s["after"], noise) / max(_above(s["before"], noise), 1e-12)


def _above(x: float, noise: float) -> float:
    return math.sqrt(max(x * x - noise * noise, 0.0))


def _compared(true: dict, found: dict) -> list[dict]:
    """Relative error (of a vector: of its length) and coverage, number by number."""
    out = []
    for name, p in found["parameters"].items():
        if name not in true["parameters"] or name in SKIPPED or p["value"] is None:
            continue
        value = true["parameters"][name]["value"]
        stem = name[:-2] if name[-2:] in ("_x", "_y", "_z") else None
        parts = [q["value"] for n, q in true["parameters"].items() if stem and n[:-2] == stem]
        size = math.sqrt(sum(x * x for x in parts)) if parts else abs(value)
        low, high = p["ci95"]
        out.append(
            {
                "family": true["family"],
                "name": name,
                "error": abs(p["value"] - value) / max(size, 1e-12),
                "covers": None if low is None or high is None else low <= value <= high,
            }
        )
    return out


def fine(row: dict) -> bool:
    """Whether a log needs no explanation in the list of wrong ones."""
    if row["failed"]:
        return False
    if row["stratum"] == "none":
        return not row["false_alarm"]
    if row["stratum"] == "unknown":
        return row["unknown"] is not False
    if row["stratum"] == "single":
        return bool(row["exact"] or row["in_set"]) if row["clear"][0] else not row["misled"]
    return row["pair_recall"] is None or (all(row["pair_recall"]) and all(row["pair_precision"]))
