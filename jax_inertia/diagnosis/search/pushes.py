"""Where in a log something pushed: windows of a few lengths at every time, judged by evidence on every body."""

from collections.abc import Sequence

import numpy as np

from jax_inertia.diagnosis.effects.base import Columns
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior

LENGTHS = (0.3, 0.7, 1.5)
"""Of pushes that are tried [s]: a knock, a hand's push, a lean."""
FLANK = 0.3


def windows(
    residual: Residual,
    evidence: Evidence,
    now: Posterior,
    scale: float,
    odds: float,
    bodies: Sequence[int],
    most: int = 3,
) -> tuple[list[tuple[float, float]], float]:
    """Stretches [s] in which a constant force on one of some `bodies` pays its prior odds, and those odds [nats].

    The best first, none overlap. The odds: `odds` against a push, and the number of stretches where it may have been.

    `scale`: prior standard deviation of each component of the force [N]. On the slow grid, unfiltered: what is found
    is computed exactly afterwards.
    """
    context, time = residual.context, residual.time
    count = len(bodies)
    forces = np.stack(
        [residual.rows_of(Columns(context.force_rows[:, b]))[0] for b in bodies], axis=1
    )
    root = np.sqrt(evidence.precision)
    left = root * (evidence.y - now.fitted)
    base = evidence.design(now.chosen).reshape(*evidence.y.shape, len(now.mean))
    scored = []
    for length in LENGTHS:
        half = 0.5 * length
        for middle in np.arange(time[0] + half, time[-1] - half, half):
            part = np.abs(time - middle) <= half
            if part.sum() < 3:
                continue
            own = forces[part] * root[part][:, None, :, None] * scale
            here = base[part].reshape(part.sum() * base.shape[1], base.shape[2])
            for b in range(count):
                a = own[:, b].reshape(-1, 3)
                cross = here.T @ a
                s = np.eye(3) + a.T @ a - cross.T @ now.covariance @ cross
                rest = a.T @ left[part].ravel()
                gain = 0.5 * rest @ np.linalg.solve(s, rest) - 0.5 * np.linalg.slogdet(s)[1]
                scored.append((gain, middle - half, middle + half))
    price = odds + np.log(max(len(scored) / max(count, 1), 1.0))
    out: list[tuple[float, float]] = []
    for gain, start, end in sorted(scored, reverse=True):
        if gain < price or len(out) == most:
            break
        if all(end <= a or start >= b for a, b in out):
            out.append((float(start), float(end)))
    return out, float(price)
