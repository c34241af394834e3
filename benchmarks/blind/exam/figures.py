"""Pictures beside the tables: confusion, calibration, accuracy against size, shrink, and one for each wrong log."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from exam.rates import Share, count

INK, SOFT, RED = "#1f4e79", "#9db8d2", "#b03a2e"


def _save(fig, file: Path) -> str:
    fig.tight_layout()
    fig.savefig(file, dpi=110, metadata={"Software": None})
    plt.close(fig)
    return f"{file.parent.name}/{file.name}"


def confusion(rows: list[dict], file: Path) -> str:
    """Clear single and unknown effects: what was hidden against what was reported first."""
    alone = [r for r in rows if r["stratum"] in ("single", "unknown") and r["clear"][0]]
    pairs = [
        (
            "no library has it" if r["stratum"] == "unknown" else r["true"][0][0],
            r["verdict"] if r["verdict"] in ("unknown", "no_gap", "failed") else r["found"][0][0],
        )
        for r in alone
    ]
    down = sorted({t for t, _ in pairs})
    across = sorted({f for _, f in pairs}, key=lambda f: (f in ("unknown", "no_gap", "failed"), f))
    grid = np.zeros((len(down), len(across)))
    for t, f in pairs:
        grid[down.index(t), across.index(f)] += 1
    share = grid / np.maximum(grid.sum(1, keepdims=True), 1)
    fig, ax = plt.subplots(figsize=(0.36 * len(across) + 3, 0.3 * len(down) + 2.4))
    ax.imshow(share, cmap="Blues", vmin=0, vmax=1.2, aspect="auto")
    for (i, j), n in np.ndenumerate(grid):
        if n:
            ax.text(j, i, f"{int(n)}", ha="center", va="center", fontsize=7)
    ax.set_xticks(range(len(across)), across, rotation=90, fontsize=7)
    ax.set_yticks(range(len(down)), down, fontsize=7)
    ax.set_xlabel("reported first")
    ax.set_ylabel("hidden")
    return _save(fig, file)


def calibration(rows: list[dict], file: Path) -> str:
    """How often the first effect was right, against the probability it was given."""
    told = [
        (r["probability"], bool(r["in_set"]))
        for r in rows
        if r.get("probability") is not None and r["in_set"] is not None
    ]
    fig, ax = plt.subplots(figsize=(4, 3.4))
    ax.plot([0, 1], [0, 1], color=SOFT, lw=1)
    edges = np.array([0, 0.3, 0.5, 0.7, 0.85, 0.95, 1.0 + 1e-9])
    for low, high in pairwise(edges.tolist()):
        inside = [(p, ok) for p, ok in told if low <= p < high]
        if inside:
            share = count(ok for _, ok in inside)
            mean = float(np.mean([p for p, _ in inside]))
            a, b = share.bounds
            ax.plot([mean, mean], [a, b], color=INK, lw=1)
            ax.plot(mean, share.rate, "o", color=INK, ms=4)
            ax.annotate(f"{share.n}", (mean, b), fontsize=7, ha="center", va="bottom")
    ax.set_xlabel("probability given to the first effect")
    ax.set_ylabel("share right or in the set")
    ax.set_xlim(0, 1.02)
    ax.set_ylim(0, 1.08)
    return _save(fig, file)


def against_size(rows: list[dict], file: Path) -> str:
    """Share of single effects named, and left unseen, against their visibility."""
    alone = [r for r in rows if r["stratum"] == "single" and not r["failed"]]
    fig, ax = plt.subplots(figsize=(5.2, 3.4))
    edges = 10.0 ** np.arange(0, 7.1, 0.75)
    curves: dict[str, list[tuple[float, Share]]] = {"named": [], "unseen": []}
    for low, high in pairwise(edges.tolist()):
        inside = [r for r in alone if low <= max(r["distinct"][0], 1.0) < high]
        if inside:
            at = float(np.sqrt(low * high))
            named = count(bool(r["found"]) and r["found"][0] == r["true"][0] for r in inside)
            curves["named"].append((at, named))
            curves["unseen"].append((at, count(r["verdict"] == "no_gap" for r in inside)))
    for (name, points), colour in zip(curves.items(), (INK, RED), strict=True):
        ax.plot(
            [x for x, _ in points],
            [s.rate for _, s in points],
            "o-",
            color=colour,
            ms=4,
            label=name,
        )
        for x, s in points:
            ax.plot([x, x], s.bounds, color=colour, lw=0.8, alpha=0.5)
    ax.axvline(150.0, color=SOFT, lw=1)
    ax.set_xscale("log")
    ax.set_xlabel("χ² left after the nominal model's own errors (line: 150, clear)")
    ax.set_ylabel("share of single effects")
    ax.legend(frameon=False)
    return _save(fig, file)


def shrink(rows: list[dict], file: Path) -> str:
    """Shrink predicted on the log against shrink achieved on the other motion."""
    points = [
        (r["predicted"], r["achieved"]) for r in rows if r.get("shrink_within_10") is not None
    ]
    fig, ax = plt.subplots(figsize=(3.6, 3.4))
    ax.fill_between([0, 1], [-0.1, 0.9], [0.1, 1.1], color=SOFT, alpha=0.4, lw=0)
    if points:
        x, y = np.clip(np.array(points), -0.2, 1.05).T
        ax.plot(x, y, ".", color=INK, ms=4)
    ax.set_xlim(-0.25, 1.1)
    ax.set_ylim(-0.25, 1.1)
    ax.set_xlabel("predicted on the log")
    ax.set_ylabel("achieved on the other motion")
    return _save(fig, file)


def one_log(row: dict, folder: Path, file: Path) -> str:
    """The nominal model's residual over time, the three largest joints, with the torque's size."""
    from rivals import read, residual

    m = read(folder / "log.npz", folder / "nominal.xml")
    r = residual(m)[:, m.dofs]
    edge = round(0.25 * m.rate)
    time = np.arange(len(r)) / m.rate
    power = np.sqrt((r[edge:-edge] ** 2).mean(0))
    scale = np.sqrt((m.applied[:, m.dofs] ** 2).mean(0)) + 1e-9
    top = np.argsort(-power / scale)[:3]
    fig, axes = plt.subplots(len(top), 1, figsize=(4.2, 2.6), sharex=True, squeeze=False)
    places = {p for _, p in row["true"]}
    for ax, j in zip(axes[:, 0], top, strict=True):
        hidden = m.joints[j] in places
        ax.plot(time[edge:-edge], r[edge:-edge, j], color=RED if hidden else INK, lw=0.7)
        ax.set_ylabel("N m", fontsize=6)
        ax.set_title(f"{m.joints[j]}: {power[j]:.2g} of {scale[j]:.2g} N m", fontsize=6, pad=1)
        ax.tick_params(labelsize=6)
    axes[-1, 0].set_xlabel("s", fontsize=6)
    return _save(fig, file)


def confidence(tenths: list[tuple[float, float, int]], file: Path) -> str:
    """Stated confidence against the share that was right, with Wilson's bounds; area by the number of logs."""
    fig, ax = plt.subplots(figsize=(4.2, 4.0))
    ax.plot([0, 1], [0, 1], color=SOFT, lw=1)
    for stated, right, n in tenths:
        low, high = Share(round(right * n), n).bounds
        ax.plot([stated, stated], [low, high], color=INK, lw=1)
        ax.scatter([stated], [right], s=12 + 3 * n, color=INK)
        ax.annotate(str(n), (stated, right), textcoords="offset points", xytext=(7, -9), fontsize=8)
    ax.set(xlim=(-0.02, 1.05), ylim=(-0.02, 1.05), xlabel="stated confidence", ylabel="share right")
    return _save(fig, file)
