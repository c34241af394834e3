"""The report's figures, as SVG. Colours are Okabe and Ito's, which colour-blind readers tell apart."""

import base64
import io
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from jax_inertia.gap.finding import Diagnosis
from jax_inertia.gap.rollout import Rollouts

_BLUE, _ORANGE, _GREEN, _GREY = "#0072B2", "#D55E00", "#009E73", "#8a8f98"
_STYLE: dict[Any, Any] = {
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
_WIDTH = 4.8  # inches: letters stay legible on a phone


def embedded(figure: Figure) -> str:
    """A figure as the data URI of an SVG."""
    out = io.BytesIO()
    with mpl.rc_context(_STYLE):
        figure.savefig(out, format="svg", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(out.getvalue()).decode()


def heat(found: Diagnosis) -> str:
    """Excess energy by joint and time."""
    trace = found.trace
    bins = min(120, len(trace.time))
    edges = np.linspace(trace.time[0], trace.time[-1], bins + 1)
    place = np.clip(np.digitize(trace.time, edges) - 1, 0, bins - 1)
    count = np.maximum(np.bincount(place, minlength=bins), 1)
    energy = np.stack([np.bincount(place, e, bins) / count for e in trace.energy.T])
    with mpl.rc_context(_STYLE):
        rows = len(energy)
        figure = Figure((_WIDTH, 1.25 + 0.21 * rows), layout="constrained")
        axes = figure.subplots()
        top = max(float(energy.max()), 10.0)
        image = axes.imshow(
            np.maximum(energy, 1.0),
            aspect="auto",
            extent=(float(edges[0]), float(edges[-1]), rows - 0.5, -0.5),
            cmap="YlOrRd",
            norm=LogNorm(1.0, top),
            interpolation="nearest",
        )
        axes.set_yticks(range(rows), [short(name) for name in trace.rows])
        axes.grid(False)
        for start, stop in found.when if _local(found) else ():
            axes.axvspan(start, stop, fill=False, ec=_BLUE, lw=1.2)
        axes.set_xlabel("time [s]")
        bar = figure.colorbar(image, ax=axes, pad=0.01, aspect=15)
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        bar.ax.yaxis.set_minor_formatter(NullFormatter())
        bar.set_label("energy / noise", fontsize=8)
        return embedded(figure)


def _local(found: Diagnosis) -> bool:
    """Whether the loud stretches are few and short enough to be worth a frame."""
    length = sum(stop - start for start, stop in found.when)
    span = found.trace.time[-1] - found.trace.time[0]
    return bool(0 < len(found.when) <= 6 and length < 0.5 * span)


def residual(found: Diagnosis, row: int) -> dict[str, str]:
    """Missing torque of one row against its position, velocity and torque, with what the effects say of it."""
    trace = found.trace
    fitted = sum((e[:, row] for e in trace.effects), np.zeros(len(trace.time)))
    angle = "m" if trace.units[row] == "N" else "rad"
    labels = {
        "q": f"position [{angle}]",
        "v": f"velocity [{angle}/s]",
        "tau": f"torque [{trace.units[row]}]",
    }
    out = {}
    for signal, label in labels.items():
        with mpl.rc_context(_STYLE):
            figure = Figure((_WIDTH, 2.7), layout="constrained")
            axes = figure.subplots()
            x = getattr(trace, signal)[:, row]
            axes.plot(
                x, trace.missing[:, row], ".", ms=5.0, color="#c3c8cf", label="missing torque",
                rasterized=True,
            )  # fmt: skip
            if trace.effects:
                axes.plot(
                    x, fitted, ".", ms=1.6, color=_ORANGE, label="found effects", rasterized=True
                )
            sigma = 2 * trace.noise[row]
            axes.axhspan(-sigma, sigma, color=_BLUE, alpha=0.15, lw=0, label="± 2 σ of noise")
            axes.set(xlabel=label, ylabel=f"[{trace.units[row]}]")
            axes.legend(loc="best", fontsize=7.5, markerscale=2)
            out[signal] = embedded(figure)
    return out


def waterfall(found: Diagnosis) -> str:
    """Held-out missing torque after each effect, down to the floor, over the rows that hold the gap."""
    trace = found.trace
    values = [trace.counted.rms(x[:, trace.gap]) for x in (trace.missing, *trace.left)]
    names = ["as modelled"] + [
        f"+ {f.family.replace('_', ' ')}\n{short(f.place.name)}" for f in found.findings
    ]
    with mpl.rc_context(_STYLE):
        figure = Figure((_WIDTH, 1.1 + 0.5 * len(values)), layout="constrained")
        axes = figure.subplots()
        at = np.arange(len(values))
        axes.barh(at, values, color=[_GREY, *[_ORANGE] * (len(values) - 1)], zorder=2, height=0.6)
        for k, value in enumerate(values):
            axes.text(value, k, f" {value:.3g}", va="center", fontsize=8.5)
        floor = found.heldout.noise
        axes.axvline(floor, color=_BLUE, ls="--", lw=1.3)
        axes.text(floor, -0.55, f" floor {floor:.2g}", color=_BLUE, fontsize=8.5, va="bottom")
        axes.set_yticks(at, names)
        axes.set_ylim(len(values) - 0.5, -0.95)
        axes.set_xlim(0, 1.18 * max(*values, floor))
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.grid(axis="y", visible=False)
        band = found.heldout.band
        below = "" if band is None else f" below {band:.2g} Hz"
        axes.set_xlabel(f"missing torque{below}, rms [{found.unit}]")
        return embedded(figure)


def fan(rolled: Rollouts) -> str:
    """How far simulation and log part over a window: before, after, floor."""
    with mpl.rc_context(_STYLE):
        figure = Figure((_WIDTH, 3.0), layout="constrained")
        axes = figure.subplots()
        milliseconds = 1e3 * rolled.time
        for error, colour, label in (
            (rolled.nominal, _GREY, "before: as modelled"),
            (rolled.corrected, _ORANGE, "after: corrected"),
            (rolled.noise, _BLUE, "floor: noise, model's errors"),
        ):
            size = rolled.shown * np.sqrt(np.mean(error**2, axis=2))
            low, high = np.quantile(size, [0.1, 0.9], axis=0)
            axes.fill_between(milliseconds, low, high, color=colour, alpha=0.2, lw=0)
            whole = np.sqrt(np.mean(size**2, axis=0))
            axes.plot(milliseconds, whole, color=colour, lw=1.6, label=label)
        axes.set(xlabel="time from the window's start [ms]", ylabel=f"error [{rolled.shown_in}]")
        axes.set_xlim(0, milliseconds[-1])
        axes.set_ylim(0, None)
        axes.legend(loc="upper left", fontsize=8)
        return embedded(figure)


def affected(found: Diagnosis) -> int:
    """Row of the first finding's joint, else the row that holds most of the gap."""
    rows = found.trace.rows
    if found.findings and found.findings[0].place.name in rows:
        return rows.index(found.findings[0].place.name)
    return holding(found)[0]


def holding(found: Diagnosis) -> list[int]:
    """Rows that hold the gap, the loudest first."""
    shares = [found.share[name] for name in found.trace.rows]
    return sorted(found.trace.gap, key=lambda k: -shares[k])


def short(name: str, most: int = 22) -> str:
    """A name that leaves room for the figure."""
    return name if len(name) <= most else name[: most - 1] + "…"
