"""Which way dry friction points: against the motion, and nowhere at rest, where it is whatever balances.

At rest the sign of a measured velocity is the sign of its noise. Taken for friction it would chatter through the whole
chain, and a robot whose model has friction at every joint would seem to have sensors ten times as noisy as they are.
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy import signal

# A sharp sign: friction reverses within a few mrad/s, and a softer one passes for viscous friction.
SIGN_VELOCITY = 0.003
# Slower than this [rad/s] for longer than this [s] is standing still.
STILL, DWELL = 0.012, 0.04
# A joint whose model creeps by its own friction stands still where it is no faster than this many times that speed; but
# not where it is faster than this [rad/s]: beside a link that weighs nothing a model creeps for radians a second.
CREEPING, FASTEST = 1.3, 0.06


def sign(v: Float[np.ndarray, "T *n"]) -> Float[np.ndarray, "T *n"]:
    """sign(v) as a slider of the presliding range sees it."""
    return np.tanh(v / SIGN_VELOCITY)


def stillness(creeping: Float[np.ndarray, "*n"] | float) -> Float[np.ndarray, "*n"]:
    """Speed below which friction may hold a joint [rad/s]; `creeping`: how fast it lets the joint creep."""
    return np.asarray(np.clip(CREEPING * np.asarray(creeping), STILL, FASTEST))


def at_rest(
    v: Float[np.ndarray, "T n"], rate: float, creeping: Float[np.ndarray, " n"] | float = 0.0
) -> Bool[np.ndarray, "T n"]:
    """Where a joint stands still, in velocities at `rate` [Hz]; `creeping` as of `stillness`."""
    still = np.abs(v) < stillness(creeping)
    width = max(1, round(DWELL * rate))
    # Erode, then dilate: stretches shorter than the width disappear.
    kernel = np.ones((width, 1))
    core = signal.convolve(still * 1.0, kernel, mode="same") > width - 0.5
    return signal.convolve(core * 1.0, kernel, mode="same") > 0.5


def direction(
    v: Float[np.ndarray, "T n"], rest: Bool[np.ndarray, "T n"]
) -> Float[np.ndarray, "T n"]:
    """What multiplies a level of friction: the sign of velocity, zero at rest."""
    return np.where(rest, 0.0, sign(v))
