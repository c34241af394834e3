"""Fig. 2: the torso's parameters while walking forward, by the baseline Kalman filter and by the log-Cholesky filter.

All filters see the same walk; none steers it (the controller is told the truth), so that one filter's failure
does not spoil another's data. Prior, drift and noise are the same statement in physical units. Each filter runs as in
the paper, which takes accelerations for exact, and with their noise told apart.
"""

import dataclasses

import numpy as np

from benchmarks.paper import pelvis
from benchmarks.paper.brain import ORACLE, Settings
from benchmarks.paper.figures import figure, legend, save
from benchmarks.paper.loop import Run, summary
from benchmarks.paper.plant import Sensors, model
from benchmarks.paper.shared_out import Wanted, every
from jax_inertia.estimation.priors import Load
from jax_inertia.maths.charts import Chart, Linear, LogCholesky
from jax_inertia.model.load import body_pi

DURATION = 20.0
# A torso held upright turns so little that differences over 9 ms are mostly noise, and what a filter that may drift
# makes of them is its last few samples: 30 ms and 0.1 kg/√s are what seeds from 1000 on showed.
SENSORS = Sensors(window=30, fitted=True)
PAPER = Settings(bodies=(pelvis.TORSO,), prior=Load(5.0, 0.25), drift=Load(0.1, 0.25), iterations=1)
CORRECTED = dataclasses.replace(PAPER, noisy_regressor=True)
CHARTS: dict[str, Chart] = {"kf": Linear(), "ekf": LogCholesky()}
NOMINAL = 13.5  # kg
PI = ("mass", "ixx", "iyy", "izz")


def nominal(t: float) -> float:
    """The torso's mass, whenever [kg]."""
    return NOMINAL


def run(seeds: np.ndarray, duration: float = DURATION) -> dict[str, Run]:
    """A walk on level ground with the nominal torso, estimated in each chart, without and with the correction."""
    own = {
        "amplitude": 0.0,
        "mass": nominal,
        "settings": PAPER,
        "sensors": SENSORS,
        "duration": duration,
        "keep_inputs": True,
        "label": "torso",
    }
    (walked,) = every([Wanted(pelvis.walk, seeds, (ORACLE,), own)])
    return {
        name + suffix: pelvis.refiltered(
            walked, dataclasses.replace(settings, chart=chart), SENSORS
        )
        for suffix, settings in (("", PAPER), ("_corrected", CORRECTED))
        for name, chart in CHARTS.items()
    }


def results(seeds: np.ndarray, duration: float = DURATION) -> dict:
    """Counts of estimates that no body has, and how far mass and inertia stray."""
    runs = run(seeds, duration)
    out: dict = {"samples": len(runs["kf"].time) * len(seeds), "inertia_true": truth()[1:]}
    for name, found in runs.items():
        late = found.time > 3.0
        inertia = found.series["inertia"][late].astype(float)
        mean = inertia.mean(axis=0)
        out[name] = {
            "unphysical": int(found.unphysical.sum()),
            "unphysical_per_run": summary(found.unphysical / len(found.time)),
            "negative_inertia": int((found.series["inertia"] <= 0).any(axis=-1).sum()),
            "mass_error_kg": summary(
                np.sqrt(np.mean((found.series["mass"][late] - NOMINAL).astype(float) ** 2, axis=0))
            ),
            "inertia_mean": [summary(x) for x in mean.T],
            "inertia_spread": [float(x) for x in np.median(inertia.std(axis=0), axis=0)],
            "fell": int(np.isfinite(found.fell).sum()),
        }
    _draw(runs)
    return out


def truth() -> list[float]:
    """What `PI` names, of the plant's torso [kg, kg m²]."""
    plant = model()
    return [float(x) for x in body_pi(plant, plant.body(pelvis.TORSO).id)[[0, 4, 7, 9]]]


def _draw(runs: dict[str, Run]) -> None:
    fig, axes = figure(4, height=7.2)
    labels = {
        "kf": "Kalman filter",
        "ekf": "extended",
        "kf_corrected": "Kalman, noise apart",
        "ekf_corrected": "extended, noise apart",
    }
    for axis, name, true in zip(axes, PI, truth(), strict=True):
        for k, (which, found) in enumerate(runs.items()):
            y = np.column_stack([found.series["mass"][:, 0], found.series["inertia"][:, 0]])
            axis.plot(found.time, y[:, PI.index(name)], lw=1, color=f"C{k}", label=labels[which])
        axis.axhline(true, color="k", lw=1, label="true")
        axis.set_ylabel("mass [kg]" if name == "mass" else f"I{name[1:]} [kg m²]")
    for axis in axes[1:]:
        axis.axhline(0.0, color="r", lw=0.6)
    legend(axes[0])
    axes[-1].set_xlabel("time [s]")
    save(fig, "paper_torso")
