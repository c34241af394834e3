"""Draws of a corrected robot from what a fit knows of it, each within physical bounds.

The numbers of a fit are correlated: a stiffer loop with more friction may replay a log as well as a softer one with
less. Robots whose numbers are drawn one by one from their intervals replay worse than the intervals suggest; draws of
all numbers together, from the fit's covariance, replay as the fit does.
"""

import copy
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import truncnorm

from jax_inertia.replay.fitting.file_form import InFile
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.simulation.model_edits import change_body, changed_bodies, lightened
from jax_inertia.replay.simulation.plant import Plant

COUNT = 64
"""Draws in a file: a decision. A parallel environment takes one of them, so that thousands share each."""
_SWEEPS = 30
"""Gibbs sweeps before a draw is taken: a decision. Means and deviations of correlated pairs (ρ = 0.9) are then those of
rejection sampling to the sampling error of 4000 draws (test)."""
JOINT = (
    "armature", "damping", "frictionloss", "kp", "kd", "effort_limit", "delay", "lag", "offset", "integral", "windup",
)  # fmt: skip
"""Numbers of a joint in a draw [kg m², N m s/rad, N m, N m/rad, N m s/rad, N m, s, s, rad, N m/(rad s), N m]."""
BODY = "mass", "inertia", "ipos", "iquat"
"""Numbers of a body in a draw, as MuJoCo's fields `body_...` have them."""


class Draws(NamedTuple):
    """Robots as likely as the log leaves them, D of them."""

    vectors: Float[np.ndarray, "D P"]
    """Numbers of the fit."""
    joints: Mapping[str, Float[np.ndarray, "D n"]]
    """By `JOINT`; an effort limit that is not known is infinite."""
    bodies: tuple[str, ...]
    """Bodies whose inertials are not the nominal model's."""
    inertials: Mapping[str, np.ndarray]
    """By `BODY`, of these bodies (D, b, ...)."""
    step: float
    """Of the model's time [s]."""


def drawn(plant: Plant, found: Fit, in_file: InFile, count: int = COUNT) -> Draws:
    """`count` draws from the normal distribution of a fit within the bounds of its numbers, as files hold them.

    Numbers that stayed at the nominal model's are not varied. The same fit gives the same draws.
    """
    vectors = _vectors(found, count)
    numbers = [in_file(plant.numbers(found.table, x, None)) for x in vectors]
    models, changed = [copy.copy(plant.model) for _ in numbers], []
    for model, x in zip(models, numbers, strict=True):
        for body in changed_bodies(x):
            change_body(model, body, x)
        changed += [*changed_bodies(x), *lightened(model, plant.dof, x)]
    names = tuple(dict.fromkeys(changed))
    ids = [plant.model.body(b).id for b in names]
    inertials = {n: [getattr(m, f"body_{n}")[ids].copy() for m in models] for n in BODY}
    joints = {
        "armature": [np.maximum(x.armature, 0.0) for x in numbers],
        "damping": [x.damping + x.back for x in numbers],
        "frictionloss": [x.dry for x in numbers],
        "kp": [x.kp for x in numbers],
        "kd": [x.kd - x.back for x in numbers],
        "effort_limit": [x.limit for x in numbers],
        "delay": [x.delay for x in numbers],
        "lag": [x.lag for x in numbers],
        "offset": [x.offset for x in numbers],
        "integral": [x.integral for x in numbers],
        "windup": [x.windup for x in numbers],
    }
    return Draws(
        vectors,
        {name: np.array(x) for name, x in joints.items()},
        names,
        {name: np.array(x) for name, x in inertials.items()},
        plant.own.step,
    )


def _vectors(found: Fit, count: int) -> Float[np.ndarray, "D P"]:
    low, high = (np.array([getattr(p, side) for p in found.table]) for side in ("low", "high"))
    moved = np.flatnonzero(found.moved)
    out = np.tile(found.theta, (count, 1))
    if len(moved):
        out[:, moved] = truncated_normal(
            found.theta[moved],
            found.covariance[np.ix_(moved, moved)],
            low[moved],
            high[moved],
            count,
            np.random.default_rng(0),
        )
    return out


def truncated_normal(
    mean: Float[np.ndarray, " P"],
    covariance: Float[np.ndarray, "P P"],
    low: Float[np.ndarray, " P"],
    high: Float[np.ndarray, " P"],
    count: int,
    rng: np.random.Generator,
) -> Float[np.ndarray, "D P"]:
    """`count` draws D of N(mean, covariance), given that each number is within its bounds.

    Gibbs sampling: each number in turn from its distribution given the others, a univariate normal between two bounds
    (Geweke 1991, *Efficient simulation from the multivariate normal and Student-t distributions subject to linear
    constraints*), one chain for each draw. Raises `numpy.linalg.LinAlgError` for a singular covariance.
    """
    precision = np.linalg.inv(covariance)
    spread = 1.0 / np.sqrt(np.diagonal(precision))
    out = np.tile(np.clip(mean, low, high), (count, 1))
    for _ in range(_SWEEPS):
        for k in range(len(mean)):
            pull = (out - mean) @ precision[k] - precision[k, k] * (out[:, k] - mean[k])
            centre = mean[k] - spread[k] ** 2 * pull
            ends = (low[k] - centre) / spread[k], (high[k] - centre) / spread[k]
            drawn = truncnorm.ppf(rng.random(count), *ends, loc=centre, scale=spread[k])
            # Far out in a tail a quantile is lost to rounding.
            out[:, k] = np.clip(drawn, low[k], high[k])
    return out
