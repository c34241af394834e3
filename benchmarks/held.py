"""`ji.estimate` on arms whose links are known to a tolerance: does it find nothing where nothing is, and its ± hold?

    python -m benchmarks.held [LOGS [JOBS]]       # results/held.json; some ten seconds a log

Arms of three to seven joints, drawn by chance (`harness/pickup_log.py`, sixteen logs each), move for ten seconds, by
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

SECONDS, FRICTION = 10.0, 0.01
EACH = 16  # logs of one arm: what is compiled for it serves them all
MASS, CENTRE, GYRATION = 0.02, 0.001, 0.05
LIGHT, HEAVY = 0.5, 10.0
RESULTS, PAGE = results.RESULTS / "held.json", results.HERE.parent / "docs/online.md"


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
    kind, rng = f"drawn {number // EACH}", np.random.default_rng(7000 + number)
    own = pickup_log.own_mass(kind)
    ratio = 0.0 if number % 4 < 2 else float(np.exp(rng.uniform(np.log(LIGHT), np.log(HEAVY))))
    friction = FRICTION * (number % 2)
    log = pickup_log.picked_up(
        kind, ratio * own, seconds=SECONDS, seed=7000 + number, friction=friction
    )
    robot = ji.load_model(off(pickup_log.arm(kind), rng))
    found = ji.estimate(robot, log, [WRIST])
    whole = ji.load_model(pickup_log.loaded(kind, ratio * own))
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
            "holds": bool(error[1] <= 0.0 <= error[2]),
            "com_hold": int(within.sum()),
            "pi_hold": sum(
                abs(float(stated["pi"][k]) - x) <= Z95 * float(stated["pi_sigma"][k])
                for k, x in pi.items()
            ),
        }
    return {
        "number": number,
        "arm": kind,
        "ratio": ratio,
        "friction": friction,
        "p": float(found.held_p[0]),
        "refused": float(found.rejected_share),
        **ways,
    }


def summary(rows: list[dict]) -> dict:
    """Shares with their 95 % intervals (Wilson)."""

    def share(hits: list, each: int = 1) -> dict | None:
        """Of `each` that every log has."""
        if not hits:
            return None
        of = each * len(hits)
        low, high = scipy.stats.binomtest(sum(hits), of).proportion_ci(method="wilson")
        return {"of": of, "share": sum(hits) / of, "low": float(low), "high": float(high)}

    out = {}
    for friction in (0.0, FRICTION):
        some = [x for x in rows if x["friction"] == friction]
        empty, full = ([x for x in some if (x["ratio"] > 0) is yes] for yes in (False, True))
        out["friction" if friction else "noise alone"] = {
            "empty hand, p < 0.01": share([x["p"] < 0.01 for x in empty]),
            "empty hand, p < 0.05": share([x["p"] < 0.05 for x in empty]),
            "load, p < 0.01": share([x["p"] < 0.01 for x in full]),
            **{
                f"95 % interval of {what} holds, {way}": share([x[way][key] for x in some], each)
                for way in ("batch", "online")
                for what, key, each in (
                    ("the mass", "holds", 1),
                    ("a centre of mass", "com_hold", 3),
                    ("a number of π", "pi_hold", 10),
                )
            },
            "refused, largest share": max((x["refused"] for x in some), default=None),
        }
    return out


def page(summary: dict[str, dict]) -> str:
    """The table of shares, by what the logs hold; counts where logs are counted."""

    def cell(x: dict | float | None) -> str:
        if not isinstance(x, dict):
            return "–" if x is None else f"{100 * x:.0f} %"
        return (
            f"{round(x['share'] * x['of'])} of {x['of']}, {100 * x['share']:.1f} % "
            f"[{100 * x['low']:.1f}, {100 * x['high']:.1f}]"
        )

    names = next(iter(summary.values()))
    rows = [[name, *(cell(column[name]) for column in summary.values())] for name in names]
    return results.table(["", *summary], rows)


def main() -> None:
    """Log by log; what is written holds all that are done."""
    count, jobs = (int(x) for x in (*sys.argv[1:], *("100", "1")[len(sys.argv) - 1 :]))
    rows: list[dict] = []
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=spawn) as pool:
        for row in pool.map(one, range(count), chunksize=EACH):
            rows.append(row)
            print(json.dumps(row), flush=True)
            about, found = results.circumstances(), summary(rows)
            results.save_json(RESULTS, {"about": about, "summary": found, "rows": rows})
    results.write_part("held", f"{page(found)}\n\n{results.sentence(about)}", PAGE)


if __name__ == "__main__":
    main()
