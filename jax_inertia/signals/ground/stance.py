"""When a foot swings: the probability of each sample, by the load that its leg shows and by how fast it moves.

A hidden Markov chain of two states a foot, stance and swing (forward–backward; Rabiner, Proc. IEEE 77(2), 1989). With x
the foot's vertical load over its share of the weight and u its speed over ground [m/s],

    swing:   x ~ N(0, s²),             u ~ Exp(`SWINGS`)
    stance:  x ~ Exp(1) for x > 0,     u ~ |N(0, `GIVES`²)|, or as in a swing where it slips (`SLIPS`)

s is what the model's error leaves of the load of a foot in the air: the log itself shows it. A foot that is lightly
loaded and does not move may stand. Contact flags are one more measurement, wrong once in `FLAG_ERROR`.
"""

import numpy as np
from jaxtyping import Bool, Float

LASTS = 0.1
"""A foot changes between stance and swing after this time in the mean [s]; a trot's swing takes 0.15 to 0.3 s."""
SWINGS = 0.3
"""Mean speed of a foot that swings [m/s]: steps of 5 cm in 0.2 s."""
GIVES = 0.05
"""Speed of a foot that stands [m/s], one standard deviation: it rolls, and sinks when it is set down."""
SLIPS = 0.1
"""Share of a stance in which a foot slips: as it is set down and lifted, 20 ms of 0.3 s each."""
LEAST, MOST = 0.03, 0.15
"""Bounds of s: torque noise of a good motor; more than that is no foot in the air."""
INDEPENDENT = 50.0
"""Samples a second that count as independent [Hz]: errors of a model last as long as its motion."""
FLAG_ERROR = 0.02
"""Share of samples in which a contact flag is wrong: debounced switches are late by some milliseconds a step."""
TOUCHES = 0.15
"""Share of a foot's largest reported load from which it touches: force sensors have a zero of some percent."""
CERTAIN = 0.99
"""Probability of swing from which a foot is taken to bear nothing."""
# Of learning s and the states in turn.
_ROUNDS = 4


def swinging(
    share: Float[np.ndarray, "T C"],
    speed: Float[np.ndarray, "T C"],
    rate: float,
    flag: Float[np.ndarray, "T C"] | None = None,
) -> Bool[np.ndarray, "T C"]:
    """Samples at which a foot is in the air with probability `CERTAIN`.

    `share`: vertical load of each foot over its share of the weight; `speed` over ground [m/s]; `rate` [Hz] of the
    samples; `flag`: the reported contact, from 0 to 1, NaN where there is none.

    >>> import numpy as np
    >>> from jax_inertia.signals.ground.stance import swinging
    >>> load, speed = np.ones((100, 1)), np.zeros((100, 1))
    >>> load[40:80], speed[40:80] = 0.0, 0.5
    >>> np.flatnonzero(swinging(load, speed, 250.0)[:, 0])[[0, -1]]
    array([40, 79])
    """
    swing, spread = np.zeros_like(share), np.full(share.shape[1], MOST)
    for _ in range(_ROUNDS):
        likelihood = _log_likelihood(share, speed, spread)
        if flag is not None:
            wrong, right = np.log([FLAG_ERROR, 1.0 - FLAG_ERROR])
            by_flag = np.where(flag[..., None] > TOUCHES, [wrong, right], [right, wrong])
            likelihood += np.where(np.isnan(flag[..., None]), 0.0, by_flag)
        swing = _smoothed(likelihood * min(INDEPENDENT / rate, 1.0), 1.0 / (LASTS * rate))
        mean_square = np.sum(swing * share**2, axis=0) / np.maximum(swing.sum(axis=0), 1e-9)
        spread = np.clip(np.sqrt(mean_square), LEAST, MOST)
    return np.asarray(swing > CERTAIN)


def _log_likelihood(
    share: Float[np.ndarray, "T C"],
    speed: Float[np.ndarray, "T C"],
    spread: Float[np.ndarray, " C"],
) -> Float[np.ndarray, "T C 2"]:
    """Of swing and of stance."""
    swing = -0.5 * (share / spread) ** 2 - np.log(spread * np.sqrt(2.0 * np.pi))
    moves = -speed / SWINGS - np.log(SWINGS)
    still = -0.5 * (speed / GIVES) ** 2 + 0.5 * np.log(2.0 / np.pi) - np.log(GIVES)
    # A load of less than nothing is the error of one of nothing.
    stance = -np.maximum(share, 0.0) - 0.5 * (np.minimum(share, 0.0) / spread) ** 2
    by_speed = np.logaddexp(np.log(1.0 - SLIPS) + still, np.log(SLIPS) + moves)
    return np.stack([swing + moves, stance + by_speed], axis=-1)


def _smoothed(likelihood: Float[np.ndarray, "T C 2"], change: float) -> Float[np.ndarray, "T C"]:
    """Probability of the first state at each sample, given all of them; the scaled forward-backward algorithm."""
    change = min(change, 0.5)
    move = np.array([[1.0 - change, change], [change, 1.0 - change]])
    own = np.exp(likelihood - likelihood.max(axis=-1, keepdims=True))
    forward, backward = np.empty_like(own), np.ones_like(own)
    now = np.full(own.shape[1:], 0.5)
    for t, seen in enumerate(own):
        now = (now @ move) * seen
        forward[t] = now = now / now.sum(axis=-1, keepdims=True)
    for t in range(len(own) - 2, -1, -1):
        after = (own[t + 1] * backward[t + 1]) @ move
        backward[t] = after / after.sum(axis=-1, keepdims=True)
    both = forward * backward
    return both[..., 0] / both.sum(axis=-1)
