"""What a hypothesis gains by the sensors' noise alone: columns computed of the log carry the noise that is in y.

An acceleration's noise is in the torque that the model needs, and in every column made of accelerations: the two are
correlated, and a column of noise explains noise. With noise added once more to the log, all change, by ΔA, ΔX and Δy;
what noise adds to AᵀW (y − X m̂), m̂ = C XᵀW y the numbers of what is chosen already, is

    E ΔAᵀ W Δr − AᵀW X C E ΔXᵀ W Δr,    r = y − X m̂

(corrected score of errors in variables: Nakamura, Biometrika 77(1), 1990). The second term is the noise that the chosen
take: what a rotor inertia's tolerance explains of it, another rotor inertia there does not. Of one log it is as much by
chance as from one replica to the next, which counts as well: a score within that says nothing but noise.
"""

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.hypothesis import Hypothesis, elsewhere
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior, scaled

GROUPS = 10
"""Parts of a log by which the noise's chance is counted."""


def share(residual: Residual, evidence: Evidence, now: Posterior, h: Hypothesis) -> float:
    """Of the log evidence that one more hypothesis gains, what the noise in its columns brings [nats]."""
    root = np.sqrt(evidence.precision)
    here = scaled((h, *now.chosen), root)
    own, base = np.split(here, [h.count], axis=1)
    cross = base.T @ own
    s = np.eye(h.count) + own.T @ own - cross.T @ now.covariance @ cross
    told = own.T @ (root * (evidence.y - now.fitted)).ravel() + h.prior_mean
    scores = by_noise(residual, root, now, h, here) @ np.concatenate(
        [np.eye(h.count), -now.covariance @ cross]
    )
    without = told - scores.sum(axis=1).mean(axis=0)
    apart = (scores - scores.mean(axis=0)).reshape(-1, h.count)
    chance = apart.T @ apart * (1.0 + 1.0 / len(scores)) / (len(scores) - 1)
    whole, clean, sure = (
        0.5 * float(x @ np.linalg.solve(spread, x))
        for x, spread in ((told, s), (without, s), (without, s + chance))
    )
    return whole - clean if sure > h.odds else whole


def owed(residual: Residual, evidence: Evidence, rest: Posterior, h: Hypothesis) -> float:
    """What a hypothesis owes to noise given others [nats]; what noise hides of it is none of its evidence."""
    return max(share(residual, evidence, rest, h), 0.0)


def owed_in(residual: Residual, evidence: Evidence, now: Posterior, h: Hypothesis) -> float:
    """The same of one of the chosen, given the others [nats]."""
    return owed(residual, evidence, now.without(h), h)


def by_noise(
    residual: Residual,
    root: Float[np.ndarray, "R n"],
    now: Posterior,
    h: Hypothesis,
    here: Float[np.ndarray, "Rn q"],
) -> Float[np.ndarray, "replicas parts q"]:
    """ΔAᵀ W Δr and ΔXᵀ W Δr of each part of each replica of the log, per prior standard deviation of each number.

    `here`: columns of `h` and of the chosen on the log itself, times `root`, the square root of the precision.
    """
    every = (h, *now.chosen)
    numbers = np.concatenate([np.zeros(h.count), now.mean])
    out = []
    for again in residual.replicas:
        # When a joint is held is one for all replicas.
        there = tuple(c if c.effect.of_log else elsewhere(c, again) for c in every)
        change = scaled(there, root) - here
        left = (root * (again.y - residual.y)).ravel() - change @ numbers
        parts = np.array_split(change * left[:, None], GROUPS)
        out.append([part.sum(axis=0) for part in parts])
    return np.array(out)
