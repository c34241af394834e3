"""The demo's one figure."""

import numpy as np
from matplotlib.figure import Figure

from jax_inertia.cli.demo.comparison import Comparison
from jax_inertia.cli.plots import BLUE, GREEN, ORANGE, band, limits, nis_axes, physical_strip

_STYLES = {"KF, linear": (ORANGE, "-"), "EKF, paper's UᵀU": (GREEN, ":"), "EKF, U Uᵀ": (BLUE, "-")}


def draw(comparison: Comparison, figure: Figure | None = None) -> Figure:
    """Mass of the load, smallest eigenvalue of the pseudo-inertia, physical check and NIS, for all the filters."""
    figure = Figure(figsize=(9.0, 9.5), layout="constrained") if figure is None else figure
    time, runs = comparison.time, comparison.runs
    mass, eigen, strip, nis = figure.subplots(
        4, 1, sharex=True, gridspec_kw={"height_ratios": [4, 2.4, 1.1, 2.6]}
    )
    for run in runs:
        colour, line = _STYLES[run.name]
        band(mass, time, run.load, run.sigma, colour, line, run.name)
        eigen.plot(time, run.smallest, color=colour, ls=line, lw=1.3)
    mass.plot(
        time, comparison.truth, color="black", lw=1, ls="--", label="truth", drawstyle="steps-mid"
    )
    limits(mass, np.append(runs[-1].load, comparison.truth), np.tile(runs[-1].sigma, 2))
    mass.set_ylabel("load in the hand [kg]")
    mass.legend(loc="upper left", fontsize=9, title="estimate ± 2 σ", title_fontsize=9)
    mass.set_title("An arm picks up an unknown load, and puts it down (MuJoCo)", loc="left")

    eigen.axhline(0.0, color="black", lw=1)
    eigen.set_yscale("symlog", linthresh=1e-4)
    eigen.set_ylabel("smallest eigenvalue of\nthe pseudo-inertia [kg m²]")
    eigen.text(0.42, 0.1, "below zero: no such body exists", transform=eigen.transAxes, fontsize=9)

    physical_strip(strip, time, [run.physical for run in runs], [run.name for run in runs])
    strip.set_title("dark: the estimate is no physical body", fontsize=9, loc="left", pad=3)
    for k, run in enumerate(runs):
        text = f" {run.score.unphysical} not"
        strip.text(time[-1], k, text, va="center", fontsize=9)

    nis_axes(nis, time, runs[-1].trace)
    nis.set_ylabel("NIS of a sample [–]\n(EKF, U Uᵀ)")
    for axes in (mass, eigen, nis):
        for event in (comparison.scenario.pick_up, comparison.scenario.put_down):
            axes.axvline(event, color="black", lw=0.8, ls=(0, (1, 3)))
    return figure
