"""Where figures go and how they look."""

from pathlib import Path

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

FOLDER = Path(__file__).parents[1] / "figures"


def figure(rows: int, *, height: float) -> tuple[Figure, list[Axes]]:
    """Panels one under the other that share their time axis."""
    fig, axes = plt.subplots(rows, 1, sharex=True, figsize=(8.0, height), squeeze=False)
    for axis in axes[:, 0]:
        axis.grid(alpha=0.3)
        axis.spines[["top", "right"]].set_visible(False)
    return fig, list(axes[:, 0])


def legend(axis: Axes) -> None:
    """One line above the panel, where it hides nothing."""
    axis.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=5,
        frameon=False,
        borderpad=0.1,
        handlelength=1.2,
        columnspacing=1.2,
    )


def save(fig: Figure, name: str) -> Path:
    """Write the figure as PNG and close it."""
    FOLDER.mkdir(exist_ok=True)
    path = FOLDER / f"{name}.png"
    fig.tight_layout()
    fig.savefig(path, dpi=110)
    plt.close(fig)
    return path
