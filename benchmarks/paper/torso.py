"""Fig. 2: the torso's parameters while walking forward, by the baseline Kalman filter and by the log-Cholesky filter.

Both filters see the same walk; neither steers it (the controller is told the truth), so that one filter's failure
does not spoil the other's data. Prior, drift and noise are the same statement in physical units.
"""

import dataclasses

import numpy as np

from benchmarks.paper import pelvis
from benchmarks.paper.brain import ORACLE, Settings
from benchmarks.paper.figures import figure, legend, save
from benchmarks.paper.loop import Run, summary
from jax_inertia.charts import Chart, Linear, LogCholesky
from jax_inertia.priors import Load

DURATION = 20.0
SETTINGS = Settings(
    bodies=(pelvis.TORSO,), prior=Load(5.0, 0.25), drift=Load(2.0, 0.25), iterations=1
)
CHARTS: dict[str, Chart] = {"kf": Linear(), "ekf": LogCholesky()}
NOMINAL = 13.5  # kg
PI = ("mass", "ixx", "iyy", "izz")


def run(seeds: np.ndarray, duration: float = DURATION) -> dict[str, Run]:
    """A walk on level ground with the nominal torso, estimated in each chart."""
    walked = pelvis.walk(
        seeds,
        (ORACLE,),
        amplitude=0.0,
        mass=lambda t: NOMINAL,
        settings=SETTINGS,
        duration=duration,
        keep_inputs=True,
        label="torso",
    )
    return {
        name: pelvis.refiltered(walked, dataclasses.replace(SETTINGS, chart=chart))
        for name, chart in CHARTS.items()
    }


def results(seeds: np.ndarray, duration: float = DURATION) -> dict:
    """Counts of estimates that no body has, and how far mass and inertia stray."""
    runs = run(seeds, duration)
    out: dict = {"samples": len(runs["kf"].time) * len(seeds)}
    for name, found in runs.items():
        late = found.time > 3.0
        inertia = found.series["inertia"][late].astype(float)
        out[name] = {
            "unphysical": int(found.unphysical.sum()),
            "unphysical_per_run": summary(found.unphysical / len(found.time)),
            "negative_inertia": int((found.series["inertia"] <= 0).any(axis=-1).sum()),
            "mass_error_kg": summary(
                np.sqrt(np.mean((found.series["mass"][late] - NOMINAL).astype(float) ** 2, axis=0))
            ),
            "inertia_spread": [float(x) for x in np.median(inertia.std(axis=0), axis=0)],
            "fell": int(np.isfinite(found.fell).sum()),
        }
    _draw(runs)
    return out


def _draw(runs: dict[str, Run]) -> None:
    fig, axes = figure(4, height=7.2)
    labels = {"kf": "Kalman filter, linear in π", "ekf": "extended filter, log-Cholesky"}
    true = {"mass": NOMINAL, "ixx": 1.4583, "iyy": 1.4465, "izz": 0.3970}
    for axis, name in zip(axes, PI, strict=True):
        for k, (which, found) in enumerate(runs.items()):
            y = np.column_stack([found.series["mass"][:, 0], found.series["inertia"][:, 0]])
            axis.plot(found.time, y[:, PI.index(name)], lw=1, color=f"C{k}", label=labels[which])
        axis.axhline(true[name], color="k", lw=1, label="true")
        axis.set_ylabel("mass [kg]" if name == "mass" else f"I{name[1:]} [kg m²]")
    for axis in axes[1:]:
        axis.axhline(0.0, color="r", lw=0.6)
    legend(axes[0])
    axes[-1].set_xlabel("time [s]")
    save(fig, "paper_torso")
