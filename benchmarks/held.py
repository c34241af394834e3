"""`ji.estimate` on an arm whose links are known to a tolerance: does it find nothing where nothing is, and its ± hold?

    python -m benchmarks.held [LOGS [JOBS]]       # results/held.json; some ten seconds a log

An arm of six joints (`harness/pickup_log.py`, "spherical": none of `loads.py`'s table) moves for ten seconds, by
MuJoCo C's inverse dynamics, every other log with friction and offsets of 1 % of the largest torque. The model that the
estimate gets has masses, centres and radii of gyration of all links off by the tolerances that it states (2 %, 1 mm,
5 %; one standard deviation). In half of the logs the wrist holds nothing, in the others 0.5 to 10 times its own mass.
"""

import json
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor

import mujoco
import numpy as np
import scipy.stats

import jax_inertia as ji
from benchmarks.harness import pickup_log, results
from benchmarks.harness.pickup_log import WRIST
from jax_inertia.estimation.log_estimate import Z95, body_report
from jax_inertia.maths.inertial_parameters import PI_NAMES

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
    whole = ji.load_model(pickup_log.loaded(KIND, ratio * own))
    pi = dict(zip(PI_NAMES, np.asarray(whole.pi)[whole.body_index(WRIST)].tolist(), strict=True))
    com = np.array([pi[f"h{k}"] for k in "xyz"]) / pi["m"]
    ways, report = {}, body_report(found, 0)
    for way in ("batch", "online"):
        stated = report[way]
        error = [
            float(x) - pi["m"] for x in (stated["mass_kg"]["value"], *stated["mass_kg"]["ci95"])
        ]
        within = np.abs(np.asarray(stated["com_m"]) - com) <= stated["com_ci95_half_width_m"]
        ways[way] = {
            "error_kg": error[0],
            "holds": error[1] <= 0.0 <= error[2],
            "com_holds": within.tolist(),
            "pi_holds": [
                bool(abs(float(stated["pi"][k]) - x) <= Z95 * float(stated["pi_sigma"][k]))
                for k, x in pi.items()
            ],
        }
    return {
        "number": number,
        "ratio": ratio,
        "friction": friction,
        "p": float(found.held_p[0]),
        "refused": float(found.rejected_share),
        **ways,
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
                f"95 % interval of {what} holds, {way}": share(told)
                for way in ("batch", "online")
                for what, told in (
                    ("the mass", [x[way]["holds"] for x in some]),
                    ("a centre of mass", [y for x in some for y in x[way]["com_holds"]]),
                    ("a number of π", [y for x in some for y in x[way]["pi_holds"]]),
                )
            },
            "refused, largest share": max((x["refused"] for x in some), default=None),
        }
    return out


def main() -> None:
    """Log by log; what is written holds all that are done."""
    count, jobs = (int(x) for x in (*sys.argv[1:], *("100", "1")[len(sys.argv) - 1 :]))
    rows: list[dict] = []
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=spawn) as pool:
        for row in pool.map(one, range(count)):
            rows.append(row)
            print(json.dumps(row), flush=True)
            about = results.circumstances()
            results.save_json(RESULTS, {"about": about, "summary": summary(rows), "rows": rows})


if __name__ == "__main__":
    main()
