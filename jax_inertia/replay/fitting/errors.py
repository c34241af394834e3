"""What replays err by, output by output, and what an error counts."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.maths.sample_weight import autocorrelation_time
from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.record import Record
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import misses, replay


class Weights(NamedTuple):
    """What an error of an output counts: remaining rms σ [rad or N m] and autocorrelation time T [samples]."""

    sigma: Float[np.ndarray, " m"]
    correlated: Float[np.ndarray, " m"]

    @property
    def root(self) -> Float[np.ndarray, " m"]:
        """The square root of one sample's weight."""
        return 1.0 / (self.sigma * np.sqrt(self.correlated))


def replay_errors(
    plant: Plant,
    table: Sequence[Parameter],
    thetas: Float[np.ndarray, "B P"],
    records: Sequence[Record],
) -> Float[np.ndarray, "B N m"]:
    """Replay minus log of every vector, all records one after the other, where they count [rad].

    Where torque is logged it is a second output of every joint, after all positions: `simulate.misses` [N m].
    """
    parts = []
    for r in records:
        error = replay(plant, table, thetas, r) - r.q
        if r.torque is not None:
            error = np.concatenate([error, misses(plant, table, thetas, r)], axis=2)
        parts.append(error[:, r.settled])
    return np.concatenate(parts, axis=1)


def weights(error: Float[np.ndarray, "N m"], floor: float | Float[np.ndarray, " m"]) -> Weights:
    """From an error as it is."""
    sigma = np.maximum(np.sqrt(np.mean(error**2, axis=0)), floor)
    return Weights(sigma, np.array([autocorrelation_time(e) for e in error.T]))


def likelier(
    new: Float[np.ndarray, "N m"],
    old: Float[np.ndarray, "N m"],
    floor: Float[np.ndarray, " m"],
    correlated: float | Float[np.ndarray, " m"] = 1.0,
) -> tuple[float, Float[np.ndarray, " m"]]:
    """By how much rows are likelier by new errors than by old ones, in twice nats, and the independent samples.

        Σ_j N/T_j ln(σ_j² / σ'_j²)

    σ_j: rms of output j's error, at least its `floor`; N/T_j: its independent samples, T_j the longest autocorrelation
    time of its errors, at least `correlated`.
    """
    after, before = (np.maximum(np.mean(e**2, axis=0), floor**2) for e in (new, old))
    times = np.max([[autocorrelation_time(x) for x in e.T] for e in (new, old)], axis=0)
    independent = len(new) / np.maximum(times, correlated)
    return float(np.sum(independent * np.log(before / after))), independent
