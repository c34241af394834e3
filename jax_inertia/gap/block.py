"""One shape's columns, and what is left to explain beside the effects that are chosen.

Scales of the model's tolerances are tried many times and candidates are many, so columns are kept as they are before
the tolerances charge them, and products of charged columns are had from that (`span`).
"""

import dataclasses
import functools

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Shape
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.loudness import Loudness
from jax_inertia.gap.span import Split


@dataclasses.dataclass(frozen=True)
class Plain:
    """Columns before the tolerances charge them, and what is worked out of them once for all scales."""

    evidence: Evidence
    """Of this log, whatever its scales."""
    split: Split

    @property
    def columns(self) -> Float[np.ndarray, "n k"]:
        """X."""
        return self.split.columns

    @functools.cached_property
    def gram(self) -> Float[np.ndarray, "k k"]:
        """XᵀX."""
        return self.columns.T @ self.columns

    @functools.cached_property
    def slow(self) -> Float[np.ndarray, "m k"]:
        """X in the motion's own band."""
        return self.evidence.slow(self.columns)


@dataclasses.dataclass(frozen=True)
class Carried:
    """The sensors' noise w that columns carry, by its products: they are all that a fit needs, and small."""

    gram: Float[np.ndarray, "k k"]
    """wᵀw, before the tolerances charge it."""
    cross: Float[np.ndarray, "k 1"]
    """wᵀn, with the noise n of y."""
    inside: Float[np.ndarray, "s k"]
    """w in the tolerances' span."""
    of_y: Float[np.ndarray, "s 1"]
    """n there."""

    @classmethod
    def of(cls, w: Split, n: Split) -> "Carried":
        """Of both noises."""
        return cls(w.columns.T @ w.columns, w.columns.T @ n.columns, w.inside, n.inside)


@dataclasses.dataclass(frozen=True)
class Block:
    """Columns of one shape in the charged metric, and what noise alone puts into their moments."""

    evidence: Evidence
    shape: Shape
    plain: Plain
    noise: Carried | None = None
    """What the echo's noise adds to the columns, where they carry it."""

    def charged_as(self, evidence: Evidence) -> "Block":
        """The same columns where the model's tolerances are larger, smaller or fewer."""
        return Block(evidence, self.shape, self.plain, self.noise)

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.plain.columns.shape[1]

    @functools.cached_property
    def _added(self) -> Float[np.ndarray, "s k"]:
        return self.evidence.added(self.plain.split.inside)

    @functools.cached_property
    def columns(self) -> Float[np.ndarray, "n k"]:
        """A."""
        return self.plain.columns + self.evidence.basis @ self._added

    @functools.cached_property
    def gram(self) -> Float[np.ndarray, "k k"]:
        """AᵀA."""
        inside = self.plain.split.inside
        return self.evidence.charged_product(self.plain.gram, inside, inside)

    def noise_beside(self, loudness: Loudness | None, weights: Float[np.ndarray, " k"]) -> float:
        """Misfit of one sample that counts as noise beside the columns' sum with these weights.

        What is known of an effect's numbers before any data weighs that much more.
        """
        if loudness is None:
            return 1.0
        if loudness.even:
            return loudness.whole
        return loudness.beside(self.evidence.by_row(self.plain.columns @ weights))

    @functools.cached_property
    def slow(self) -> Float[np.ndarray, "m k"]:
        """A in the motion's own band."""
        return self.plain.slow + self.evidence.slow_basis @ self._added

    @functools.cached_property
    def noise_gram(self) -> Float[np.ndarray, "k k"] | float:
        """wᵀw."""
        if self.noise is None:
            return 0.0
        w = self.noise
        return self.evidence.charged_product(w.gram, w.inside, w.inside)

    @functools.cached_property
    def noise_cross(self) -> Float[np.ndarray, " k"] | float:
        """wᵀn."""
        if self.noise is None:
            return 0.0
        w = self.noise
        return self.evidence.charged_product(w.cross, w.inside, w.of_y)[:, 0]


