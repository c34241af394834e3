"""Walking over boxes whose heights the robot does not know, and does not see: how far that goes, honestly."""

import numpy as np

from benchmarks.paper import pelvis
from benchmarks.paper.brain import ADAPTIVE
from benchmarks.paper.loop import summary

DURATION = 20.0
AMPLITUDES = (0.01, 0.02)  # m


def results(seeds: np.ndarray, duration: float = DURATION) -> dict:
    """How many robots are still up after `duration` [s], by the boxes' amplitude."""
    rows = []
    for amplitude in AMPLITUDES:
        found = pelvis.walk(
            seeds,
            (ADAPTIVE,),
            amplitude=amplitude,
            knows_ground=False,
            duration=duration,
            label=f"blind, {1000 * amplitude:g} mm",
        )
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
