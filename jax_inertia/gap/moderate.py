"""Forces no larger than the log tells them: along a limb that hardly moves while it is pushed, any force does the same.

A force is a vector, and before any data no axis has more of it than another: each of its numbers is of one standard
deviation σ, which the log itself tells (evidence maximised by expectation and maximisation; MacKay 1992),

    θ = argmin ‖y − A θ‖²/s² + Σ |f|²/σ²,    σ² = (|f|² + tr Σ_f)/3

with s² what is left of a sample and Σ the numbers' covariance. What the log tells stays as it is, the rest goes to
zero.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.pool import Pool
from jax_inertia.gap.together import misfit, solved, stacked

# How often σ is found anew at most, and the share by which it changes where it has settled.
TURNS, SETTLED = 200, 1e-3


def moderated(pool: Pool, chosen: list[Candidate]) -> list[Candidate]:
    """The chosen effects, the forces among them where the log tells them; as they are where none is a vector."""
    if not any(c.family.vector for c in chosen):
        return chosen
    columns, target = stacked(pool, chosen)
    noise = max(1.0, misfit(pool, chosen) / pool.evidence.rows)
    start = np.concatenate([c.theta for c in chosen])
    ends = np.cumsum([len(c.theta) for c in chosen])
    parts = [slice(end - len(c.theta), end) for c, end in zip(chosen, ends, strict=True)]
    vectors = [part for c, part in zip(chosen, parts, strict=True) if c.family.vector]
    prior = np.zeros(len(start))
    for part in vectors:
        prior[part] = 1.0 / max(float(np.mean(start[part] ** 2)), 1e-300)
    gram, cross = columns.T @ columns / noise, columns.T @ target / noise
    for _ in range(TURNS):
        before, covariance = prior.copy(), _inverse(gram + np.diag(prior))
        theta = covariance @ cross
        for part in vectors:
            size = theta[part] @ theta[part] + np.trace(covariance[part, part])
            prior[part] = len(theta[part]) / max(float(size), 1e-300)
        if np.all(np.abs(prior - before) <= SETTLED * before):
            break
    known = np.diag(np.sqrt(noise * prior))
    nothing = np.zeros(len(start))
    theta = solved(np.concatenate([columns, known]), np.concatenate([target, nothing]), start)
    return [
        dataclasses.replace(c, theta=theta[part]) for c, part in zip(chosen, parts, strict=True)
    ]


def _inverse(gram: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """Of a symmetric matrix whose rows may be of very different sizes."""
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(gram), 1e-300))
    return np.linalg.pinv(gram * np.outer(scale, scale), rcond=1e-12) * np.outer(scale, scale)
