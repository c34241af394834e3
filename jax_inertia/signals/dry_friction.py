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
# Into how many parts a sample's period is divided to see how long a joint is slow.
PARTS = 8
# A joint whose model creeps by its own friction stands still where it is no faster than this many times that speed; but
# not where it is faster than this [rad/s]: with a link that weighs nothing a model creeps for radians a second.
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


def share_below(
    v: Float[np.ndarray, "T n"], still: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "T n"]:
    """Share of each sample's period in which velocities, linear from sample to sample, are below a speed."""
    at = np.arange(len(v))
    parts = (np.arange(len(at) * PARTS) + 0.5) / PARTS - 0.5
    within = np.stack([np.interp(parts, at, x) for x in v.T], axis=1)
    return (np.abs(within) < still).reshape(len(at), PARTS, -1).mean(axis=1)


def bristle(
    x: Float[np.ndarray, " T"],
    start: float,
    reach: float | Float[np.ndarray, " T"],
    *,
    straight: bool = False,
) -> Float[np.ndarray, " T"]:
    """z in [−1, 1] along a path x, dz/dx = (1 − z sign ẋ)/reach from z = start (Dahl 1968).

    `straight`: dz/dx = 1/reach until it slips at ±1 (a spring and a slider; Prandtl 1928). Where the reach changes, how
    far bristles are bent, z reach, does not with it: their stiffness is kept while their level changes (LuGre; Canudas
    de Wit et al. 1995).
    """
    reaches = np.broadcast_to(reach, x.shape)
    out = np.empty(len(x))
    out[0] = bent = start * reaches[0]
    moves = np.diff(x)
    if straight:
        for k, (move, most) in enumerate(zip(moves.tolist(), reaches[1:].tolist(), strict=True)):
            out[k + 1] = bent = min(max(bent + move, -most), most)
        return out / reaches
    ends, stays = np.sign(moves) * reaches[1:], np.exp(-np.abs(moves) / reaches[1:])
    for k, (end, stay) in enumerate(zip(ends.tolist(), stays.tolist(), strict=True)):
        out[k + 1] = bent = end + (bent - end) * stay
    return out / reaches
