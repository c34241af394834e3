"""Gather what `all.sh` wrote into results/online.json: python -m benchmarks.online FOLDER"""

import json
import sys
from pathlib import Path

import numpy as np

from benchmarks.harness import results


def gathered(folder: Path) -> dict:
    """Every part that ran, and the figures that are watched."""
    part = {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}
    out: dict = {}
    honest = [v for k, v in part.items() if k.startswith("honest_")]
    out["covariance"] = honest
    links = {k.removeprefix("links_"): v for k, v in part.items() if k.startswith("links_")}
    out["links"] = links
    if links:
        kinds = [kind for robot in links.values() for kind in robot.values()]
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
    elbow = [v for k, v in part.items() if k.startswith("elbow")]
    if elbow:
        out["elbow_rmse_rad"] = float(np.median([e["rmse_rad"]["median"] for e in elbow]))
        out["elbow"] = elbow
    exact = [h for h in honest if h["filter"] == "exact"]
    out["nees_in_bounds"] = int(bool(exact) and all(h["nees_mean_in_bounds"] for h in exact))
    return out


if __name__ == "__main__":
    found_ = gathered(Path(sys.argv[1]))
    results.save_json(results.RESULTS / "online.json", {"about": results.circumstances(), **found_})
    shown = ("load_link", "load_link_worst", "false_switches_per_min", "spike_kg", "elbow_rmse_rad")
    print({k: found_.get(k) for k in (*shown, "nees_in_bounds", "touchdowns")})
