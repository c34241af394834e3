"""How far numbers would be elsewhere with effects that may be there, though they are less likely than their price.

Intervals are of what is found and of each fit with one more effect a, each as probable as it is (Bayesian model
averaging; Hoeting et al., Statistical Science 14(4), 1999):

    var θ = C + Σ_a p_a (δ_a² + C_a − C),      p_a = w_a / (1 + Σ_b w_b),      w_a = exp(e_a / 2)

with δ_a how numbers follow the effect, C_a their variance then, and e_a its evidence, its price paid. Gains, frictions
and masses by one factor are the same motion: without torque it is a load, or a little less of every gain.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.search.candidates import Candidate
from jax_inertia.replay.search.parsimony import Parabola, nominal
from jax_inertia.replay.search.tries import AS_GOOD


class Possible(NamedTuple):
    """An effect that did not get in, by less than a twentieth of the probability."""

    candidate: Candidate
    evidence: float
    """By how much the log is likelier with it, its price paid, in twice nats."""
    fit: Fit
    """With its numbers last."""


def most_likely(possible: Sequence[Possible]) -> tuple[Possible, ...]:
    """Of each candidate the likeliest fit, the likeliest candidate first."""
    best: dict[Candidate, Possible] = {}
    for x in sorted(possible, key=lambda x: -x.evidence):
        best.setdefault(x.candidate, x)
    return tuple(best.values())


def elsewhere(found: Fit, without: Fit, possible: Sequence[Possible]) -> Float[np.ndarray, " P"]:
    """What effects that may be there add to each number's deviation, in squares.

    `without`: the fit that they were compared to. What evidence asks for and validation rows do not show is none.
    """
    possible = [x for x in possible if x.evidence <= AS_GOOD]
    weights, now = np.exp([0.5 * x.evidence for x in possible]), _simplest(without, without)
    out = np.zeros(len(found.table))
    for w, x in zip(weights / (1.0 + weights.sum()), possible, strict=True):
        there, wider = _simplest(x.fit, without), np.diagonal(x.fit.covariance)
        wider = np.maximum(wider[: len(now)] - np.diagonal(without.covariance), 0.0)
        of = {
            (p.family, p.joint, p.body): v
            for p, v in zip(
                without.table, ((there[: len(now)] - now) ** 2 + wider).tolist(), strict=True
            )
        }
        out += w * np.array([of.get((p.family, p.joint, p.body), 0.0) for p in found.table])
    # What is not fitted stays where it is.
    return np.where(found.free, out, 0.0)


def _simplest(of: Fit, without: Fit) -> Float[np.ndarray, " P"]:
    """Where numbers of a fit are once those that it does not need are the model's own."""
    about, theta = Parabola(of, without.samples, without.weights), of.theta.copy()
    theta[about.go] = nominal(of)[about.go] + about.worth().off
    return theta
