"""Stated confidence against what was right."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from benchmarks.exam.rates import Share

INK, SOFT = "#1f4e79", "#9db8d2"


def confidence(tenths: list[tuple[float, float, int]], file: Path) -> None:
    """Each tenth with Wilson's bounds and the number of its logs, which is the area too."""
    fig, ax = plt.subplots(figsize=(4.2, 4.0))
    ax.plot([0, 1], [0, 1], color=SOFT, lw=1)
    for stated, right, n in tenths:
        low, high = Share(round(right * n), n).bounds
        ax.plot([stated, stated], [low, high], color=INK, lw=1)
        ax.scatter([stated], [right], s=12 + 3 * n, color=INK)
        ax.annotate(str(n), (stated, right), textcoords="offset points", xytext=(7, -9), fontsize=8)
    ax.set(xlim=(-0.02, 1.05), ylim=(-0.02, 1.05), xlabel="stated confidence", ylabel="share right")
    fig.tight_layout()
    fig.savefig(file, dpi=110, metadata={"Software": None})
    plt.close(fig)
