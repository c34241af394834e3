"""Innovation gates: which measurements the filter believes."""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.stats
from jaxtyping import Array, Float

from jax_inertia.maths.argument_checks import require


class Gate(eqx.Module):
    """Innovation gate: a measurement is used if νᵀ S⁻¹ ν ≤ γ (Foster et al., sec. IV-B)."""

    @abc.abstractmethod
    def threshold(self, rows: Float[Array, ""]) -> Float[Array, ""]:
        """γ for a measurement of so many rows."""


class FixedGate(Gate):
    """One γ for every measurement, as the paper tuned it; infinite: no gate."""

    gamma: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=jnp.inf)

    def __check_init__(self) -> None:
        require("gamma", self.gamma, lambda x: x > 0, "positive, or infinite for no gate")

    def threshold(self, rows: Float[Array, ""]) -> Float[Array, ""]:
        return jnp.asarray(self.gamma, rows.dtype)


class ChiSquaredGate(Gate):
    """γ such that a consistent filter keeps a measurement with the given probability, whatever its row count."""

    table: Float[Array, " rows"]

    def __init__(self, probability: float, max_rows: int):
        """`probability` of keeping a good measurement, in (0, 1), of at most `max_rows`; ValueError otherwise."""
        if not 0 < probability < 1:
            raise ValueError(f"gate probability is {probability}; it must lie between 0 and 1")
        if not isinstance(max_rows, int | np.integer) or max_rows < 1:
            raise ValueError(f"max_rows is {max_rows!r}; it must be a whole number, at least one")
        quantiles = scipy.stats.chi2.ppf(probability, np.arange(1, max_rows + 1))
        self.table = jnp.asarray(np.concatenate([[np.inf], quantiles]))

    @property
    def max_rows(self) -> int:
        """Of the measurements that it has a γ for."""
        return self.table.shape[-1] - 1

    def threshold(self, rows: Float[Array, ""]) -> Float[Array, ""]:
        return jnp.asarray(self.table, rows.dtype)[rows.astype(int)]
