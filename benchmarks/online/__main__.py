"""Gather what `all.sh` wrote into results/online.json: python -m benchmarks.online FOLDER

Blind walks are the paper's (results/paper.json), whose highest boxes are watched here.
"""

import json
import sys
from pathlib import Path

import numpy as np

from benchmarks.harness import results
from benchmarks.online.draws import NAMES
from benchmarks.paper.loop import summary

TRIALS = 1000
ASKED = {(r, d) for r in NAMES for d in ("float32", "float64")}
"""What `nees_in_bounds` needs, all of it: a mean NEES within its 95 % bounds over so many trials."""


def gathered(folder: Path) -> dict:
    """Every part that ran, and the figures that are watched."""
    part = {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}
    out: dict = {"commits": {name: commit_of(v) for name, v in part.items()}}
    honest = [row for k, v in part.items() if k.startswith("honest_") for row in v]
    out["covariance"] = honest
    kinds = [v for k, v in part.items() if k.startswith("links_")]
    out["links"] = kinds
    if kinds:
        out["load_link"] = sum(k["right"] for k in kinds) / sum(k["seeds"] for k in kinds)
        out["load_link_worst"] = min(k["right"] / k["seeds"] for k in kinds)
    minutes = [v for k, v in part.items() if k.startswith("minute_")]
    if minutes:
        seeds = [m["seeds"] for m in minutes]
        out["false_switches_per_min"] = float(
            np.average([m["false_per_min"] for m in minutes], weights=seeds)
        )
        out["walking_minutes"] = sum(seeds)
    steps = [v for k, v in part.items() if k.startswith("touchdowns_")]
    if steps:
        after = [x for s in steps for x in s["found_after_s"]]
        found = [np.inf if x is None else x for x in after]
        out["spike_kg"] = float(np.median([s["spike_kg"]["median"] for s in steps]))
        out["touchdowns"] = {
            "seeds": len(found),
            "spike_kg_worst_group": max(s["spike_kg"]["high"] for s in steps),
            "found_within_half_a_second": int(np.sum(np.array(found) <= 0.5)),
            "found_after_s_median": float(np.median(found)),
            "right_link": sum(s["right_link"] for s in steps),
            "false": sum(s["false"] for s in steps),
        }
    for name, figure in (("elbow", "elbow_rmse_rad"), ("pelvis", "pelvis_rmse_m")):
        loop = _controllers([v for k, v in part.items() if k.startswith(f"{name}_")])
        if loop:
            out[name], out[figure] = loop, loop["composite"]["rmse"]["median"]
    good = {
        (h["robot"], h["dtype"])
        for h in honest
        if h["filter"] == "exact" and h["trials"] >= TRIALS and h["nees_mean_in_bounds"]
    }
    out["nees_in_bounds"] = int(good >= ASKED)
    out["nees_in_bounds_of"] = sorted(map(list, good))
    return out


def commit_of(part: dict | list) -> str:
    """The code that a part was made by."""
    rows = part if isinstance(part, list) else [part]
    return ", ".join(dict.fromkeys(row["commit"] for row in rows))


def _controllers(parts: list[dict]) -> dict:
    """Summaries over all parts of an experiment in the loop, by controller."""
    names = [name for name in parts[0] if name not in ("seeds", "commit")] if parts else []
    return {
        name: {
            "rmse": summary(np.concatenate([p[name]["rmse"] for p in parts])),
            "fell": sum(p[name]["fell"] for p in parts),
            "unphysical": sum(p[name]["unphysical"] for p in parts),
        }
        for name in names
    }


if __name__ == "__main__":
    blind_ = json.loads((results.RESULTS / "paper.json").read_text())["blind"]
    found_ = {**gathered(Path(sys.argv[1])), "blind_up": blind_["rows"][-1]["up"]}
    found_["commits"]["blind"] = commit_of(blind_["about"])
    results.save_json(results.RESULTS / "online.json", {"about": results.circumstances(), **found_})
    shown = ("load_link", "load_link_worst", "false_switches_per_min", "spike_kg", "elbow_rmse_rad")
    more = ("pelvis_rmse_m", "blind_up", "nees_in_bounds", "touchdowns")
    print({k: found_.get(k) for k in (*shown, *more)})
