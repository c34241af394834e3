"""What a hypothesis gains by the sensors' noise alone: columns computed of the log carry the noise that is in y.

An acceleration's noise is in the torque that the model needs, and in every column made of accelerations: the two are
correlated, and a column of noise explains noise. With noise added once more to the log, both change, by ΔA and Δy; what
noise adds to AᵀW y is E ΔAᵀ W Δy (corrected score of errors in variables: Nakamura, Biometrika 77(1), 1990).
"""

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.hypothesis import Hypothesis, elsewhere
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior


def share(residual: Residual, evidence: Evidence, now: Posterior, h: Hypothesis) -> float:
    """Of the log evidence that one more hypothesis gains, what the noise in its columns brings [nats]."""
    root = np.sqrt(evidence.precision)
    own = _flat(h, root)
    base = evidence.design(now.chosen)
    cross = base.T @ own
    s = np.eye(h.count) + own.T @ own - cross.T @ now.covariance @ cross
    told = own.T @ (root * (evidence.y - now.fitted)).ravel() + h.prior_mean
    without = told - by_noise(residual, evidence, now, h)
    both = np.stack([told, without], axis=1)
    whole, clean = np.sum(both * np.linalg.solve(s, both), axis=0)
    return float(0.5 * (whole - clean))


def by_noise(
    residual: Residual, evidence: Evidence, now: Posterior, h: Hypothesis
) -> Float[np.ndarray, " k"]:
    """E ΔAᵀ W Δ(y − fitted), over replicas of the log; A per prior standard deviation of each number."""
    root = np.sqrt(evidence.precision)
    named = [c for c in now.chosen if c.is_odd]
    parts = []
    for again in residual.replicas:
        change = again.y - residual.y
        for c in named:
            theta = now.mean[now.slices[now.chosen.index(c)]]
            change = change - (elsewhere(c, again).torque(theta, change.shape) - now.torque(c))
        columns = _flat(elsewhere(h, again), root) - _flat(h, root)
        parts.append(columns.T @ (root * change).ravel())
    return np.mean(parts, axis=0)


def _flat(h: Hypothesis, root: Float[np.ndarray, "R n"]) -> Float[np.ndarray, "Rn k"]:
    """Weighed columns on all rows, per prior standard deviation."""
    out = np.zeros((*root.shape, h.count))
    if h.row is None:
        out[:] = h.scaled * root[..., None]
    else:
        out[:, h.row] = h.scaled * root[:, h.row, None]
    return out.reshape(root.size, h.count)
