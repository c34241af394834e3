"""Many candidates side by side in memory: their gains of log evidence cost a few matrix products."""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.hypothesis import Hypothesis


class Bank:
    """Columns of candidates, per prior standard deviation, by the row that they act on and by how many they have."""

    def __init__(self, candidates: Sequence[Hypothesis]):
        self.candidates = tuple(candidates)
        members: dict[tuple[int | None, int], list[int]] = defaultdict(list)
        for i, h in enumerate(self.candidates):
            members[h.row, h.count].append(i)
        self._blocks = [
            (
                row,
                count,
                np.array(at),
                np.stack([self.candidates[i].scaled for i in at], axis=-2),
                np.stack([self.candidates[i].prior_mean for i in at]),
            )
            for (row, count), at in members.items()
        ]

    def __len__(self) -> int:
        return len(self.candidates)

    def gains(
        self,
        root: Float[np.ndarray, "R n"],
        base: Float[np.ndarray, "R n p"],
        left: Float[np.ndarray, "R n"],
        covariance: Float[np.ndarray, "p p"],
    ) -> Float[np.ndarray, " c"]:
        """½ (r + μ)ᵀ S⁻¹ (r + μ) − ½ μᵀμ − ½ ln |S| of each, nats.

        S = 1 + AᵀA − AᵀX C XᵀA, r = Aᵀ `left`: A the candidate's columns and X those of the chosen (`base`), both
        times `root`, the square root of the precision; μ its prior mean, C the chosen ones' posterior `covariance`.
        """
        out = np.full(len(self), -np.inf)
        for row, count, at, columns, prior_mean in self._blocks:
            if row is None:
                own = (columns * root[:, :, None, None]).reshape(-1, len(at) * count)
                x, rest = base.reshape(left.size, base.shape[-1]), left.ravel()
            else:
                own = (columns * root[:, row, None, None]).reshape(-1, len(at) * count)
                x, rest = base[:, row], left[:, row]
            cross = x.T @ own
            explained = (covariance @ cross).reshape(len(covariance), len(at), count)
            cross = cross.reshape(explained.shape)
            r = (own.T @ rest).reshape(len(at), count)
            own = own.reshape(-1, len(at), count)
            s = np.eye(count) + np.einsum("rmk,rml->mkl", own, own, optimize=True)
            s -= np.einsum("pmk,pml->mkl", cross, explained, optimize=True)
            sign, logdet = np.linalg.slogdet(s)
            good = sign > 0
            told, prior = r[good] + prior_mean[good], np.sum(prior_mean[good] ** 2, axis=1)
            solved = np.linalg.solve(s[good], told[..., None])[..., 0]
            out[at[good]] = 0.5 * (np.sum(told * solved, axis=1) - prior - logdet[good])
        return out
