"""The report's figures, as SVG. Colours are Okabe and Ito's, which colour-blind readers tell apart."""

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from jax_inertia.diagnosis.report.drawing import BLUE, GREY, ORANGE, STYLE, WIDTH, embedded, short
from jax_inertia.gap.finding import Diagnosis


def heat(found: Diagnosis) -> str:
    """Excess energy by joint and time."""
    trace = found.trace
    bins = min(120, len(trace.time))
    edges = np.linspace(trace.time[0], trace.time[-1], bins + 1)
    place = np.clip(np.digitize(trace.time, edges) - 1, 0, bins - 1)
    count = np.maximum(np.bincount(place, minlength=bins), 1)
    energy = np.stack([np.bincount(place, e, bins) / count for e in trace.energy.T])
    with mpl.rc_context(STYLE):
        rows = len(energy)
        figure = Figure((WIDTH, 1.25 + 0.21 * rows), layout="constrained")
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
            axes.axvspan(start, stop, fill=False, ec=BLUE, lw=1.2)
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
        with mpl.rc_context(STYLE):
            figure = Figure((WIDTH, 2.7), layout="constrained")
            axes = figure.subplots()
            x = getattr(trace, signal)[:, row]
            axes.plot(
                x, trace.missing[:, row], ".", ms=5.0, color="#c3c8cf", label="missing torque",
                rasterized=True,
            )  # fmt: skip
            if trace.effects:
                axes.plot(
                    x, fitted, ".", ms=1.6, color=ORANGE, label="found effects", rasterized=True
                )
            sigma = 2 * trace.noise[row]
            axes.axhspan(-sigma, sigma, color=BLUE, alpha=0.15, lw=0, label="± 2 σ of noise")
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
    with mpl.rc_context(STYLE):
        figure = Figure((WIDTH, 1.1 + 0.5 * len(values)), layout="constrained")
        axes = figure.subplots()
        at = np.arange(len(values))
        axes.barh(at, values, color=[GREY, *[ORANGE] * (len(values) - 1)], zorder=2, height=0.6)
        for k, value in enumerate(values):
            axes.text(value, k, f" {value:.3g}", va="center", fontsize=8.5)
        floor = found.heldout.noise
        axes.axvline(floor, color=BLUE, ls="--", lw=1.3)
        axes.text(floor, -0.55, f" floor {floor:.2g}", color=BLUE, fontsize=8.5, va="bottom")
        axes.set_yticks(at, names)
        axes.set_ylim(len(values) - 0.5, -0.95)
        axes.set_xlim(0, 1.18 * max(*values, floor))
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.grid(axis="y", visible=False)
        band = found.heldout.band
        below = "" if band is None else f" below {band:.2g} Hz"
        axes.set_xlabel(f"missing torque{below}, rms [{found.unit}]")
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
