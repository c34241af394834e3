"""The figures of RESULTS.md."""

from pathlib import Path

import matplotlib

from benchmarks.real_logs import ur10e

matplotlib.use("Agg")
import matplotlib.pyplot as plt

_STYLE = {"figure.dpi": 90, "font.size": 9, "axes.spines.top": False, "axes.spines.right": False}


def weighings(
    path: Path, batch: list[ur10e.Weighing], filtered: list[ur10e.Online], variant: str
) -> None:
    """Load of the pair by every calibration, batch and online, against the truth."""
    names = list(dict.fromkeys(w.calibration for w in batch))
    with plt.rc_context(_STYLE):
        figure, axes = plt.subplots(1, 2, figsize=(8.5, 3.0), sharey=True, layout="constrained")
        for ax, log, truth in zip(
            axes, (ur10e.PAIR_FREE, ur10e.PAIR_PAYLOAD), (0.0, ur10e.TRUE_KG), strict=True
        ):
            ax.axvline(truth, color="0.6", lw=1)
            for row, name in enumerate(names):
                (one,) = [w for w in batch if (w.calibration, w.log) == (name, log)]
                ax.errorbar(one.value[0], row - 0.12, xerr=one.value[1], fmt="o", color="C0", ms=4)
                (run,) = [
                    o for o in filtered if (o.calibration, o.log, o.variant) == (name, log, variant)
                ]
                ax.errorbar(run.value, row + 0.12, xerr=run.total, fmt="s", color="C1", ms=4)
            ax.set_xlabel("load [kg]")
            ax.set_title(f"{log}: truth {truth:g} kg", fontsize=9)
        axes[0].set_yticks(range(len(names)), [n.replace("; ", "\n") for n in names])
        axes[0].invert_yaxis()
        axes[1].plot([], [], "o", color="C0", label="batch")
        axes[1].plot([], [], "s", color="C1", label=f"online, {variant}")
        axes[1].legend(frameon=False, fontsize=8, loc="lower left")
        figure.savefig(path)
        plt.close(figure)


def online(path: Path, runs: list[ur10e.Online]) -> None:
    """The load over time by both variants of the filter, for one calibration."""
    with plt.rc_context(_STYLE):
        figure, ax = plt.subplots(figsize=(8.5, 3.0), layout="constrained")
        for truth in (0.0, ur10e.TRUE_KG):
            ax.axhline(truth, color="0.6", lw=1)
        variants = list(dict.fromkeys(r.variant for r in runs))
        for run in runs:
            colour = f"C{variants.index(run.variant)}"
            label = run.variant if run.log == ur10e.PAIR_PAYLOAD else None
            when = run.time - run.time[0]
            band = 1.96 * run.sigma
            ax.plot(when, run.trace, color=colour, lw=1.2, label=label)
            ax.fill_between(when, run.trace - band, run.trace + band, color=colour, alpha=0.2, lw=0)
        ax.set_ylim(-1.0, 5.0)
        ax.set_xlabel("time [s]")
        ax.set_ylabel("load [kg]")
        ax.set_title(f"{runs[0].calibration}: own 95 % band of the filter", fontsize=9)
        ax.legend(frameon=False, fontsize=8)
        figure.savefig(path)
        plt.close(figure)
