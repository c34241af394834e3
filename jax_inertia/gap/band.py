"""Which accelerations are motion: those below a frequency, and for moments at which a robot moves faster, all of them.

What lies above is the encoders' noise twice differentiated, and the missing torque has it too: columns that share it
would take a share of it. A start or a stop is over before the spectrum of a whole log shows it, and what the low-pass
takes from it no effect could explain.
"""

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy import ndimage, signal

from jax_inertia.gap.chain import Prepared, below
from jax_inertia.gap.noise import Whitener

# No robot's motion ends below this [Hz].
SLOWEST = 4.0
# A moment [s] in which a robot may start or stop, and how much louder than the noise ever is that must be.
MOMENT, LOUDER = 0.2, 1.5


@dataclasses.dataclass(frozen=True)
class Band:
    """Where in frequency and time a log's accelerations are motion."""

    cutoff: float
    """Up to this frequency [Hz] they are everywhere."""
    faster: Float[np.ndarray, " T"]
    """At which moments of the fast grid they are above it, too: 1 there, 0 elsewhere, smooth between."""

    @classmethod
    def of(
        cls, prepared: Prepared, white: Whitener, replicas: Float[np.ndarray, "K R nv"]
    ) -> "Band":
        """The band of a log, by its noise's `replicas` in the finished missing torque."""
        cutoff = _cutoff(prepared, white, replicas)
        own, rate = prepared.settings, prepared.settings.decimated
        if cutoff >= own.after:
            return cls(cutoff, np.ones(len(prepared.time)))
        moment = round(MOMENT * rate)

        def loudness(x: Float[np.ndarray, "R nv"]) -> Float[np.ndarray, " R"]:
            return ndimage.uniform_filter1d(np.sum((x / white.sigma) ** 2, axis=1), moment)

        inverse = prepared.inverse
        above = loudness(prepared.finish(inverse - below(cutoff, inverse, prepared.rate)))
        noise = max(loudness(x - below(cutoff, x, rate)).max() for x in replicas)
        loud = ndimage.maximum_filter1d(1.0 * (above > LOUDER * noise), 2 * moment + 1)
        hann = np.hanning(moment + 2)
        faster = ndimage.convolve1d(loud, hann / hann.sum(), mode="nearest")
        return cls(cutoff, np.interp(prepared.time, prepared.time[prepared.kept], faster))

    def motion(self, x: Float[np.ndarray, "T n"], rate: float) -> Float[np.ndarray, "T n"]:
        """What of signals on the fast grid is motion; all of them where the band does not end."""
        if self.faster.all():
            return x
        slow = below(self.cutoff, x, rate)
        return slow + self.faster[:, None] * (x - slow)


def _cutoff(prepared: Prepared, white: Whitener, replicas: Float[np.ndarray, "K R nv"]) -> float:
    """Up to which frequency [Hz] there is more motion than noise in the needed torque, all rows in units of noise."""
    needed = prepared.finish_torque(prepared.inverse) / white.sigma
    rate = prepared.settings.decimated
    pieces = min(len(needed), round(2 * rate))
    frequency, power = signal.welch(needed, rate, nperseg=pieces, axis=0)
    noise = signal.welch(replicas / white.sigma, rate, nperseg=pieces, axis=1)[1].mean(axis=0)
    more = np.flatnonzero(power.sum(axis=1) > 2.0 * noise.sum(axis=1))
    return float(max(frequency[more[-1]] if len(more) else 0.0, SLOWEST))
