"""Shares with Wilson's bounds (Wilson 1927), overall and by any column of the rows."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass

Z = 1.959964


@dataclass(frozen=True)
class Share:
    """k of n."""

    k: int
    n: int

    @property
    def rate(self) -> float | None:
        return self.k / self.n if self.n else None

    @property
    def bounds(self) -> tuple[float, float]:
        """Wilson's 95 % interval; (0, 1) of nothing."""
        if not self.n:
            return 0.0, 1.0
        p, n = self.k / self.n, self.n
        centre = (p + Z * Z / (2 * n)) / (1 + Z * Z / n)
        half = Z * math.sqrt(p * (1 - p) / n + Z * Z / (4 * n * n)) / (1 + Z * Z / n)
        return max(centre - half, 0.0), min(centre + half, 1.0)

    def __str__(self) -> str:
        if not self.n:
            return "–"
        low, high = self.bounds
        return f"{self.k / self.n:.3f} [{low:.2f}, {high:.2f}] ({self.k}/{self.n})"


def count(values: Iterable[bool | None]) -> Share:
    """True among what is not None."""
    asked = [bool(v) for v in values if v is not None]
    return Share(sum(asked), len(asked))


def _each(rows: list[dict], name: str) -> list[bool | None]:
    """A column whose cells may be lists."""
    out: list[bool | None] = []
    for row in rows:
        cell = row.get(name)
        out += cell if isinstance(cell, list) else [cell]
    return out


def _parameters(rows: list[dict]) -> list[dict]:
    return [p for row in rows for p in row.get("parameters", [])]


def _column(name: str) -> Callable[[list[dict]], Share]:
    return lambda rows: count(_each(rows, name))


QUESTIONS: dict[str, Callable[[list[dict]], Share]] = {
    "family": _column("family"),
    "place": _column("place"),
    "in_set": _column("in_set"),
    "exact": _column("exact"),
    "missed": _column("missed"),
    "unknown": _column("unknown"),
    "unknown_place": _column("unknown_place"),
    "false_unknown": _column("false_unknown"),
    "false_alarm": _column("false_alarm"),
    "misled_when_faint": _column("misled"),
    "pair_recall": _column("pair_recall"),
    "pair_precision": _column("pair_precision"),
    "pair_both": _column("pair_both"),
    "pair_in_set": _column("pair_in_set"),
    "parameters_within_10": lambda rows: count(p["error"] <= 0.1 for p in _parameters(rows)),
    "coverage95": lambda rows: count(p["covers"] for p in _parameters(rows)),
    "shrink_within_10": _column("shrink_within_10"),
    "rollout_at_floor": _column("rollout_at_floor"),
}
GOALS = {
    "family": "≥ 0.94",
    "place": "≥ 0.98",
    "in_set": "≥ 0.99",
    "unknown": "≥ 0.97",
    "false_unknown": "≤ 0.03",
    "false_alarm": "≤ 0.01",
    "pair_recall": "≥ 0.92",
    "pair_precision": "≥ 0.95",
    "pair_both": "≥ 0.80",
    "coverage95": "0.90–0.98",
    "shrink_within_10": "≥ 0.94",
    "rollout_at_floor": "≥ 0.90",
}


def summary(rows: list[dict]) -> dict[str, float | int | None]:
    """What blind.json holds: each rate with its bounds."""
    out: dict[str, float | int | None] = {"logs": len(rows)}
    for name, ask in QUESTIONS.items():
        share = ask(rows)
        out[name] = share.rate
        out[f"{name}_low"], out[f"{name}_high"] = share.bounds
        out[f"{name}_n"] = share.n
    return out


def by(rows: list[dict], column: str) -> dict[str, list[dict]]:
    """Rows by the value of a column."""
    out = defaultdict(list)
    for row in rows:
        out[str(row[column])].append(row)
    return dict(sorted(out.items()))