# Columns of which the chosen effects leave less than this share of the energy are theirs.
REACHED = 1e-10
# Columns alike but for this share of their energy are one.
TIED = 1e-9


@dataclasses.dataclass(frozen=True)
class Moments:
    """What fits need of a block's free columns A: zero for columns that are not free."""

    block: Block
    shared: Float[np.ndarray, "s k"]
    """What the chosen can reach of the columns, in their basis."""
    gram: Float[np.ndarray, "k k"]
    """AᵀA."""
    cross: Float[np.ndarray, " k"]
    """Aᵀy."""


@dataclasses.dataclass(frozen=True)
class Beside:
    """What is left to explain where the columns of chosen effects are free to take their share."""

    evidence: Evidence
    basis: Float[np.ndarray, "n s"]
    """Of the chosen columns, orthonormal."""
    target: Float[np.ndarray, " n"]
    """What they cannot reach."""
    loudness: Loudness | None = None
    """Of what is left once this is explained too; none where it is as loud as noise."""

    @functools.cached_property
    def _known(self) -> dict[int, Moments]:
        # By the block's id, which is its own as long as its moments hold it.
        return {}

    @functools.cached_property
    def _twice(self) -> Float[np.ndarray, "n c"]:
        """Basis and target charged once more, for products with columns that are not charged."""
        return self.evidence.charge_own(np.column_stack([self.basis, self.target]))

    @classmethod
    def of(
        cls,
        evidence: Evidence,
        columns: Float[np.ndarray, "n s"],
        target: Float[np.ndarray, " n"],
        loudness: Loudness | None = None,
    ) -> "Beside":
        """Beside chosen columns, of a target in the charged metric."""
        basis = np.linalg.qr(columns)[0] if columns.shape[1] else columns
        return cls(evidence, basis, target - basis @ (basis.T @ target), loudness)

    def free(self, columns: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        """What the chosen cannot reach of other columns."""
        if not self.basis.shape[1]:
            return columns
        return columns - self.basis @ (self.basis.T @ columns)

    def moments(self, block: Block) -> Moments:
        """Of a block's free columns; worked out once, since families may share a block."""
        if id(block) not in self._known:
            both = self._twice.T @ block.plain.columns
            shared, cross = both[:-1], both[-1]
            gram = block.gram - shared.T @ shared
            alive = np.diagonal(gram) > REACHED * np.diagonal(block.gram)
            self._known[id(block)] = Moments(
                block, shared, gram * np.outer(alive, alive), cross * alive
            )
        return self._known[id(block)]

    def most(self, block: Block) -> float:
        """What a block's columns explain with any weights, Aᵀy (AᵀA)⁺ Aᵀy: no effect of theirs explains more."""
        moments = self.moments(block)
        gram, cross = moments.gram, moments.cross
        if len(cross) == 1:
            return float(cross[0] ** 2 / gram[0, 0]) if gram[0, 0] > 0.0 else 0.0
        scale = np.sqrt(np.maximum(np.diagonal(gram), 1e-300))
        unit = gram / np.outer(scale, scale) + TIED * np.eye(len(cross))
        x = cross / scale
        return float(x @ np.linalg.solve(unit, x))

    def slow_moments(self, block: Block) -> tuple[np.ndarray, np.ndarray]:
        """AᵀA and Aᵀy of a block's free columns A in the motion's own band."""
        seen, shared = block.slow, self.moments(block).shared
        if len(shared):
            seen = seen - self._slow_basis @ shared
        return seen.T @ seen, seen.T @ self._slow_target

    @functools.cached_property
    def _slow_basis(self) -> Float[np.ndarray, "m s"]:
        return self.evidence.slow(self.basis)

    @functools.cached_property
    def _slow_target(self) -> Float[np.ndarray, " m"]:
        return self.evidence.slow(self.target[:, None])[:, 0]
