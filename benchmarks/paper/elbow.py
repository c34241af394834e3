"""Table II, elbow: holding the home pose while the forearm's mass follows Table I's waveform.

The link's mass is the waveform's, its inertia in proportion and its centre of mass where it was. Besides the
controllers one is told the truth, but as late as the filter is found to be: what lag alone costs.
"""

import dataclasses

import numpy as np

from benchmarks.paper.brain import (
    ADAPTIVE,
    GAINS,
    MODES,
    NONE,
    ORACLE,
    Settings,
    make_brain,
)
from benchmarks.paper.figures import figure, legend, save
from benchmarks.paper.loop import Run, by_controller, crew, drive, rms, summary
from benchmarks.paper.plant import TICK, Fleet, LinkMass, Sensors, model
from benchmarks.paper.shared_out import Wanted, every
from benchmarks.paper.strides import standing
from jax_inertia.estimation.priors import Load, Tolerance
from jax_inertia.model.load import body_pi

FOREARM, JOINT = "left_elbow_pitch_link", "left_elbow_y"
SETTLE, DURATION = 1.0, 17.0  # s: one second of the bare arm, then the waveform
SETTINGS = Settings(
    bodies=(FOREARM,),
    prior=Load(4.0, 0.15),
    drift=Tolerance(mass=8.0, com=0.02, spread=0.1),
    iterations=2,
    damping=120.0,
)
LATE = len(MODES)
"""In a run's `mode`: those who are told the truth late."""
LAG = 0.009  # s, about what the filter needs for 63 % of a jump (see `lag` in the results)


SENSORS = Sensors()


def waveform(t: float) -> float:
    """Table I: 4.5 kg, amplitude 3 kg, 1 Hz, a sine and from 8 s on a square wave [kg]."""
    wave = float(np.sin(2 * np.pi * t))
    if t >= 8.0:
        wave = 1.0 if wave >= 0 else -1.0
    return 4.5 + 3.0 * wave


def run(
    seeds: np.ndarray,
    modes: tuple[int, ...] = (NONE, ADAPTIVE, ORACLE),
    *,
    sensors: Sensors = SENSORS,
    stiffness: float = 100.0,
    nominal_mass: float | None = None,
    duration: float = DURATION,
) -> Run:
    """Errors of the elbow [rad] and estimated masses [kg]; those of mode `LATE` are told the truth late."""
    plant = model()
    gains = dataclasses.replace(GAINS, posture=(stiffness, 2.0 * stiffness**0.5))
    brain = make_brain(
        plant, SETTINGS, sensors, standing(plant), gains=gains, nominal_mass=nominal_mass
    )
    group, seed = crew(seeds, modes)
    mode = np.where(group == LATE, ORACLE, group)
    fleet = Fleet(plant, seed, sensors)
    link = LinkMass(plant, FOREARM)
    body, joint = plant.body(FOREARM).id, plant.joint(JOINT).qposadr[0]
    home = plant.key_qpos[0][joint]
    told: list[np.ndarray] = []

    def truth(t: float) -> np.ndarray:
        if t >= SETTLE:
            link.set(waveform(t - SETTLE))
        told.append(body_pi(plant, body))
        old = told[max(0, len(told) - 1 - round(LAG / TICK))]
        return np.where((group == LATE)[:, None, None], old, told[-1])

    def watch(fleet: Fleet, out) -> dict[str, np.ndarray]:
        return {
            "error": fleet.q[:, joint] - home,
            "mass": out.pi[:, 0, 0],
            "true": np.full(fleet.size, link.mass),
        }

    found = drive(brain, fleet, mode, seed, duration, watch, truth=truth, label="elbow")
    return dataclasses.replace(found, mode=group)


def lag(found: Run, group: int) -> np.ndarray:
    """Time to 63 % of each jump of the square wave [s], median over the jumps of each robot."""
    true = found.series["true"][:, 0]
    jumps = np.flatnonzero(np.abs(np.diff(true)) > 5.0) + 1
    jumps = jumps[jumps + 60 < len(true)]
    delays = []
    for k in jumps:
        share = (found.series["mass"][k : k + 60, found.mode == group] - true[k - 1]) / (
            true[k] - true[k - 1]
        )
        delays.append(np.argmax(share > 0.63, axis=0) * TICK)
    return np.median(delays, axis=0)


def results(seeds: np.ndarray, sweep_seeds: np.ndarray) -> dict:
    """Everything that the report says of this experiment."""
    cells = ((25.0, None), (100.0, None), (400.0, None), (100.0, 4.5))
    wanted = [Wanted(run, seeds, (*range(len(MODES)), LATE))]
    for stiffness, nominal in cells:
        own = {"stiffness": stiffness, "nominal_mass": nominal}
        wanted.append(Wanted(run, sweep_seeds, (NONE, ADAPTIVE, ORACLE), own))
    found, *parts = every(wanted)
    on = found.time >= SETTLE
    error = rms(found.series["error"][on])
    out = by_controller(found.mode, error)
    out["oracle_late"] = summary(error[found.mode == LATE])
    out["assumed_lag_s"] = LAG
    out["lag_s"] = summary(lag(found, ADAPTIVE))
    steady = on & (found.time < SETTLE + 8.0)
    mass = (found.series["mass"] - found.series["true"])[:, found.mode == ADAPTIVE]
    out["mass_rmse_kg"] = {
        "sine": summary(rms(mass[steady])),
        "square": summary(rms(mass[on & ~steady])),
    }
    out["unphysical"] = int(found.unphysical.sum())
    out["unsolved"] = float(found.unsolved.max())
    out["fell"] = int(np.isfinite(found.fell).sum())
    out["sweep"] = []
    for (stiffness, nominal), part in zip(cells, parts, strict=True):
        e = rms(part.series["error"][part.time >= SETTLE])
        row = {MODES[i]: float(np.median(e[part.mode == i])) for i in np.unique(part.mode)}
        out["sweep"].append({"stiffness": stiffness, "nominal_mass": nominal or 0.6007, **row})
    _draw(found)
    return out


def _draw(found: Run) -> None:
    fig, axes = figure(2, height=4.6)
    first = found.seed == found.seed[0]
    for i, name in enumerate(MODES):
        axes[0].plot(
            found.time - SETTLE,
            found.series["error"][:, first & (found.mode == i)],
            label=name,
            lw=1,
        )
    axes[0].set_ylabel("elbow error [rad]")
    legend(axes[0])
    adaptive = first & (found.mode == 1)
    axes[1].plot(
        found.time - SETTLE, found.series["mass"][:, adaptive], lw=1, color="C1", label="estimate"
    )
    axes[1].plot(
        found.time - SETTLE, found.series["true"][:, adaptive], lw=1, color="k", label="true"
    )
    axes[1].set_ylabel("forearm mass [kg]")
    legend(axes[1])
    axes[1].set_xlabel("time [s]")
    save(fig, "paper_elbow")
