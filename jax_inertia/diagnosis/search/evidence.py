"""The one score: log evidence of a linear-Gaussian model of the torque residual, with every number marginalised.

    y = Σₖ Aₖ θₖ + N z + ε,    θₖ ~ N(sₖ μₖ, diag sₖ²),   z ~ N(0, 1)

ε is sensor noise and a slow discrepancy: its rows have a variance, and count for as many as are independent of each
other (`discrepancy`). Their weights stay those of white noise: the discrepancy's own inverse covariance would trust the
residual's increments, where models err most, before its level.

y: torque residual of all rows [N m]; Aₖ: columns of effect k; N: one column per tolerance of the nominal model, scaled
to its standard deviation; μ: zero, but for effects that are all there or not at all. Add and delete of a group have
closed forms (Tipping and Faul 2003, fast marginal likelihood; deletion by the Savage–Dickey ratio, Dickey 1971).
Columns here are scaled by their prior standard deviation.
"""

import copy
import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import linalg

from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.search.bank import Bank, Seen
from jax_inertia.diagnosis.search.discrepancy import SlowNoise

MOST_REPEATED = 3.0
"""Rows that count as one while hypotheses are searched: friction's own misfit on sound logs goes together for less, and
what does for longer may be an effect that is not yet chosen."""


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
    """ln p(y), every number marginalised, of as many rows as are independent; up to a constant of the log [nats]."""

    def part(self, h: Hypothesis) -> slice:
        """Where one hypothesis' numbers stand among all."""
        return self.slices[self.chosen.index(h)]

    def of(self, h: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
        """(mean (k,), covariance (k, k)) of one hypothesis in its own units."""
        part = self.part(h)
        return self.mean[part] * h.scale, self.covariance[part, part] * np.outer(h.scale, h.scale)

    def torque(self, h: Hypothesis) -> Float[np.ndarray, "R n"]:
        """Torque of one hypothesis at its posterior mean [N m]."""
        return h.torque(self.mean[self.part(h)], self.fitted.shape)

    def given(self, at: Int[np.ndarray, " a"], values: Float[np.ndarray, " a"]) -> "Posterior":
        """The same with its mean at its likeliest where some numbers have these values, in units of their scales.

        θ̄ + C[:, a] C[a, a]⁻¹ (v − θ̄[a]), the conditional mean of a Gaussian; how uncertain all are is left as it is.
        """
        if not len(at):
            return self
        own = self.covariance[np.ix_(at, at)]
        mean = self.mean + self.covariance[:, at] @ np.linalg.solve(own, values - self.mean[at])
        mean[at] = values
        fitted = _torque(self.chosen, self.slices, mean, self.fitted.shape)
        return dataclasses.replace(self, mean=mean, fitted=fitted)

    def without(self, gone: Hypothesis) -> "Posterior":
        """The posterior had one not been chosen, the noise being the same: that given that its numbers are zero."""
        b = self.part(gone)
        kept = np.delete(np.arange(len(self.mean)), b)
        gain = np.linalg.solve(self.covariance[b, b], self.covariance[b, kept]).T
        mean = self.mean[kept] - gain @ self.mean[b]
        covariance = self.covariance[np.ix_(kept, kept)] - gain @ self.covariance[b, kept]
        chosen = tuple(h for h in self.chosen if h is not gone)
        slices = _slices(chosen)
        fitted = _torque(chosen, slices, mean, self.fitted.shape)
        left = self.log_evidence - worth(gone, self.mean[b], self.covariance[b, b])
        return Posterior(chosen, slices, mean, covariance, fitted, left)


def _slices(chosen: Sequence[Hypothesis]) -> tuple[slice, ...]:
    """Where each hypothesis' numbers stand among all."""
    ends = np.cumsum([h.count for h in chosen])
    return tuple(slice(int(e) - h.count, int(e)) for e, h in zip(ends, chosen, strict=True))


def _torque(
    chosen: Sequence[Hypothesis],
    slices: Sequence[slice],
    mean: Float[np.ndarray, " p"],
    shape: tuple[int, int],
) -> Float[np.ndarray, "R n"]:
    """Torque of several hypotheses together [N m]."""
    out = np.zeros(shape)
    for h, part in zip(chosen, slices, strict=True):
        out += h.torque(mean[part], shape)
    return out


def form_variance(now: Posterior) -> Float[np.ndarray, "R n"]:
    """Variance of each row that errors of the chosen effects' own equations leave [N² m²]."""
    form = np.zeros_like(now.fitted)
    for h in now.chosen:
        if h.form_error:
            form += (h.form_error * now.torque(h)) ** 2
    return form


@dataclasses.dataclass(frozen=True, eq=False)
class Noise:
    """Variance of every row, and what is slow of it."""

    variance: Float[np.ndarray, "R n"]
    slow: tuple[SlowNoise, ...]
    most_repeated: float = MOST_REPEATED

    @property
    def repeated(self) -> Float[np.ndarray, " n"]:
        """How many neighbours say the same."""
        return np.minimum([s.repeated for s in self.slow], self.most_repeated)


class Normal(NamedTuple):
    """Normal equations of some hypotheses under one noise, their priors apart."""

    y: Float[np.ndarray, "R n"]
    root: Float[np.ndarray, "R n"]
    """√precision."""
    chosen: tuple[Hypothesis, ...]
    slices: tuple[slice, ...]
    gram: Float[np.ndarray, "p p"]
    along: Float[np.ndarray, " p"]


class Evidence:
    """Residual rows with their weights; judges sets of hypotheses."""

    def __init__(
        self,
        y: Float[np.ndarray, "R n"],
        weight: Float[np.ndarray, "R n"],
        sensors: Float[np.ndarray, " n"],
        *,
        least: float = 0.0,
        exact: bool = False,
    ):
        self.y, self.weight, self.sensors = y, weight, sensors
        self.exact = exact
        """Whether equations are taken to be right, as those of a calibrated model are."""
        count = np.maximum(weight.sum(axis=0), 1.0)
        self.count = count
        self.gap = np.sqrt((weight * y**2).sum(axis=0) / count)
        """Root mean square of each row's torque residual [N m]."""
        self.least = least * self.gap
        """Least residual standard deviation of a row, whatever leaves it [N m]."""
        variance = np.maximum((0.2 * self.gap) ** 2, sensors**2) * np.ones_like(y)
        self.noise = Noise(variance, tuple(SlowNoise(w) for w in weight.T))
        self._latest: Normal | None = None
        self._base: tuple[Posterior, Noise, np.ndarray] | None = None
        self._seen: tuple[Posterior, Noise, Bank, list[Seen], np.ndarray] | None = None

    def design(self, chosen: tuple[Hypothesis, ...]) -> Float[np.ndarray, "Rn p"]:
        """Weighted columns of the chosen, per prior standard deviation."""
        return scaled(chosen, np.sqrt(self.precision))

    def without(self, part: Bool[np.ndarray, "R n"]) -> "Evidence":
        """The same with some rows left out, variances kept."""
        out = copy.copy(self)
        out.weight = np.where(part, 0.0, self.weight)
        out._latest, out._base, out._seen = None, None, None
        return out

    def remembering(self, now: Posterior) -> "Evidence":
        """The same, its noise learned once more with rows that count for no more than their whole memory lets them."""
        out = copy.copy(self)
        out.noise = dataclasses.replace(self.noise, most_repeated=np.inf)
        out.learn(now)
        return out

    @property
    def precision(self) -> Float[np.ndarray, "R n"]:
        """Inverse variance of each row, divided by how many neighbours say the same."""
        return self.weight / (self.noise.variance * self.noise.repeated)

    def posterior(self, chosen: tuple[Hypothesis, ...]) -> Posterior:
        """Given the present noise."""
        root, prior, slices = np.sqrt(self.precision), prior_mean(chosen), _slices(chosen)
        y = root * self.y
        gram, along = self._normal(chosen, slices, root, y)
        gram, along = gram + np.eye(len(prior)), along + prior
        factor = linalg.cho_factor(gram, lower=True)
        mean = linalg.cho_solve(factor, along)
        covariance = inverse(factor[0])
        fitted = _torque(chosen, slices, mean, self.y.shape)
        logdet = float(np.sum(self.weight / self.noise.repeated * np.log(self.noise.variance)))
        logdet += 2.0 * float(np.log(np.diag(factor[0])).sum())
        log_evidence = -0.5 * (logdet + float(np.sum(y**2) + prior @ prior - along @ mean))
        return Posterior(chosen, slices, mean, covariance, fitted, log_evidence)

    def _normal(
        self,
        chosen: tuple[Hypothesis, ...],
        slices: tuple[slice, ...],
        root: Float[np.ndarray, "R n"],
        y: Float[np.ndarray, "R n"],
    ) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, " p"]]:
        """(AᵀA, Aᵀy) of weighted columns and residual; what the latest call shares with this one is not made again."""
        gram, along = (np.zeros((sum(h.count for h in chosen),) * n) for n in (2, 1))
        last, there = self._latest, {}
        if last is not None and last.y is self.y and np.array_equal(last.root, root):
            there = {id(h): s for h, s in zip(last.chosen, last.slices, strict=True)}
        old = [(s, there[id(h)]) for h, s in zip(chosen, slices, strict=True) if id(h) in there]
        if last is not None and old:
            here, before = (
                np.concatenate([np.arange(s.start, s.stop) for s in x])
                for x in zip(*old, strict=True)
            )
            gram[np.ix_(here, here)] = last.gram[np.ix_(before, before)]
            along[here] = last.along[before]
        new = [(h, s) for h, s in zip(chosen, slices, strict=True) if id(h) not in there]
        # Row by row: most hypotheses act on one, and say nothing of those on another.
        for j in np.flatnonzero(root.any(axis=0)).tolist():
            fresh = [(h, s) for h, s in new if j in h.rows]
            if not fresh:
                continue
            every = [(h, s) for h, s in zip(chosen, slices, strict=True) if j in h.rows]
            at, beside = (
                np.concatenate([np.arange(s.start, s.stop) for _, s in x]) for x in (fresh, every)
            )
            b = np.concatenate([h.on_row(j) for h, _ in every], axis=1) * root[:, j, None]
            # Of an array with itself NumPy computes one half.
            a = b if len(at) == len(beside) else b[:, np.isin(beside, at)]
            gram[np.ix_(at, beside)] += a.T @ b
            along[at] += a.T @ y[:, j]
        for _, s in new:
            gram[:, s] = gram[s].T
        self._latest = Normal(self.y, root, chosen, slices, gram, along)
        return gram, along

    def nothing(self) -> Posterior:
        """The posterior of no hypothesis at all."""
        none = np.zeros(0)
        return Posterior((), (), none, np.zeros((0, 0)), np.zeros_like(self.y))

    def learn(self, now: Posterior, *, memory: bool = True) -> None:
        """Noise of each row from what the chosen leave, and from how exact their own equations are.

            V_jt = max(σ_j² + λ_j Σₖ fₖ² eₖ(t)², least_j²)

        σ_j: residual rms of the row, degrees of freedom taken off, the sensors' noise at least; fₖ: relative error of
        effect k's equation, and λ_j ≤ 1, by which those of a row are smaller where more would be more than its whole
        residual, but of a calibrated model, whose equations' errors are as stated. As bought, a robot has misfit of its
        own on top of those errors, `least` included. With
        `memory`, how much of it is slow is learned too; without, two hypotheses can be compared before and after.
        """
        left = self.y - now.fitted
        free = sum(h.count for h in now.chosen if h.named) / left.shape[1]
        count = np.maximum(self.count - free, 0.25 * self.count)
        form = form_variance(now)
        energy = (self.weight * left**2).sum(axis=0) / count
        excused = (self.weight * form).sum(axis=0) / np.maximum(self.count, 1.0)
        least = self.sensors if self.exact else np.maximum(self.sensors, self.least)
        own = np.maximum(np.maximum(energy - excused, 0.1 * energy), least**2)
        shown = (
            1.0 if self.exact else np.clip((energy - own) / np.maximum(excused, 1e-300), 0.0, 1.0)
        )
        variance, slow = np.maximum(own + shown * form, self.least**2), self.noise.slow
        if memory:
            white = left / np.sqrt(variance)
            slow = tuple(s.likeliest(x) for s, x in zip(slow, white.T, strict=True))
        self.noise = dataclasses.replace(self.noise, variance=variance, slow=slow)

    def gains(
        self,
        now: Posterior,
        others: Bank | Sequence[Hypothesis],
        without: Sequence[Hypothesis] = (),
    ) -> Float[np.ndarray, " c"]:
        """Change of log evidence when one more is added, prior odds apart, nats; one for each of `others`.

        Had some of the chosen not been chosen: `without` them (`Posterior.without`).
        """
        bank = others if isinstance(others, Bank) else Bank(others)
        every, unsaid = self.seen_of(now, bank)
        if without:
            gone = np.concatenate([np.arange(len(now.mean))[now.part(h)] for h in without])
            every = [x.without(gone, now.mean, now.covariance) for x in every]
        out = np.empty(len(bank))
        for x in every:
            out[x.at] = x.gains()
        return out - unsaid

    def seen_of(self, now: Posterior, bank: Bank) -> tuple[list[Seen], Float[np.ndarray, " c"]]:
        """What is seen of a bank's candidates, and what each owes (`unsaid`); the latest is kept.

        One posterior is asked many times over: of one bank, or where numbers between a grid's points are searched.
        """
        if self._seen is not None and all(
            a is b for a, b in zip(self._seen, (now, self.noise, bank), strict=False)
        ):
            return self._seen[3:]
        root = np.sqrt(self.precision)
        if self._base is None or self._base[0] is not now or self._base[1] is not self.noise:
            base = self.design(now.chosen).reshape(*self.y.shape, len(now.mean))
            self._base = now, self.noise, base
        seen = bank.seen(root, self._base[2], root * (self.y - now.fitted), now.covariance)
        unsaid = np.array([self.unsaid(h) for h in bank.candidates])
        if len(bank) > 1:
            self._seen = now, self.noise, bank, seen, unsaid
        return seen, unsaid

    def unsaid(self, h: Hypothesis) -> float:
        """What a hypothesis owes for torques that it leaves open, nats: all that is logged has to be likely.

            Σ share max(ln (room / σ) + ½ ln (e / 2π), 0)

        A row that is cut off at L weighs as if its torque were known to σ, by a Gaussian of e = needed − L. It is only
        known to be beyond L: p(τ) = Φ(e / σ) / room (Tobin, Econometrica 26(1), 1958). Of e that is as large as the
        noise, ln of the one is −ln σ − ½ ln 2πe on average, of the other −1 − ln room.
        """
        if h.cut is None or h.row is None:
            return 0.0
        known = np.sqrt(2.0 * np.pi / np.e * self.noise.variance[:, h.row])
        each = np.log(np.maximum(h.cut.room / known, 1.0))
        rows = self.weight[:, h.row] / self.noise.repeated[h.row]
        return float(np.sum(rows * h.cut.share * each))

    def loss(self, now: Posterior, h: Hypothesis) -> float:
        """Log evidence lost without one of the chosen, nats: what no equation says may be slow and explain as much.

            Σⱼ max ln p(rⱼ | slow noise) − max ln p(rⱼ⁻ | slow noise) − ½ zᵀz + ½ ln |C|

        rⱼ, rⱼ⁻: residual of row j with it and without, everything else refitted, each by the discrepancy and the size
        under which it is likeliest (`SlowNoise`); z, C: its numbers' mean and covariance per prior standard deviation
        (Laplace). (`worths` asks the same of the noise that is there with it.)
        """
        rest, part = now.without(h), now.part(h)
        with_it, without = (self.y - p.fitted for p in (now, rest))
        gained = sum(
            SlowNoise(w).likelihood_at_best(a) - SlowNoise(w).likelihood_at_best(b)
            for w, a, b in zip(self.weight.T, with_it.T, without.T, strict=True)
        )
        away = now.mean[part] - h.prior_mean
        spread = np.linalg.slogdet(now.covariance[part, part])[1]
        return float(gained - 0.5 * away @ away + 0.5 * spread)

    def worths(self, now: Posterior) -> Float[np.ndarray, " k"]:
        """Log evidence that each of the chosen brings, prior odds apart, nats (Savage–Dickey)."""
        every = zip(now.chosen, now.slices, strict=True)
        return np.array(
            [worth(h, now.mean[p], now.covariance[p, p]) - self.unsaid(h) for h, p in every]
        )


