"""How often what a report says with a stated probability is so: a reliability diagram of scored logs of `cad.py`.

    python benchmarks/gap/reliability_cad.py RESULTS.json [RESULTS.json ...] --out FOLDER

Reads results.json of `evaluate_cad.py`. Two statements are counted by tenths of what is stated: that a listed odd
effect is there, and that a verdict is right. `explained` is right where a log holds nothing that no library has and the
odd effect, where it can be seen at all, is listed; `partly` and `unknown` where it holds something else. Writes
reliability.png and RELIABILITY.md.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from evaluate import wilson
from evaluate_cad import SEEN

Said = list[tuple[float, bool]]
"""What was stated of something, and whether it was so."""


def effects(rows: list[dict]) -> Said:
    """Of each listed odd effect."""
    return [(p, bool(there)) for r in rows for p, there in r["probability"] if p is not None]


def verdicts(rows: list[dict]) -> Said:
    """Of each report's verdict."""
    out = []
    for r in rows:
        outside = r["outside"] and r["sigmas"] >= SEEN
        missed = bool(r["odd"]) and not r["outside"] and r["sigmas"] >= SEEN and not r["found"]
        right = not outside and not missed if r["verdict"] == "explained" else outside or missed
        out.append((r["confidence"], bool(right)))
    return out


def tenths(said: Said) -> list[tuple[float, float, int, int]]:
    """(lower end, mean of what was stated, how many were so, how many there are) of each tenth that has any."""
    out = []
    for low in np.arange(0.0, 1.0, 0.1):
        part = [(p, so) for p, so in said if low <= p < low + 0.1 or (p == 1.0 and low > 0.85)]
        if part:
            stated = float(np.mean([p for p, _ in part]))
            out.append((float(low), stated, sum(so for _, so in part), len(part)))
    return out


def table(kinds: dict[str, Said]) -> str:
    """Markdown."""
    lines = ["| | stated | mean stated | observed |", "|---|---|---|---|"]
    for name, said in kinds.items():
        for low, stated, so, count in tenths(said):
            lines.append(
                f"| {name} | {low:.1f}–{low + 0.1:.1f} | {stated:.2f} | {wilson(so, count)} |"
            )
    return "\n".join(lines) + "\n"


def figure(kinds: dict[str, Said], path: Path) -> None:
    """Observed over stated, with 95 % Wilson intervals."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(1, len(kinds), figsize=(8.0, 4.0), sharey=True, layout="constrained")
    for ax, (name, said) in zip(axes, kinds.items(), strict=True):
        ax.plot([0, 1], [0, 1], color="0.7", linewidth=1.0)
        for k, (_, stated, so, count) in enumerate(tenths(said)):
            low, high = interval(so, count)
            ax.plot([stated, stated], [low, high], color="#1f5a94", linewidth=2.0)
            ax.plot(stated, so / count, "o", color="#1f5a94")
            # Neighbours' labels stand at different ends.
            end, away = (low, -11) if k % 2 == 0 else (high, 4)
            ax.annotate(
                f"{so}/{count}", (stated, end), (0, away), textcoords="offset points", ha="center"
            )
        ax.set(xlabel="stated", title=name, xlim=(0, 1.03), ylim=(-0.08, 1.1))
    axes[0].set_ylabel("observed")
    fig.savefig(path, dpi=110)


def interval(so: int, count: int) -> tuple[float, float]:
    """95 %, Wilson."""
    z, p = 1.96, so / count
    middle = (p + z * z / (2 * count)) / (1 + z * z / count)
    half = z * np.sqrt(p * (1 - p) / count + z * z / (4 * count**2)) / (1 + z * z / count)
    return float(middle - half), float(middle + half)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("results", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    rows = [
        r for path in args.results for r in json.loads(path.read_text()) if not r.get("missing")
    ]
    kinds = {"a listed odd effect is there": effects(rows), "the verdict is right": verdicts(rows)}
    args.out.mkdir(parents=True, exist_ok=True)
    figure(kinds, args.out / "reliability.png")
    text = f"{len(rows)} reports.\n\n" + table(kinds)
    (args.out / "RELIABILITY.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
