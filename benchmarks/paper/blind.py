"""Walking over boxes whose heights the robot does not know, and does not see: how far that goes, honestly."""

import numpy as np

from benchmarks.paper import pelvis
from benchmarks.paper.brain import ADAPTIVE
from benchmarks.paper.loop import Run, summary
from benchmarks.paper.shared_out import Wanted, every

DURATION = 20.0
AMPLITUDES = (0.01, 0.02)  # m
LANDING_SPEED = 0.35  # m/s; ground that comes late is looked for while the robot falls sideways


def walk(
    seeds: np.ndarray, modes: tuple[int, ...], amplitude: float, duration: float = DURATION
) -> Run:
    """On boxes of ± `amplitude` [m] that the robot does not know."""
    return pelvis.walk(
        seeds,
        modes,
        amplitude=amplitude,
        knows_ground=False,
        duration=duration,
        landing_speed=LANDING_SPEED,
        label=f"blind, {1000 * amplitude:g} mm",
    )


def results(seeds: np.ndarray, duration: float = DURATION) -> dict:
    """How many robots are still up after `duration` [s], by the boxes' amplitude."""
    rows = []
    wanted = [
        Wanted(walk, seeds, (ADAPTIVE,), {"amplitude": a, "duration": duration}) for a in AMPLITUDES
    ]
    for amplitude, found in zip(AMPLITUDES, every(wanted), strict=True):
        rows.append(
            {
                "amplitude_m": amplitude,
                "up": int(np.isinf(found.fell).sum()),
                "of": len(seeds),
                "seconds_up": float(np.median(np.minimum(found.fell, duration))),
                "rmse": summary(pelvis.errors(found)),
                "unphysical": int(found.unphysical.sum()),
            }
        )
    return {
        "rows": rows,
        "duration_s": duration,
        "unphysical": sum(row["unphysical"] for row in rows),
    }
