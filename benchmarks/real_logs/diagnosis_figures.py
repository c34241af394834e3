"""One picture a case: what is left at each joint, and over time where most was missing."""

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from diagnosis_summary import Summary

from jax_inertia.gap.trace import Trace

matplotlib.use("Agg")
import matplotlib.pyplot as plt

_STYLE: Any = {
    "figure.dpi": 90,
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def figure(path: Path, title: str, trace: Trace, summary: Summary) -> None:
    """Residual by joint (model, with the effects, published fit), and over time at the joint that lacks most."""
    before = np.array([r.before for r in summary.rows])
    after = np.array([r.after for r in summary.rows])
    published = np.array([r.published for r in summary.rows])
    x = np.arange(len(before))
    left = trace.left[-1] if trace.left else trace.missing
    worst = int(np.nanargmax(before))
    with plt.rc_context(_STYLE):
        grid, (bars, line) = plt.subplots(
            1, 2, figsize=(9.5, 3.0), layout="constrained", width_ratios=(2, 3)
        )
        bars.plot(x, before, "o", color="0.35", label="model")
        bars.plot(x, after, "s", color="C0", label="with the effects (held out)")
        if np.isfinite(published).any():
            bars.plot(x, published, "^", color="C1", label="published fit")
        bars.plot(x, trace.noise, "_", color="0.6", ms=12, label="sensor noise")
        bars.set_yscale("log")
        bars.set_xticks(x, [r.joint for r in summary.rows], rotation=35, ha="right", fontsize=7)
        bars.set_ylabel("rms [N m]")
        bars.legend(frameon=False, fontsize=7)
        line.plot(trace.time, trace.missing[:, worst], color="0.35", lw=0.8, label="model")
        line.plot(trace.time, left[:, worst], color="C0", lw=0.8, label="with the effects")
        line.axhline(0.0, color="0.8", lw=0.6, zorder=0)
        line.set_xlabel("time [s]")
        line.set_ylabel(f"missing at\n{summary.rows[worst].joint} [N m]")
        line.legend(frameon=False, fontsize=7)
        grid.suptitle(title, fontsize=9)
        grid.savefig(path)
        plt.close(grid)
