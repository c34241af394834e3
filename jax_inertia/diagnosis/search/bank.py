"""Many candidates side by side in memory: their gains of log evidence cost a few matrix products."""

import dataclasses
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from jax_inertia.diagnosis.hypothesis import Hypothesis


@dataclasses.dataclass(frozen=True, eq=False)
class Seen:
    """What a residual and the hypotheses that are chosen say of m candidates of k numbers each.

    A: the candidate's columns and X those of the chosen, both times the square root of the precision; C and z̄ the
    chosen ones' posterior covariance and mean.
    """

    at: Int[np.ndarray, " m"]
    """Which candidates."""
    prior_mean: Float[np.ndarray, "m k"]
    along: Float[np.ndarray, "m k"]
    """Aᵀ(y − X z̄)."""
    s: Float[np.ndarray, "m k k"]
    """1 + AᵀA − AᵀX C XᵀA."""
    explained: Float[np.ndarray, "p m k"]
    """C XᵀA."""

    def without(
        self,
        gone: Int[np.ndarray, " g"],
        mean: Float[np.ndarray, " p"],
        covariance: Float[np.ndarray, "p p"],
    ) -> "Seen":
        """The same had some numbers of the chosen been zero: C and z̄ are those given that (`Posterior.without`)."""
        u = self.explained[gone]
        away = np.linalg.inv(covariance[np.ix_(gone, gone)])
        along = self.along + np.einsum("gmk,g->mk", u, away @ mean[gone])
        s = self.s + np.einsum("gmk,gml->mkl", u, np.tensordot(away, u, 1))
        return dataclasses.replace(self, along=along, s=s)

    def gains(self) -> Float[np.ndarray, " m"]:
        """½ (r + μ)ᵀ S⁻¹ (r + μ) − ½ μᵀμ − ½ ln |S| of each, r = `along`, S = `s`, μ its prior mean, nats."""
        out = np.full(len(self.at), -np.inf)
        sign, logdet = np.linalg.slogdet(self.s)
        good = sign > 0
        told = self.along[good] + self.prior_mean[good]
        solved = np.linalg.solve(self.s[good], told[..., None])[..., 0]
        prior = np.sum(self.prior_mean[good] ** 2, axis=1)
        out[good] = 0.5 * (np.sum(told * solved, axis=1) - prior - logdet[good])
        return out


class Bank:
    """Columns of candidates, per prior standard deviation, by the rows that they act on and by how many they have."""

    def __init__(self, candidates: Sequence[Hypothesis]):
        self.candidates = tuple(candidates)
        members: dict[tuple[tuple[int, ...], int], list[int]] = defaultdict(list)
        for i, h in enumerate(self.candidates):
            members[h.rows, h.count].append(i)
        self._blocks = [
            (
                np.array(rows, int),
                count,
                np.array(at),
                np.stack([self.candidates[i].on_rows for i in at], axis=-2),
                np.stack([self.candidates[i].prior_mean for i in at]),
            )
            for (rows, count), at in members.items()
        ]
        self.odds = np.array([h.odds for h in self.candidates])
        """Prior log odds against each, nats."""

    def __len__(self) -> int:
        return len(self.candidates)

    def seen(
        self,
        root: Float[np.ndarray, "R n"],
        base: Float[np.ndarray, "R n p"],
        left: Float[np.ndarray, "R n"],
        covariance: Float[np.ndarray, "p p"],
    ) -> list[Seen]:
        """Of all: `base` the columns of the chosen and `left` the residual, both times `root`, √precision."""
        return [self._seen(*block, root, base, left, covariance) for block in self._blocks]

    def _seen(self, rows, count, at, columns, prior_mean, root, base, left, covariance) -> Seen:
        live = root[:, rows].any(axis=0)
        if not live.all():
            rows, columns = rows[live], columns[:, live]
        own = (columns * root[:, rows, None, None]).reshape(-1, len(at) * count)
        # An effect that this motion does not excite has no rows.
        x, rest = base[:, rows].reshape(len(own), base.shape[2]), left[:, rows].ravel()
        cross = x.T @ own
        explained = (covariance @ cross).reshape(len(covariance), len(at), count)
        cross = cross.reshape(explained.shape)
        along = (own.T @ rest).reshape(len(at), count)
        own = own.reshape(-1, len(at), count)
        s = np.eye(count) + np.einsum("rmk,rml->mkl", own, own)
        s -= np.einsum("pmk,pml->mkl", cross, explained)
        return Seen(at, prior_mean, along, s, explained)
