"""Gather what `all.sh` wrote into results/online.json: python -m benchmarks.online FOLDER

Elbow, pelvis and blind walks are the paper's experiments (results/paper.json), whose figures are watched here.
"""

import json
import sys
from pathlib import Path

import numpy as np

from benchmarks.harness import results

TRIALS = 1000
ASKED = {(r, d) for r in ("arm", "humanoid", "quadruped") for d in ("float32", "float64")}
"""What `nees_in_bounds` needs, all of it: a mean NEES within its 95 % bounds over so many trials."""


def gathered(folder: Path) -> dict:
    """Every part that ran, and the figures that are watched."""
    part = {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}
    out: dict = {}
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
    good = {
        (h["robot"], h["dtype"])
        for h in honest
        if h["filter"] == "exact" and h["trials"] >= TRIALS and h["nees_mean_in_bounds"]
    }
    out["nees_in_bounds"] = int(good >= ASKED)
    out["nees_in_bounds_of"] = sorted(map(list, good))
    return out


def in_the_loop(paper: dict) -> dict:
    """The paper's figures of composite adaptation and of blind walks."""
    highest = max(paper["blind"]["rows"], key=lambda row: row["amplitude_m"])
    return {
        "elbow_rmse_rad": paper["elbow"]["composite"],
        "pelvis_rmse_m": paper["pelvis"]["composite"],
        "blind_up": highest["up"],
        "paper_commits": {k: paper[k]["about"]["commit"] for k in ("elbow", "pelvis", "blind")},
    }


if __name__ == "__main__":
    paper_ = json.loads((results.RESULTS / "paper.json").read_text())
    found_ = {**gathered(Path(sys.argv[1])), **in_the_loop(paper_)}
    results.save_json(results.RESULTS / "online.json", {"about": results.circumstances(), **found_})
    shown = ("load_link", "load_link_worst", "false_switches_per_min", "spike_kg", "elbow_rmse_rad")
    more = ("pelvis_rmse_m", "blind_up", "nees_in_bounds", "touchdowns")
    print({k: found_.get(k) for k in (*shown, *more)})
