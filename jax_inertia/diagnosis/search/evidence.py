"""The one score: log evidence of a linear-Gaussian model of the torque residual, with every number marginalised.

    y = Σₖ Aₖ θₖ + N z + ε,    θₖ ~ N(0, diag sₖ²),   z ~ N(0, 1),   ε ~ N(0, V)

V is learned from what the chosen leave: a variance of every row, and how much of it is slow (`discrepancy`).

y: torque residual of all rows [N m]; Aₖ: columns of effect k; N: one column per tolerance of the nominal model, scaled
to its standard deviation. Add and delete of a group have closed forms (Tipping and Faul 2003, fast marginal likelihood;
deletion by the Savage–Dickey ratio, Dickey 1971). Columns here are scaled by their prior standard deviation.
"""

import copy
import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy import linalg

from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.search.bank import Bank
from jax_inertia.diagnosis.search.discrepancy import Whitener
from jax_inertia.diagnosis.search.noise import Noise

@dataclasses.dataclass(frozen=True, eq=False)
class Posterior:
    """Numbers of the chosen hypotheses given the data, in units of their prior standard deviation."""

    chosen: tuple[Hypothesis, ...]
    slices: tuple[slice, ...]
    mean: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    fitted: Float[np.ndarray, "R n"]
    """Torque of everything chosen, tolerances included [N m]."""
    log_evidence: float = np.nan
    """ln p(y) of all rows with every number marginalised, up to a constant of the log, nats."""

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
        variance = np.maximum((0.2 * self.gap) ** 2, least**2) * np.ones_like(y)
        self.noise = Noise(variance, tuple(Whitener(w) for w in weight.T))

    def design(self, chosen: tuple[Hypothesis, ...]) -> Float[np.ndarray, "R n p"]:
        """Whitened columns of the chosen, per prior standard deviation."""
        out = np.zeros((*self.y.shape, sum(h.count for h in chosen)))
        at = 0
        for h in chosen:
            whole = slice(None) if h.row is None else h.row
            out[:, whole, at : at + h.count] = self.noise.whitened(h.scaled, h.row)
            at += h.count
        return out

    def without(self, part: Bool[np.ndarray, " R"]) -> "Evidence":
        """The same with some rows left out, variances kept."""
        out = copy.copy(self)
        out.weight = np.where(part[:, None], 0.0, self.weight)
        whiteners = (Whitener(w, n.at) for w, n in zip(out.weight.T, self.noise.whiteners, strict=True))
        out.noise = Noise(self.noise.variance, tuple(whiteners))
        return out

    def independent(self) -> "Evidence":
        """The same with rows that are independent and count as (1 − ρ)/(1 + ρ) of their number, ρ their lag-one
        correlation: for what lasts too short for a discrepancy's whole memory."""
        out = copy.copy(self)
        rho = np.array([w.lagged for w in self.noise.whiteners])
        variance = self.noise.variance * (1.0 + rho) / (1.0 - rho)
        out.noise = Noise(variance, tuple(Whitener(w) for w in self.weight.T))
        return out

    def posterior(self, chosen: tuple[Hypothesis, ...]) -> Posterior:
        """Given the present noise."""
        columns = self.design(chosen).reshape(self.y.size, -1)
        y = self.noise.residual(self.y).ravel()
        gram = columns.T @ columns + np.eye(columns.shape[1])
        factor = linalg.cho_factor(gram, lower=True)
        along = columns.T @ y
        mean = linalg.cho_solve(factor, along)
        covariance = linalg.cho_solve(factor, np.eye(len(mean)))
        ends = np.cumsum([h.count for h in chosen])
        slices = tuple(slice(e - h.count, e) for e, h in zip(ends, chosen, strict=True))
        fitted = np.zeros_like(self.y)
        for h, part in zip(chosen, slices, strict=True):
            fitted += h.torque(mean[part], self.y.shape)
        logdet = self.noise.log_determinant + 2.0 * float(np.log(np.diag(factor[0])).sum())
        log_evidence = -0.5 * (logdet + float(y @ y) - float(along @ mean))
        return Posterior(chosen, slices, mean, covariance, fitted, log_evidence)

    def learn(self, now: Posterior) -> None:
        """Noise of each row from what the chosen leave, and from how exact their own equations are.

            V_jt = σ_j² + Σₖ fₖ² eₖ(t)²

        σ_j: residual rms of the row, degrees of freedom taken off; fₖ: relative error of effect k's equation. How much
        of it is slow, and over what time, is what makes the residual likeliest.
        """
        left = self.y - now.fitted
        free = sum(h.count for h in now.chosen if h.named) / left.shape[1]
        count = np.maximum(self.count - free, 0.25 * self.count)
        form = form_variance(now)
        energy = (self.weight * left**2).sum(axis=0) / count
        excused = (self.weight * form).sum(axis=0) / np.maximum(self.count, 1.0)
        own = np.maximum(np.maximum(energy - excused, 0.1 * energy), self.least**2)
        variance = own + form
        white = left / np.sqrt(variance)
        whiteners = tuple(
            w.likeliest(x) for w, x in zip(self.noise.whiteners, white.T, strict=True)
        )
        scale = np.array([w.fit(x)[1] for w, x in zip(whiteners, white.T, strict=True)])
        variance = np.maximum(variance * scale**2 * self.count / count, self.least**2)
        self.noise = Noise(variance, whiteners)

    def gains(self, now: Posterior, others: Bank | Sequence[Hypothesis]) -> Float[np.ndarray, " c"]:
        """Change of log evidence when one more is added, prior odds apart, nats; one for each of `others`."""
        bank = others if isinstance(others, Bank) else Bank(others)
        left = self.noise.residual(self.y - now.fitted)
        return bank.gains(self.noise, self.design(now.chosen), left, now.covariance)

    def worths(self, now: Posterior) -> Float[np.ndarray, " k"]:
        """Log evidence that each of the chosen brings, prior odds apart, nats (Savage–Dickey)."""
        out = []
        for part in now.slices:
            mean, covariance = now.mean[part], now.covariance[part, part]
            _, logdet = np.linalg.slogdet(covariance)
            quadratic = mean @ np.linalg.solve(covariance, mean)
            out.append(0.5 * (quadratic + logdet))
        return np.array(out)

