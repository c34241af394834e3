"""The one score: log evidence of a linear-Gaussian model of the torque residual, with every number marginalised.

    y = Σₖ Aₖ θₖ + N z + ε,    θₖ ~ N(sₖ μₖ, diag sₖ²),   z ~ N(0, 1),   ε ~ N(0, V)

y: torque residual of all rows [N m]; Aₖ: columns of effect k; N: one column per tolerance of the nominal model, scaled
to its standard deviation; μ: zero, but for effects that are all there or not at all. Add and delete of a group have
closed forms (Tipping and Faul 2003, fast marginal likelihood; deletion by the Savage–Dickey ratio, Dickey 1971).
Columns here are scaled by their prior standard deviation.
"""

import copy
import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy import linalg

from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.search.bank import Bank

MOST_CORRELATED = 0.5
"""Lag-one correlation of a row's residual that counts as noise: friction's own misfit has less on sound logs, and what
goes together for longer is an effect that is not yet chosen."""


@dataclasses.dataclass(frozen=True, eq=False)
class Posterior:
    """Numbers of the chosen hypotheses given the data, in units of their prior standard deviation."""

    chosen: tuple[Hypothesis, ...]
    slices: tuple[slice, ...]
    mean: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    fitted: Float[np.ndarray, "R n"]
    """Torque of everything chosen, tolerances included [N m]."""

    def of(self, h: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
        """(mean (k,), covariance (k, k)) of one hypothesis in its own units."""
        part = self.slices[self.chosen.index(h)]
        return self.mean[part] * h.scale, self.covariance[part, part] * np.outer(h.scale, h.scale)

    def torque(self, h: Hypothesis) -> Float[np.ndarray, "R n"]:
        """Torque of one hypothesis at its posterior mean [N m]."""
        return h.torque(self.mean[self.slices[self.chosen.index(h)]], self.fitted.shape)


def form_variance(now: Posterior) -> Float[np.ndarray, "R n"]:
    """Variance of each row that errors of the chosen effects' own equations leave [N² m²]."""
    form = np.zeros_like(now.fitted)
    for h in now.chosen:
        if h.form_error:
            form += (h.form_error * now.torque(h)) ** 2
    return form


class Evidence:
    """Residual rows with their weights; judges sets of hypotheses."""

    def __init__(
        self,
        y: Float[np.ndarray, "R n"],
        weight: Float[np.ndarray, "R n"],
        least: Float[np.ndarray, " n"],
    ):
        self.y, self.weight, self.least = y, weight, least
        count = np.maximum(weight.sum(axis=0), 1.0)
        self.count = count
        self.gap = np.sqrt((weight * y**2).sum(axis=0) / count)
        """Root mean square of each row's torque residual [N m]."""
        self.variance = np.maximum((0.2 * self.gap) ** 2, least**2) * np.ones_like(y)
        self.correlation = np.ones(y.shape[1])

    def design(self, chosen: tuple[Hypothesis, ...]) -> Float[np.ndarray, "Rn p"]:
        """Weighted columns of the chosen, per prior standard deviation."""
        return _scaled(chosen, np.sqrt(self.precision))

    def without(self, part: Bool[np.ndarray, " R"]) -> "Evidence":
        """The same with some rows left out, variances kept."""
        out = copy.copy(self)
        out.weight = np.where(part[:, None], 0.0, self.weight)
        return out

    @property
    def precision(self) -> Float[np.ndarray, "R n"]:
        """Inverse variance of each row, divided by how many neighbours say the same."""
        return self.weight / (self.variance * self.correlation)

    def posterior(self, chosen: tuple[Hypothesis, ...]) -> Posterior:
        """Given the present variance."""
        root = np.sqrt(self.precision)
        columns = _scaled(chosen, root)
        gram = columns.T @ columns + np.eye(columns.shape[1])
        factor = linalg.cho_factor(gram, lower=True)
        told = columns.T @ (root * self.y).ravel()
        mean = linalg.cho_solve(factor, told + prior_mean(chosen))
        covariance = linalg.cho_solve(factor, np.eye(len(mean)))
        ends = np.cumsum([h.count for h in chosen])
        slices = tuple(slice(e - h.count, e) for e, h in zip(ends, chosen, strict=True))
        fitted = np.zeros_like(self.y)
        for h, part in zip(chosen, slices, strict=True):
            fitted += h.torque(mean[part], self.y.shape)
        return Posterior(chosen, slices, mean, covariance, fitted)

    def learn(self, now: Posterior) -> None:
        """Variance of each row from what the chosen leave, and from how exact their own equations are.

            V_jt = σ_j² + Σₖ fₖ² eₖ(t)²

        σ_j: residual rms of the row, degrees of freedom taken off; fₖ: relative error of effect k's equation. Residuals
        that go together over time count as (1 − ρ)/(1 + ρ) of their number, ρ their lag-one correlation.
        """
        left = self.y - now.fitted
        free = sum(h.count for h in now.chosen if h.named) / left.shape[1]
        count = np.maximum(self.count - free, 0.25 * self.count)
        form = form_variance(now)
        energy = (self.weight * left**2).sum(axis=0) / count
        excused = (self.weight * form).sum(axis=0) / np.maximum(self.count, 1.0)
        own = np.maximum(np.maximum(energy - excused, 0.1 * energy), self.least**2)
        self.variance = own + form
        white = left * np.sqrt(self.weight / self.variance)
        lagged = (white[1:] * white[:-1]).sum(axis=0) / np.maximum((white**2).sum(axis=0), 1e-12)
        rho = np.clip(lagged, 0.0, MOST_CORRELATED)
        self.correlation = (1.0 + rho) / (1.0 - rho)

    def gains(self, now: Posterior, others: Bank | Sequence[Hypothesis]) -> Float[np.ndarray, " c"]:
        """Change of log evidence when one more is added, prior odds apart, nats; one for each of `others`."""
        bank = others if isinstance(others, Bank) else Bank(others)
        root = np.sqrt(self.precision)
        base = _scaled(now.chosen, root).reshape(*self.y.shape, -1)
        return bank.gains(root, base, root * (self.y - now.fitted), now.covariance)

    def worths(self, now: Posterior) -> Float[np.ndarray, " k"]:
        """Log evidence that each of the chosen brings, prior odds apart, nats (Savage–Dickey)."""
        every = zip(now.chosen, now.slices, strict=True)
        return np.array([worth(h, now.mean[p], now.covariance[p, p]) for h, p in every])


def worth(
    h: Hypothesis, mean: Float[np.ndarray, " k"], covariance: Float[np.ndarray, "k k"]
) -> float:
    """ln p(z = 0) before the data less after, at posterior mean and covariance of z = θ / scale [nats]."""
    quadratic = mean @ np.linalg.solve(covariance, mean) - h.prior_mean @ h.prior_mean
    return float(0.5 * (quadratic + np.linalg.slogdet(covariance)[1]))


def prior_mean(chosen: Sequence[Hypothesis]) -> Float[np.ndarray, " p"]:
    """Prior mean of every number of the chosen, per prior standard deviation."""
    return np.concatenate([h.prior_mean for h in chosen]) if chosen else np.zeros(0)


def _scaled(
    chosen: tuple[Hypothesis, ...], root: Float[np.ndarray, "R n"]
) -> Float[np.ndarray, "Rn p"]:
    out = np.zeros((*root.shape, sum(h.count for h in chosen)))
    at = 0
    for h in chosen:
        if h.row is None:
            out[:, :, at : at + h.count] = h.scaled * root[:, :, None]
        else:
            out[:, h.row, at : at + h.count] = h.scaled * root[:, h.row, None]
        at += h.count
    return out.reshape(-1, out.shape[-1])