def worth(
    h: Hypothesis, mean: Float[np.ndarray, " k"], covariance: Float[np.ndarray, "k k"]
) -> float:
    """ln p(z = 0) before the data less after, at posterior mean and covariance of z = θ / scale [nats]."""
    quadratic = mean @ np.linalg.solve(covariance, mean) - h.prior_mean @ h.prior_mean
    return float(0.5 * (quadratic + np.linalg.slogdet(covariance)[1]))


def inverse(factor: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """(L Lᵀ)⁻¹ of a lower Cholesky factor, by LAPACK's own: a third of what solving for the identity costs.

    >>> import numpy as np
    >>> inverse(np.array([[2.0, 0.0], [1.0, 1.0]]))
    array([[ 0.5, -0.5],
           [-0.5,  1. ]])
    """
    if not len(factor):
        return np.zeros((0, 0))
    (potri,) = linalg.get_lapack_funcs(("potri",), (factor,))
    lower, failed = potri(factor, lower=1)
    assert not failed
    return np.tril(lower) + np.tril(lower, -1).T


def prior_mean(chosen: Sequence[Hypothesis]) -> Float[np.ndarray, " p"]:
    """Prior mean of every number of the chosen, per prior standard deviation."""
    return np.concatenate([h.prior_mean for h in chosen]) if chosen else np.zeros(0)


def scaled(
    chosen: tuple[Hypothesis, ...], root: Float[np.ndarray, "R n"]
) -> Float[np.ndarray, "Rn p"]:
    """Columns of several hypotheses on all rows, times `root`, per prior standard deviation."""
    out = np.zeros((*root.shape, sum(h.count for h in chosen)))
    at, live = 0, np.flatnonzero(root.any(axis=0))
    for h in chosen:
        if h.row is None:
            out[:, live, at : at + h.count] = h.columns[:, live] * root[:, live, None] * h.scale
        else:
            out[:, h.row, at : at + h.count] = h.scaled * root[:, h.row, None]
        at += h.count
    return out.reshape(root.size, out.shape[-1])
