"""RESULTS.md from the numbers: every table with its floor and its range beside it."""

from typing import Any


def report(found: dict[str, Any]) -> str:
    """The page; experiments that have not run are left out."""
    parts = [_HEAD]
    for name, write in _SECTIONS.items():
        if name in found:
            parts.append(write(found[name]))
    parts.append(_ran(found))
    if "unphysical" in found:
        count = found["unphysical"]
        parts.append(
            "## Unphysical estimates\n\n"
            f"Kalman filter (Fig. 2): {count['kf']}. Extended filters, all experiments: {count['ekf']}.\n"
        )
    return "\n".join(parts)


_HEAD = """# The paper's experiments in closed loop

Written by `python -m benchmarks.paper`. The plant is MuJoCo C at 1 kHz with noisy sensors (`plant.py`), controller and
estimator run at 333 Hz (`brain.py`), the robot is Nadia from published figures. Four controllers: *none* believes the
nominal masses, *adaptive* the filter, *composite* the filter moved by the tasks' error, *oracle* is told the truth: the
floor. Numbers are medians over seeds with the range of nine seeds in ten in brackets. Settings were chosen on seeds
from 1000 on, numbers are of seeds 0, 1, 2, …
"""


def _ran(found: dict[str, Any]) -> str:
    rows = [
        [name, *(x["run"][k] for k in ("seeds", "sweep_seeds", "first_seed")), x["wall_s"], *_of(x)]
        for name in _SECTIONS
        for x in [found.get(name)]
        if x is not None
    ]
    head = [
        "experiment",
        "seeds",
        "seeds of each sweep or variant",
        "first seed",
        "time [s]",
        "commit",
    ]
    left = [name for name in _SECTIONS if name not in found]
    note = f"\nNot run yet: {', '.join(left)}.\n" if left else ""
    return "## What ran\n\n" + _table(head, rows) + note


def _of(x: dict[str, Any]) -> list[str]:
    """The commit that it is of; older results do not say."""
    return [x.get("about", {}).get("commit", "")]


def _span(x: dict[str, float], scale: float = 1.0, digits: int = 4) -> str:
    low, mid, high = (f"{scale * x[k]:.{digits}f}" for k in ("low", "median", "high"))
    return f"{mid} ({low} to {high})"


def _ratio(x: dict[str, Any]) -> str:
    return f"{x['none'] / x['adaptive']:.0f}×"


_CONTROLLERS = ("none", "adaptive", "oracle", "composite")


def _composite(x: dict[str, Any], scale: float = 1.0, digits: int = 4) -> str:
    """The filter with the tasks' error beside it; results from before it was have none."""
    own = x["intervals"].get("composite")
    return "" if own is None else _span(own, scale, digits)


