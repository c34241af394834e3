"""`ji.estimate` on an arm whose links are known to a tolerance: does it find nothing where nothing is, and its ± hold?

    python -m benchmarks.held [LOGS]              # results/held.json; some ten seconds a log

An arm of six joints (`harness/pickup_log.py`, "spherical": none of `loads.py`'s table) moves for ten seconds, by
MuJoCo C's inverse dynamics, every other log with friction and offsets of 1 % of the largest torque. The model that the
estimate gets has masses, centres and radii of gyration of all links off by the tolerances that it states (2 %, 1 mm,
5 %; one standard deviation). In half of the logs the wrist holds nothing, in the others 0.5 to 10 times its own mass.
"""

import json
import sys

import mujoco
import numpy as np
import scipy.stats

import jax_inertia as ji
from benchmarks.harness import pickup_log, results
from benchmarks.harness.pickup_log import WRIST
from jax_inertia.estimation.log_estimate import body_report

KIND, SECONDS, FRICTION = "spherical", 10.0, 0.01
MASS, CENTRE, GYRATION = 0.02, 0.001, 0.05
LIGHT, HEAVY = 0.5, 10.0
RESULTS = results.RESULTS / "held.json"


def off(model: mujoco.MjModel, rng: np.random.Generator) -> mujoco.MjModel:
    """The model with every link off by its tolerance."""
    bodies = np.arange(1, model.nbody)
    mass = 1.0 + MASS * rng.normal(size=len(bodies))
    wide = (1.0 + GYRATION * rng.normal(size=len(bodies))) ** 2
    model.body_mass[bodies] *= mass
    model.body_inertia[bodies] *= (mass * wide)[:, None]
    model.body_ipos[bodies] += CENTRE * rng.normal(size=(len(bodies), 3))
    return model


def one(number: int) -> dict:
    """What the estimate says of one log, and what is right."""
    rng, own = np.random.default_rng(7000 + number), pickup_log.own_mass(KIND)
    ratio = 0.0 if number % 4 < 2 else float(np.exp(rng.uniform(np.log(LIGHT), np.log(HEAVY))))
    friction = FRICTION * (number % 2)
    log = pickup_log.picked_up(
        KIND, ratio * own, seconds=SECONDS, seed=7000 + number, friction=friction
    )
    robot = ji.load_model(off(pickup_log.arm(KIND), rng))
    found = ji.estimate(robot, log, [WRIST])
    mass = {}
    for way in ("batch", "online"):
        stated = body_report(found, 0)[way]["mass_kg"]
        error = [float(x) - own * (1.0 + ratio) for x in (stated["value"], *stated["ci95"])]
        mass[way] = {"error_kg": error[0], "holds": error[1] <= 0.0 <= error[2]}
    return {
        "number": number,
        "ratio": ratio,
        "friction": friction,
        "p": float(found.held_p[0]),
        "refused": float(found.rejected_share),
        **mass,
    }


def summary(rows: list[dict]) -> dict:
    """Shares with their 95 % intervals (Wilson)."""

    def share(of: list[bool]) -> dict | None:
        if not of:
            return None
        low, high = scipy.stats.binomtest(sum(of), len(of)).proportion_ci(method="wilson")
        return {"of": len(of), "share": sum(of) / len(of), "low": float(low), "high": float(high)}

    out = {}
    for friction in (0.0, FRICTION):
        some = [x for x in rows if x["friction"] == friction]
        empty, full = ([x for x in some if (x["ratio"] > 0) is yes] for yes in (False, True))
        out["friction" if friction else "noise alone"] = {
            "empty hand, p < 0.01": share([x["p"] < 0.01 for x in empty]),
            "empty hand, p < 0.05": share([x["p"] < 0.05 for x in empty]),
            "load, p < 0.01": share([x["p"] < 0.01 for x in full]),
            **{
                f"95 % interval of the mass holds, {way}": share([x[way]["holds"] for x in some])
                for way in ("batch", "online")
            },
            "refused, largest share": max((x["refused"] for x in some), default=None),
        }
    return out


def main() -> None:
    """Log by log; what is written holds all that are done."""
    rows: list[dict] = []
    for number in range(int(sys.argv[1]) if len(sys.argv) > 1 else 100):
        rows.append(one(number))
        print(json.dumps(rows[-1]), flush=True)
        about = results.circumstances()
        results.save_json(RESULTS, {"about": about, "summary": summary(rows), "rows": rows})


if __name__ == "__main__":
    main()
