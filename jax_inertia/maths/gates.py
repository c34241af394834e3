"""Innovation gates: which measurements the filter believes, and when it has to believe that the state is new."""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.stats
from jaxtyping import Array, ArrayLike, Bool, Float

from jax_inertia.maths.argument_checks import require


class Gate(eqx.Module):
    """Innovation gate: a measurement is used if νᵀ S⁻¹ ν ≤ γ (Foster et al., sec. IV-B)."""

    @abc.abstractmethod
    def threshold(self, rows: Float[Array, ""]) -> Float[Array, ""]:
        """γ for a measurement of so many rows."""


class FixedGate(Gate):
    """One γ for every measurement, as the paper tuned it; infinite: no gate."""

    gamma: Float[Array, ""]

    def __init__(self, gamma: ArrayLike = jnp.inf) -> None:
        self.gamma = jnp.asarray(gamma)

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


class Reopening(eqx.Module):
    """When measurements that contradict the state mean a new state: a gate alone would reject a true change for ever.

    One rule for every estimator. Impacts pass; where nothing but contradiction has come for `after` seconds, the state
    is what is wrong, and the estimator adds its prior's covariance to the belief's. A measurement that could not be
    tested, since no row of it was valid, says nothing: it neither agrees nor contradicts, and its time does not count.
    """

    after: Float[Array, ""]
    """[s]; infinite: never."""

    def due(self, doubted_for: Float[Array, ""]) -> Bool[Array, ""]:
        """Whether the state counts as new before the next measurement."""
        return doubted_for >= self.after

    def doubted_for(
        self,
        before: Float[Array, ""],
        dt: Float[Array, ""],
        *,
        tested: Bool[Array, ""],
        believed: Bool[Array, ""],
    ) -> Float[Array, ""]:
        """For how long [s] every tested measurement has contradicted the state, this one of `dt` [s] among them.

        >>> import jax.numpy as jnp
        >>> from jax_inertia.maths.gates import Reopening
        >>> rule, no, yes = Reopening(jnp.array(0.5)), jnp.array(False), jnp.array(True)
        >>> before, dt = jnp.array(0.4), jnp.array(0.1)
        >>> float(rule.doubted_for(before, dt, tested=yes, believed=no))
        0.5
        >>> round(float(rule.doubted_for(before, dt, tested=no, believed=no)), 3)
        0.4
        """
        waited = jnp.where(self.due(before), 0.0, before) + dt
        return jnp.where(tested, jnp.where(believed, 0.0, waited), before)