def _table(head: list[str], rows: list[list[Any]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


AXES = ("Ixx", "Iyy", "Izz")


def _torso(x: dict[str, Any]) -> str:
    filters = {
        "kf": "Kalman filter",
        "ekf": "extended, log-Cholesky",
        "kf_corrected": "Kalman filter, noise told apart",
        "ekf_corrected": "extended, noise told apart",
    }
    rows = [
        [
            title,
            f"{x[k]['unphysical']} of {x['samples']}",
            x[k]["negative_inertia"],
            _span(x[k]["mass_error_kg"], digits=2),
            *(_span(mean, digits=2) for mean in x[k]["inertia_mean"]),
            " / ".join(f"{v:.2f}" for v in x[k]["inertia_spread"]),
        ]
        for k, title in filters.items()
    ]
    true = [f"{axis} (true {v:.2f})" for axis, v in zip(AXES, x["inertia_true"], strict=True)]
    head = ["filter", "unphysical estimates", "with a negative diagonal", "mass RMSE [kg]", *true]
    return (
        "## Fig. 2: torso while walking forward\n\n"
        "Inertias [kg m²]: mean over time, and the spread over time. All filters start at the truth. The paper's take "
        "accelerations for exact; they are noisy, and that draws inertias towards zero. *Told apart*: the filter knows "
        "how noisy they are.\n\n"
        + _table([*head, "spread of Ixx / Iyy / Izz"], rows)
        + "\n![Torso](../figures/paper_torso.png)\n"
    )


def _elbow(x: dict[str, Any]) -> str:
    rows = [
        ["paper", "1.0956", "0.1499", "", "", "7.3×"],
        [
            f"{x['run']['seeds']} seeds",
            *(_span(x["intervals"][m]) for m in ("none", "adaptive", "oracle")),
            _composite(x),
            _ratio(x),
        ],
    ]
    sweep = [
        [f"{r['stiffness']:g}", f"{r['nominal_mass']:.1f}"]
        + [f"{r[m]:.4f}" for m in ("none", "adaptive", "oracle")]
        + [f"{r['none'] / r['adaptive']:.0f}×"]
        for r in x["sweep"]
    ]
    lag = 1000 * x["lag_s"]["median"]
    return (
        "## Table II, elbow: forearm 4.5 ± 3 kg, 1 Hz, sine and after 8 s square\n\n"
        "RMSE of the elbow's angle [rad].\n\n"
        + _table(["", "none", "adaptive", "oracle", "composite", "none / adaptive"], rows)
        + f"\nWhat lag contributes: the estimate reaches 63 % of a jump after {lag:.1f} ms; a controller that is told "
        f"the exact mass {1000 * x['assumed_lag_s']:.0f} ms late has {_span(x['oracle_late'])} rad. The mass's own "
        f"RMSE is {_span(x['mass_rmse_kg']['sine'], digits=2)} kg on the sine and "
        f"{_span(x['mass_rmse_kg']['square'], digits=2)} kg on the square.\n\n"
        "Sweep over the arm's stiffness [1/s²] and over what the robot takes the forearm to weigh [kg]:\n\n"
        + _table(["stiffness", "nominal mass", "none", "adaptive", "oracle", "ratio"], sweep)
        + "\n![Elbow](../figures/paper_elbow.png)\n"
    )


def _pelvis(x: dict[str, Any]) -> str:
    rows = [
        ["paper, RMSE", "35.2", "15.7", "", "", "2.2×"],
        [
            f"{x['run']['seeds']} seeds, RMSE",
            *(_span(x["intervals"][m], 1000, 2) for m in ("none", "adaptive", "oracle")),
            _composite(x, 1000, 2),
            _ratio(x),
        ],
        ["falls", *(x["falls_by_controller"].get(m, "") for m in _CONTROLLERS), ""],
    ]
    sweep = [
        [f"{r['stiffness']:g}", f"{r['nominal_mass']:.1f}"]
        + [f"{1000 * r[m]:.2f}" for m in ("none", "adaptive", "oracle")]
        + [f"{r['none'] / r['adaptive']:.0f}×", r["falls"]]
        for r in x["sweep"]
    ]
    return (
        f"## Table II, pelvis: {x['duration_s']:.0f} s over boxes of ±3 cm, torso 30 ± 5 kg, square, 0.2 Hz\n\n"
        "RMSE of the pelvis's height about its reference [mm]; the robot knows the ground's height and steps on boxes, "
        "not on their edges.\n\n"
        + _table(["", "none", "adaptive", "oracle", "composite", "none / adaptive"], rows)
        + f"\nNone and oracle, which have no filter: {x['intervals']['none']['seeds']} seeds. Distance walked: "
        f"{x['distance_m']['adaptive']:.1f} m (adaptive). Torso mass RMSE: "
        f"{_span(x['mass_rmse_kg'], digits=2)} kg. Ticks whose program did not converge: "
        f"{100 * x['unsolved']:.3f} % in the worst run.\n\n"
        "Sweep over the height task's stiffness [1/s²] and the nominal mass [kg], 15 s, RMSE [mm]:\n\n"
        + _table(
            ["stiffness", "nominal mass", "none", "adaptive", "oracle", "ratio", "falls"], sweep
        )
        + "\n![Pelvis](../figures/paper_pelvis.png)\n"
    )


def _blind(x: dict[str, Any]) -> str:
    blind = [
        [
            f"±{100 * r['amplitude_m']:g} cm",
            f"{r['up']} of {r['of']}",
            f"{r['seconds_up']:.0f}",
            _span(r["rmse"], 1000, 2),
        ]
        for r in x["rows"]
    ]
    return (
        f"## Blind: {x['duration_s']:.0f} s over boxes of unknown height, adaptive, torso 30 ± 5 kg\n\n"
        "The robot takes the next step to be as high as its last ones were, a mean that forgets.\n\n"
        + _table(["boxes", "still up", "median time up [s]", "RMSE while up [mm]"], blind)
    )


def _curl(x: dict[str, Any]) -> str:
    rows = [
        [
            f"{x['run']['seeds']} seeds",
            *(_span(x["intervals"][m], digits=3) for m in ("none", "adaptive", "oracle")),
        ]
    ]
    variants = [
        [
            r["variant"],
            _span(r["mass_error_percent"], digits=1),
            _span(r["ripple_percent"], digits=1),
            _span(r["in_step_percent"], digits=2),
            f"{r['rmse']:.3f}",
        ]
        for r in x["variants"]
    ]
    return (
        "## Curls: 5.44 kg that the robot was not told of, on hardware that its model does not describe\n\n"
        "Joint friction, damping, cables and a hoist are in the plant only; the bias is calibrated at start-up. RMSE "
        "of the elbow about its reference [rad]:\n\n"
        + _table(["", "none", "adaptive", "oracle"], rows)
        + f"\nForearm and dumbbell: mass off by {_span(x['estimate']['mass_error_percent'], digits=1)} %, ripple "
        f"{_span(x['estimate']['ripple_percent'], digits=1)} % (half of peak to peak after "
        f"a mean over 0.1 s); {_span(x['estimate']['in_step_percent'], digits=2)} % repeats with the curl (first three "
        "harmonics), the rest is noise. Which effect does what:\n\n"
        + _table(["variant", "mass error [%]", "ripple [%]", "in step [%]", "RMSE [rad]"], variants)
        + "\n![Curl](../figures/paper_curl.png)\n"
    )


def _curl_causes(x: dict[str, Any]) -> str:
    effects = [
        [e["family"], e["place"], "; ".join(e["sizes"]), f"{e['explained']:.1%}"]
        for e in x["diagnosis"]["effects"]
    ]
    rows = [
        [
            r["variant"],
            r["ripple_percent"]["seeds"],
            _span(r["mass_error_percent"], digits=1),
            _span(r["ripple_percent"], digits=2),
            _span(r["in_step_percent"], digits=2),
        ]
        for r in (*x["rows"], *x["parts"])
    ]
    shrink, share = x["diagnosis"]["heldout"], x["share"]
    left = f" It could not be told of: {'; '.join(x['left_out'])}." if x["left_out"] else ""
    return (
        "## Curls: what the mass ripples with, as `diagnose` finds it\n\n"
        "A log of one run's last three curls (`curl_causes.py`), the forearm as the estimator found it: "
        f"*{x['diagnosis']['verdict']}*, missing torque {shrink['before']:.2f} → {shrink['after']:.2f} N m held out "
        f"(noise {shrink['noise']:.2f}).\n\n"
        + _table(["effect", "where", "size, 95 % interval", "explains"], effects)
        + "\nThe other runs' sensors, read again by an estimator whose model has these effects:\n\n"
        + _table(["estimator", "seeds", "mass error [%]", "ripple [%]", "in step [%]"], rows)
        + f"\nThe share of these effects: {share['ripple_percent']['of_all']:.0%} of the ripple and "
        f"{share['in_step_percent']['of_all']:.0%} of what is in step with the curl; of what is over the floor "
        f"{share['ripple_percent']['over_floor']:.0%} and {share['in_step_percent']['over_floor']:.0%}.{left}\n"
        "\n![Causes](../figures/paper_curl_causes.png)\n"
    )


def _gating(x: dict[str, Any]) -> str:
    rows = [
        [
            kind,
            _span(x[kind]["spike_kg"], digits=2),
            _span(x[kind]["bias_kg"], digits=2),
            f"{100 * x[kind]['rejected']:.1f}",
            f"{x[kind]['load_found_within_1s']} of {x['run']['seeds']}",
            "not always" if found is None else _span(found, digits=2),
        ]
        for kind in x
        if isinstance(x[kind], dict) and "spike_kg" in x[kind]
        for found in [x[kind]["load_found_s"]]
    ]
    head = ["", "spike at touchdown [kg]", "bias [kg]", "rejected [%]", "10 kg found within 1 s"]
    return (
        "## Gating: walking in place, hard touchdowns, sampled contact forces\n\n"
        + _table([*head, "after [s]"], rows)
        + f"\nSpikes are {x['spikes_times_smaller']:.1f} times smaller with the gate.\n"
        + "\n![Gating](../figures/paper_gating.png)\n"
    )


_SECTIONS = {
    "torso": _torso,
    "elbow": _elbow,
    "pelvis": _pelvis,
    "blind": _blind,
    "curl": _curl,
    "curl_causes": _curl_causes,
    "gating": _gating,
}
