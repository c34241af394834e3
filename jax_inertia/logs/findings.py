"""What a check of a log finds: how grave, which check, and one line that says what, where, what
would be right.
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np


class Severity(StrEnum):
    """ERROR: results would be wrong. WARNING: results may suffer. NOTE: good to know."""

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


class Finding(NamedTuple):
    """One finding; `check` is a short stable name such as `gap` or `torque_unit`."""

    severity: Severity
    check: str
    message: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.message}"


def spans(time: np.ndarray, where: np.ndarray) -> str:
    """Say in which intervals of time a (T,) mask holds: the first three of them, then a count."""
    runs = run_bounds(where)
    shown = ", ".join(f"{time[a]:.4g}-{time[b - 1]:.4g}" for a, b in runs[:3])
    return f"{shown} s" + (f" and {len(runs) - 3} more intervals" if len(runs) > 3 else "")


def run_bounds(where: np.ndarray) -> np.ndarray:
    """First index and one past the last of each run of True, (runs, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(np.int8)))
    return edges.reshape(-1, 2)
