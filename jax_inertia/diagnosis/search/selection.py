"""What the evidence keeps of the hypotheses, and what they were kept among."""

import dataclasses
import functools
from collections.abc import Collection, Iterator

import numpy as np
from jaxtyping import Float
from scipy import linalg

from jax_inertia.diagnosis.hypothesis import Hypothesis, excluded
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search import sensor_noise
from jax_inertia.diagnosis.search.bank import Bank
from jax_inertia.diagnosis.search.best_numbers import relinearised
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior, prior_mean
from jax_inertia.diagnosis.settings import CalibrationState

UNLIKELY = -5.0
"""Log odds [nats] below which an effect adds nothing to the odds that any is there."""
SAID = 1e-6
"""Information of a log on numbers that it says nothing of, per prior variance: so that what it says has an inverse."""
GROUPS = 10
"""Parts of a log that are taken for independent of each other."""


@dataclasses.dataclass(frozen=True, eq=False)
class Selection:
    """The hypotheses that the log's evidence keeps, and the candidates they were kept among."""

    residual: Residual
    evidence: Evidence
    posterior: Posterior
    candidates: tuple[Hypothesis, ...]
    tried: tuple[Hypothesis, ...]
    """Ordinary effects of every joint, those included that no robot can have at their best values."""

    @property
    def state(self) -> CalibrationState:
        """Whether the model is taken to have its joints' ordinary physics: then its equations are taken to be right."""
        exact = self.evidence.exact
        return CalibrationState.CALIBRATED if exact else CalibrationState.AS_BOUGHT

    @functools.cached_property
    def named(self) -> Bank:
        """Candidates that name a cause."""
        return Bank(tuple(c for c in self.candidates if c.named))

    @functools.cached_property
    def spread(self) -> Float[np.ndarray, "p p"]:
        """Covariance of the numbers by what tenths of the log say of each, scaled units."""
        return self.spread_with(np.zeros((*self.residual.y.shape, 0)))

    def spread_with(self, further: Float[np.ndarray, "R n k"]) -> Float[np.ndarray, "q q"]:
        """The same of the numbers and of those of `further` columns, whose prior standard deviation is one; q = p + k.

            C Σ_g s_g s_gᵀ C,    s_g = X_gᵀ A_g (y_g − X_g θ̂)

        C: their posterior covariance, X_g: columns of a tenth of the log. Rows may err together within a tenth: what
        the equations miss goes together over time. A_g = (1 − X_g C X_gᵀ)^−½ makes it C's own where they do not (Bell
        and McCaffrey, Survey Methodology 28(2), 2002); a jackknife is wider where one tenth says most of a number.
        """
        evidence, chosen = self.evidence, self.posterior.chosen
        root = np.sqrt(evidence.precision)
        group = np.arange(len(self.residual.y)) * GROUPS // len(self.residual.y)
        columns = evidence.design(chosen)
        columns = columns.reshape(*self.residual.y.shape, columns.shape[-1])
        columns = np.concatenate([columns, root[..., None] * further], axis=-1)
        y, count = root * evidence.y, columns.shape[-1]
        grams, along = zip(
            *(_normal(columns[group == g], y[group == g]) for g in range(GROUPS)), strict=True
        )
        whole = np.sum(along, axis=0)
        whole[: count - further.shape[-1]] += prior_mean(chosen)
        covariance = np.linalg.inv(np.eye(count) + np.sum(grams, axis=0))
        mean = covariance @ whole
        scores = [_unbiased(g, a - g @ mean, covariance) for g, a in zip(grams, along, strict=True)]
        moved = np.array(scores) @ covariance
        return moved.T @ moved

    def robust_worth(self, h: Hypothesis) -> float:
        """Log evidence that a hypothesis brings where parts of the log disagree about it, prior odds apart, nats.

        Their spread is in the covariance of what the log says of the numbers: rows err together where
        equations are not exact. Of a calibrated model they are, so that spread is the posterior's own, and counts where
        it is larger.
        """
        part = self.posterior.part(h)
        own, spread = self.posterior.covariance[part, part], self.spread[part, part]
        wide = _larger(own, spread) if self.evidence.exact else own + spread
        return bayes_factor(h, self.posterior.mean[part], own, wide)

    def further(
        self, barred: Collection[tuple[str, str, str]]
    ) -> Iterator[tuple[float, Hypothesis, Posterior]]:
        """What else may be there, each family and place once: log odds that it is [nats], and the posterior with it.

        At its best numbers where a robot can have them, none whose odds come near to nothing or whose key is `barred`:
        of an effect that is as large as the noise the evidence says neither that it is there nor that it is not.
        """
        chosen, residual, evidence = self.posterior.chosen, self.residual, self.evidence
        gains = evidence.gains(self.posterior, self.named)
        likeliest: dict[tuple[str, str, str], tuple[float, Hypothesis]] = {}
        for c, gain in zip(self.named.candidates, gains - self.named.odds, strict=True):
            at = likeliest.get(c.key, (UNLIKELY, c))[0]
            if c.key in barred or not np.isfinite(gain) or gain <= at:
                continue
            # Another law of what is chosen is not one more.
            if not excluded(residual, c, chosen):
                likeliest[c.key] = float(gain), c
        for gain, c in likeliest.values():
            with_it = relinearised(residual, evidence, (*chosen, c))
            c = with_it.chosen[-1]
            if not c.possible(residual, with_it.of(c)[0]):
                continue
            if c.effect.secant:
                gain = float(evidence.gains(self.posterior, (c,))[0]) - c.odds
            gain -= sensor_noise.share(residual, evidence, self.posterior, c)
            if gain > UNLIKELY:
                yield gain, c, with_it

    @property
    def ordinary(self) -> tuple[Hypothesis, ...]:
        """Of every joint."""
        return tuple(h for h in self.posterior.chosen if h.ordinary)

    @property
    def odd(self) -> tuple[Hypothesis, ...]:
        """Beyond the ordinary, generic alternatives included."""
        return tuple(h for h in self.posterior.chosen if h.is_odd)


