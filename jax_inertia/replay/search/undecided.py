"""Whether a log can tell dry friction that falls with speed (Stribeck's) from one that does not (Coulomb's).

Stribeck's is Coulomb's and S exp(−(q̇/v)²) more. The evidence for it is that of both models with S integrated over its
prior, half a normal distribution about 0: on the cost's parabola about S = 0, c + 2 b S + a S² with all other numbers
at their best and the prior's 1/sd² in a,

p(log | Stribeck) / p(log | Coulomb) = 2 Φ(−b/√a) exp(b²/(2a)) / (sd √a),

(Laplace's; MacKay 2003, chapter 28), its mean over the speeds v that are tried. Where the log says nothing
of S this is 1.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr, logsumexp


def log_odds(
    slope: Float[np.ndarray, " v"], bend: Float[np.ndarray, " v"], sd: float
) -> Float[np.ndarray, " v"]:
    """ln of the ratio for each speed; `slope` b, `bend` a."""
    z = -slope / np.sqrt(bend)
    return np.log(2.0) + log_ndtr(z) + 0.5 * z**2 - np.log(sd) - 0.5 * np.log(bend)


def mean_size(slope: float, bend: float) -> float:
    """The mean of S, given the log: of a normal distribution cut off at 0."""
    z = -slope / np.sqrt(bend)
    return float((z + np.exp(-0.5 * z**2 - 0.5 * np.log(2 * np.pi) - log_ndtr(z))) / np.sqrt(bend))


def open_between(slopes: Sequence[float], bends: Sequence[float], sd: float) -> tuple[float, float]:
    """(ln of the ratio, mean size of S) over all speeds tried, the size at the likeliest of them."""
    slope, bend = np.array(slopes), np.array(bends)
    each = log_odds(slope, bend, sd)
    best = int(np.argmax(each))
    return float(logsumexp(each) - np.log(len(each))), mean_size(slope[best], bend[best])
