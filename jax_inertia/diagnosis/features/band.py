"""Which accelerations are motion: those below a frequency, and for moments at which a joint moves faster, all of them.

What lies above is the encoders' noise twice differentiated, and the torque residual has it too: columns that share it
would take a share of it. Each row has a frequency of its own: a trunk that hardly moves is measured as noisily as legs
that step. A start or a stop is over before the spectrum of a whole log shows it, and what the low-pass takes from it no
effect could explain.
"""

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy import ndimage, signal

from jax_inertia.signals.torque_residual import Prepared, below

# No robot's motion ends below this [Hz].
SLOWEST = 4.0
# A moment [s] in which a robot may start or stop, and how many times the noise's largest power that must have.
MOMENT, LOUDER = 0.2, 1.5


@dataclasses.dataclass(frozen=True)
class Band:
    """Where in frequency and time a log's accelerations are motion."""

    cutoff: Float[np.ndarray, " nv"]
    """Up to this frequency [Hz] they are everywhere; infinite where the chain ends first."""
    faster: Float[np.ndarray, "T nv"]
    """At which moments of the fast grid they are above it, too: 1 there, 0 elsewhere, smooth between."""

    @classmethod
    def of(cls, prepared: Prepared, again: Prepared) -> "Band":
        """The band of a log, by the same log with its sensors' noise once more."""
        a = np.asarray(prepared.observation.a)
        noise = np.asarray(again.observation.a) - a
        cutoff = _cutoffs(prepared, a, noise)
        rate = prepared.bands.rows
        moment = round(MOMENT * rate)

        def loudness(x: Float[np.ndarray, "T nv"]) -> Float[np.ndarray, "R nv"]:
            above = prepared.finish(x - _below(cutoff, x, prepared.rate))
            return ndimage.uniform_filter1d(above**2, moment, axis=0)

        quiet = loudness(noise)
        usual = quiet.mean(axis=0)
        # One row's noise of one log hardly tells how large it may be for a moment; all rows' together do.
        most = np.max(quiet / np.maximum(usual, 1e-300))
        loud = 1.0 * (loudness(a) > LOUDER * most * usual)
        loud = ndimage.maximum_filter1d(loud, 2 * moment + 1, axis=0)
        hann = np.hanning(moment + 2)
        faster = ndimage.convolve1d(loud, hann / hann.sum(), axis=0, mode="nearest")
        at = prepared.time[prepared.kept]
        return cls(cutoff, np.stack([np.interp(prepared.time, at, x) for x in faster.T], axis=1))

    def motion(self, a: Float[np.ndarray, "T nv"], rate: float) -> Float[np.ndarray, "T nv"]:
        """What of accelerations on the fast grid is motion."""
        slow = _below(self.cutoff, a, rate)
        return slow + self.faster * (a - slow)


def _below(
    cutoff: Float[np.ndarray, " nv"], x: Float[np.ndarray, "T nv"], rate: float
) -> Float[np.ndarray, "T nv"]:
    """Each row below its own cut-off."""
    out = x.copy()
    for f in np.unique(cutoff[np.isfinite(cutoff)]):
        out[:, cutoff == f] = below(float(f), x[:, cutoff == f], rate)
    return out


def _cutoffs(
    prepared: Prepared, a: Float[np.ndarray, "T nv"], noise: Float[np.ndarray, "T nv"]
) -> Float[np.ndarray, " nv"]:
    """Where a cut takes least from each row's motion for what it takes from its noise [Hz]."""
    rate = prepared.bands.rows
    own, noise = prepared.finish(a), prepared.finish(noise)
    pieces = min(len(own), round(2 * rate))
    frequency, power = signal.welch(own, rate, nperseg=pieces, axis=0)
    noise_power = signal.welch(noise, rate, nperseg=pieces, axis=0)[1]
    # Motion less noise: what is measured has its own noise in it.
    worth = np.cumsum(power - 2.0 * noise_power, axis=0)
    cutoff = np.maximum(frequency[worth.argmax(axis=0)], SLOWEST)
    return np.where(cutoff < prepared.bands.cutoff, cutoff, np.inf)