def _normal(
    columns: Float[np.ndarray, "t n q"], y: Float[np.ndarray, "t n"]
) -> tuple[Float[np.ndarray, "q q"], Float[np.ndarray, " q"]]:
    """XᵀX and Xᵀy of some rows."""
    x = columns.reshape(y.size, columns.shape[-1])
    return x.T @ x, x.T @ y.ravel()


SEEN = 1e-12
"""Of a part's largest eigenvalue, below which it says nothing of a direction."""


def _unbiased(
    gram: Float[np.ndarray, "q q"],
    score: Float[np.ndarray, " q"],
    covariance: Float[np.ndarray, "q q"],
) -> Float[np.ndarray, " q"]:
    """A part's score, as large as it was before its rows were fitted: Xᵀ (1 − X C Xᵀ)^−½ e of G = XᵀX and Xᵀe."""
    energy, axes = linalg.eigh(gram)
    seen = energy > SEEN * max(float(energy.max(initial=0.0)), 1e-300)
    root = axes[:, seen] * np.sqrt(energy[seen])
    share, turn = linalg.eigh(root.T @ covariance @ root)
    own = turn.T @ (axes[:, seen].T @ score / np.sqrt(energy[seen]))
    return root @ (turn @ (own / np.sqrt(np.maximum(1.0 - share, SEEN))))


def _larger(a: Float[np.ndarray, "k k"], b: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """The larger of two covariances along each axis on which both are diagonal."""
    shares, axes = linalg.eigh(b, a)
    back = a @ axes
    return (back * np.maximum(shares, 1.0)) @ back.T


def bayes_factor(
    h: Hypothesis,
    mean: Float[np.ndarray, " k"],
    covariance: Float[np.ndarray, "k k"],
    wide: Float[np.ndarray, "k k"],
) -> float:
    """ln of the odds that a log brings for a hypothesis if it says z = θ / scale no better than by `wide`, nats.

    With posterior C and mean m, the log alone says ẑ = L (C⁻¹ m − μ) ± L, L = (C⁻¹ − 1)⁻¹; with V = L + `wide` − C,

        ln N(ẑ; μ, V + 1) − ln N(ẑ; 0, V),

    which is Savage–Dickey's ratio where V is L.
    """
    prior = h.prior_mean
    information = np.linalg.inv(covariance)
    alone = np.linalg.inv(information - (1.0 - SAID) * np.eye(len(mean)))
    said = alone @ (information @ mean - prior)
    v = alone + wide - covariance
    both = v + np.eye(len(v))
    away = said - prior
    quadratic = said @ np.linalg.solve(v, said) - away @ np.linalg.solve(both, away)
    return float(0.5 * (quadratic + np.linalg.slogdet(v)[1] - np.linalg.slogdet(both)[1]))
