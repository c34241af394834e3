"""The figure of replays: targets, robot and models, joint by joint."""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from jax_inertia.replay.result import Replayed

BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#bbbbbb"
_SHOWN = 10.0
"""Of a motion, seconds about the worst moment."""


def replays(names, r: Replayed, *, both: bool = True) -> Figure:
    """Joint positions as commanded, as they were and as replayed, about the moment that the nominal model misses most.

    The band holds nine tenths of the replays of numbers drawn as the fit knows them.
    """
    record = r.records[r.shown]
    nominal, corrected = r.nominal[r.shown], r.corrected[r.shown]
    error = np.abs(nominal - record.q)
    worst = float(record.time[int(np.argmax(error.max(axis=1)))])
    first = min(max(worst - 0.5 * _SHOWN, 0.0), max(record.time[-1] - _SHOWN, 0.0))
    rows = (record.time >= first) & (record.time <= first + _SHOWN)
    t, n = record.time[rows], len(names)
    columns = 1 if n < 4 else 2
    high = -(-n // columns)
    nominally = "nominal model" if both else "model"
    with rc_context({"text.parse_math": False, "font.size": 8.5}):
        out = Figure((5.4 * columns, 0.9 + 1.5 * high), layout="constrained")
        grid = out.subplots(high, columns, sharex=True, squeeze=False)
        for j, axes in enumerate(grid.ravel()[:n]):
            axes.step(t, record.target[rows, j], where="post", color=GREY, lw=0.9, label="target")
            if both and r.fan is not None:
                low, high_ = (x[rows, j] for x in r.fan[:2])
                axes.fill_between(
                    t, low, high_, color=BLUE, alpha=0.22, lw=0, label="its 90 % band"
                )
            axes.plot(t, record.q[rows, j], color="black", lw=1.4, label="robot")
            axes.plot(t, nominal[rows, j], color=ORANGE, lw=1.1, label=nominally)
            if both:
                line = {"color": BLUE, "lw": 1.1, "ls": "--", "label": "corrected model"}
                axes.plot(t, corrected[rows, j], **line)
            text = f"{1e3 * r.before[j]:.3g} mrad" + (f" → {1e3 * r.after[j]:.3g}" if both else "")
            axes.set_title(f"{names[j]}: {text} rms", fontsize=8.5, loc="left")
            axes.grid(color="#e3e6ea", lw=0.6)
        for axes in grid.ravel()[n:]:
            axes.set_axis_off()
        for axes in grid[-1]:
            axes.set_xlabel("time [s]")
        grid[0, 0].set_ylabel("rad")
        handles, labels = grid[0, 0].get_legend_handles_labels()
        out.legend(
            handles, labels, loc="outside upper right", ncols=5 if columns > 1 else 3, frameon=False
        )
    return out
