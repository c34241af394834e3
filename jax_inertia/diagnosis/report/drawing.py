"""Style of the reports' figures, and those that every diagnosis has. Colours are Okabe and Ito's, which colour-blind
readers tell apart."""

import base64
import io
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from jax_inertia.diagnosis.simulate.rollout import Rollouts

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#8a8f98"
STYLE: dict[Any, Any] = {
    # Names come from files: a `$` in one is a character, not mathematics.
    "text.parse_math": False,
    "svg.fonttype": "path",
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e3e6ea",
    "grid.linewidth": 0.6,
    "axes.edgecolor": "#8a8f98",
    "legend.frameon": False,
}
WIDTH = 4.8  # inches: letters stay legible on a phone


def embedded(figure: Figure) -> str:
    """A figure as the data URI of an SVG."""
    out = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure.savefig(out, format="svg", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(out.getvalue()).decode()


FAR = 10.0
"""From so many times less than before, errors are drawn on a logarithmic scale."""


def fan(rolled: Rollouts) -> str:
    """How far simulation and log part over a window: before, after, floor."""
    with mpl.rc_context(STYLE):
        figure = Figure((WIDTH, 3.0), layout="constrained")
        axes = figure.subplots()
        milliseconds = 1e3 * rolled.time
        for error, colour, label in (
            (rolled.nominal, GREY, "before: as modelled"),
            (rolled.corrected, ORANGE, "after: corrected"),
            (rolled.noise, BLUE, "floor: noise, model's errors"),
        ):
            size = rolled.shown * np.sqrt(np.mean(error**2, axis=2))
            low, high = np.quantile(size, [0.1, 0.9], axis=0)
            axes.fill_between(milliseconds, low, high, color=colour, alpha=0.2, lw=0)
            whole = np.sqrt(np.mean(size**2, axis=0))
            axes.plot(milliseconds, whole, color=colour, lw=1.6, label=label)
        axes.set(xlabel="time from the window's start [ms]", ylabel=f"error [{rolled.shown_in}]")
        axes.set_xlim(0, milliseconds[-1])
        if rolled.before > FAR * rolled.after:
            # The remainder would lie on the axis.
            axes.set_yscale("log")
            axes.set_ylim(0.1 * rolled.shown * max(rolled.floor, 1e-9), None)
            axes.yaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
        else:
            axes.set_ylim(0, None)
        axes.legend(loc="upper left", fontsize=8)
        return embedded(figure)


def short(name: str, most: int = 22) -> str:
    """A name that leaves room for the figure."""
    return name if len(name) <= most else name[: most - 1] + "…"
