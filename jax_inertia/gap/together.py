"""Effects that are chosen, together: their columns, what they leave, and how large that is."""

import numpy as np

from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.pool import Pool


def stacked(pool: Pool, chosen: list[Candidate]) -> tuple[np.ndarray, np.ndarray]:
    """Columns of all θ together, and what they should come to: y less the offsets."""
    y = pool.evidence.y
    if not chosen:
        return np.zeros((len(y), 0)), y
    columns = np.concatenate([c.columns for c in chosen], axis=1)
    return columns, y - np.sum([c.offset for c in chosen], axis=0)


def remaining(pool: Pool, chosen: list[Candidate]) -> np.ndarray:
    """What the chosen effects leave, in the charged metric."""
    columns, target = stacked(pool, chosen)
    if not columns.shape[1]:
        return target
    return target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]


def misfit(pool: Pool, chosen: list[Candidate]) -> float:
    """J with all θ free and the shapes as they are."""
    columns, target = stacked(pool, chosen)
    if not columns.shape[1]:
        return float(target @ target)
    theta = np.linalg.lstsq(columns, target, rcond=None)[0]
    return float(np.sum((target - columns @ theta) ** 2))


def solved(columns: np.ndarray, target: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Numbers that fit, as near to `start` as they come: along what a log does not tell they stay where they are."""
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0] = 1.0
    return start + np.linalg.lstsq(columns / scale, target - columns @ start, rcond=1e-8)[0] / scale
