"""Composite adaptation in the humanoid's loop: the paper's experiments, seed by seed, beside EKF.

    python -m benchmarks.online.loops elbow | pelvis FIRST COUNT OUT

One value a seed and controller, so that parts of many processes are gathered without loss.
"""

import json
import sys

import jax
import numpy as np

from benchmarks.harness.results import commit
from benchmarks.paper import elbow, pelvis
from benchmarks.paper.brain import ADAPTIVE, COMPOSITE, MODES
from benchmarks.paper.loop import Run, rms

SECONDS = 20.0
"""Of a walk; the paper's has 60."""


def _rows(found: Run, error: np.ndarray) -> dict:
    """Error, falls and estimates that are no body, by controller."""
    out = {}
    for mode in sorted(set(found.mode)):
        own = found.mode == mode
        out[MODES[mode]] = {
            "rmse": error[own].tolist(),
            "fell": int(np.isfinite(found.fell[own]).sum()),
            "unphysical": int(found.unphysical[own].sum()),
        }
    return out


def elbow_of(seeds: np.ndarray) -> dict:
    """RMSE of the elbow's angle [rad], the forearm's mass by Table I's waveform."""
    found = elbow.run(seeds, (ADAPTIVE, COMPOSITE))
    return _rows(found, rms(found.series["error"][found.time >= elbow.SETTLE]))


def pelvis_of(seeds: np.ndarray) -> dict:
    """RMSE of the pelvis's height [m], walking over boxes that the robot knows."""
    found = pelvis.walk(seeds, (ADAPTIVE, COMPOSITE), duration=SECONDS, label="pelvis")
    return _rows(found, pelvis.errors(found))


EXPERIMENTS = {"elbow": elbow_of, "pelvis": pelvis_of}


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    which, first, count, out_ = sys.argv[1:]
    seeds_ = int(first) + np.arange(int(count))
    result = {"commit": commit(), "seeds": seeds_.tolist(), **EXPERIMENTS[which](seeds_)}
    with open(out_, "w") as file:
        json.dump(result, file)
    print(which, result)
