"""The span of the model's tolerances, and columns that need not be charged anew when their scales change.

In the metric M = (1 + N Λ² Nᵀ)⁻¹ only what columns have in the span of N depends on the scales Λ. With an orthonormal
basis B of that span and M^{1/2} = 1 + B (C − 1) Bᵀ, the coordinates U = Bᵀ X are all that a change of scales concerns:

    M^{1/2} X = X + B A,    (M^{1/2} X)ᵀ M^{1/2} X = Xᵀ X + (U + A)ᵀ (U + A) − Uᵀ U,    A = (C − 1) U
"""

import dataclasses

import numpy as np
import scipy.linalg
import scipy.sparse
from jaxtyping import Float

# A column is over where it is below this share of its peak.
OVER = 1e-9


class Brief:
    """Many columns N, each over in a moment, and M^{1/2} = 1 − N K Nᵀ for M = (1 + N Nᵀ)⁻¹ without their span.

    A basis of it would spread each moment over the whole log, and take the time of as many columns that never end.
    """

    def __init__(self, n: Float[np.ndarray, "n k"]):
        columns = scipy.sparse.csr_array(np.where(np.abs(n) > OVER * np.abs(n).max(0), n, 0.0))
        self._columns, self._transposed = columns, columns.T.tocsr()
        values, vectors = scipy.linalg.eigh((self._transposed @ columns).toarray())
        root = np.sqrt(1.0 + np.maximum(values, 0.0))
        self._inside = (vectors / (root * (1.0 + root))) @ vectors.T

    def along(self, x: Float[np.ndarray, "n *l"]) -> Float[np.ndarray, "k *l"]:
        """Nᵀ x."""
        return self._transposed @ x

    def charge(self, x: Float[np.ndarray, "n *l"]) -> Float[np.ndarray, "n *l"]:
        """M^{1/2} x."""
        return x - self._columns @ (self._inside @ self.along(x))


class Span:
    """The span of few columns N, and maps that act in it and leave alone what is orthogonal to it."""

    def __init__(self, n: Float[np.ndarray, "n k"]):
        self.gram = n.T @ n
        values, vectors = scipy.linalg.eigh(self.gram)
        kept = values > 1e-12 * max(values[-1], 1e-300)
        size = np.sqrt(values[kept])
        # Column by column: products with a few vectors take two thirds of the time.
        self.basis = np.asfortranarray(n @ (vectors[:, kept] / size))
        self._coordinates = size[:, None] * vectors[:, kept].T

    def along(self, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " k"]:
        """Nᵀ x."""
        return self._coordinates.T @ (self.basis.T @ x)

    def charging(self, scales: Float[np.ndarray, " k"] | float = 1.0) -> Float[np.ndarray, "s s"]:
        """C: M^{1/2} in the span, for M = (1 + N Λ² Nᵀ)⁻¹ with scales Λ."""
        scaled = self._coordinates * scales
        values, vectors = scipy.linalg.eigh(scaled @ scaled.T)
        return (vectors / np.sqrt(1.0 + np.maximum(values, 0.0))) @ vectors.T

    def apply(
        self, inside: Float[np.ndarray, "s s"], x: Float[np.ndarray, "n k"]
    ) -> Float[np.ndarray, "n k"]:
        """x, its part in the span mapped."""
        part = self.basis.T @ x
        return x + self.basis @ (inside @ part - part)

    def split(self, x: Float[np.ndarray, "n k"]) -> "Split":
        """x, and its coordinates in the span."""
        return Split(x, self.basis.T @ x)


@dataclasses.dataclass(frozen=True)
class Split:
    """Columns before the tolerances charge them, and what of them lies in the tolerances' span."""

    columns: Float[np.ndarray, "n k"]
    inside: Float[np.ndarray, "s k"]

    def minus(self, other: "Split") -> "Split":
        """The difference of columns alike."""
        return Split(self.columns - other.columns, self.inside - other.inside)

    def parts(self, sizes: list[int]) -> list["Split"]:
        """Columns that lie side by side, each part in memory of its own: views would be read with their neighbours."""
        ends = np.cumsum(sizes)[:-1]
        both = (np.split(x, ends, axis=1) for x in (self.columns, self.inside))
        return [
            Split(np.asfortranarray(x), np.asfortranarray(u)) for x, u in zip(*both, strict=True)
        ]
