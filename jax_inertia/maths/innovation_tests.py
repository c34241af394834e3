"""Is the filter's own account of its errors true? NIS, NEES and whiteness of the innovations (Bar-Shalom et al. 2001,
sec. 5.4).

For a consistent filter, NIS follows χ² with as many degrees of freedom as rows, NEES with as many as states, and the
normalised innovations are white with unit variance. Model errors break all three, and the report says which rows do.
"""

import equinox as eqx
import numpy as np
import scipy.stats
from jaxtyping import Array, Bool, Float

from jax_inertia.maths.kalman import Innovation


class Consistency(eqx.Module):
    """How a run's innovations compare with what the filter expected of them."""

    nis_per_row: float = eqx.field(static=True)
    """Mean NIS over rows used: 1 where the noise is what was stated, above where it is larger."""
    nis_interval: tuple[float, float] = eqx.field(static=True)
    """Where a consistent filter's `nis_per_row` lies with 95 % probability, samples independent."""
    within_95: float = eqx.field(static=True)
    """Share of samples whose NIS is below the 95 % quantile."""
    row_variance: Float[np.ndarray, " m"]
    """Variance of each row's normalised innovation; NaN where a row was never used."""
    row_correlation: Float[np.ndarray, " m"]
    """Correlation of each row's innovation with the one before."""
    row_white: Bool[np.ndarray, " m"]
    """Whether Ljung and Box's test over ten lags accepts the row as white, at 1 %."""
    rejected: float = eqx.field(static=True)
    """Share of tested samples (with a row that the bodies move) that the gate or a non-finite update rejected."""

    def __repr__(self) -> str:
        low, high = self.nis_interval
        return (
            f"Consistency(NIS per row {self.nis_per_row:.3g} (expected {low:.3g} to {high:.3g}), "
            f"{100 * self.within_95:.1f} % within 95 %, {100 * self.rejected:.2f} % rejected, "
            f"{int(self.row_white.sum())} of {len(self.row_white)} rows white)"
        )


def consistency(innovation: Innovation, *, skip: int = 0) -> Consistency:
    """Consistency of a run (innovations with a leading time axis), leaving out the first `skip` samples.

    Raises ValueError where fewer than 20 samples remain.

    >>> import numpy as np
    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import log_filter
    >>> from jax_inertia.maths.innovation_tests import consistency
    >>> from jax_inertia.estimation.priors import Load
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> log = log_filter.observe(swing(load=0.5), robot)
    >>> ekf = log_filter.online(robot, ["lower"], np.full(2, 0.05), prior=Load(1.0), gate=1.0)
    >>> _, trace = log_filter.run(ekf, ekf.initial(), log_filter.thinned(log))
    >>> consistency(trace.innovation, skip=10).rejected
    0.0
    """
    nis, rows = (np.asarray(x)[skip:] for x in (innovation.nis, innovation.rows))
    if len(nis) < 20:
        raise ValueError(f"{len(nis)} samples after the first {skip}; at least 20 are needed")
    used = rows > 0
    total = float(rows[used].sum())
    low, high = scipy.stats.chi2.interval(0.95, total)
    normalised = np.asarray(innovation.residual)[skip:] / np.asarray(innovation.sigma)[skip:]
    # A masked row's residual is exactly zero: it was not a measurement.
    measured = normalised != 0
    columns = [x[m] for x, m in zip(normalised.T, measured.T, strict=True)]
    tests = [_whiteness(x) for x in columns]
    return Consistency(
        nis_per_row=float(nis[used].sum() / max(total, 1.0)),
        nis_interval=(float(low / total), float(high / total)) if total else (np.nan, np.nan),
        within_95=float(np.mean(nis[used] <= scipy.stats.chi2.ppf(0.95, rows[used]))),
        row_variance=np.array([np.mean(x**2) if len(x) else np.nan for x in columns]),
        row_correlation=np.array([lag for lag, _ in tests]),
        row_white=np.array([p > 0.01 for _, p in tests]),
        rejected=rejected_share(innovation, skip=skip),
    )


def rejected_share(innovation: Innovation, *, skip: int = 0) -> float:
    """Share of a run's tested samples that were rejected; zero where none was tested.

    >>> import jax, jax.numpy as jnp
    >>> from jax_inertia.maths.innovation_tests import rejected_share
    >>> from jax_inertia.maths.kalman import Innovation
    >>> x, yes = jnp.zeros((3, 1)), jnp.ones(3, bool)
    >>> accepted, tested = yes.at[:2].set(False), yes.at[0].set(False)
    >>> run = jax.vmap(Innovation)(x, x, x[:, 0], x[:, 0], x[:, 0], accepted, tested)
    >>> rejected_share(run)
    0.5
    """
    tested, rejected = (np.asarray(x)[skip:] for x in (innovation.tested, innovation.rejected))
    return float(np.sum(rejected) / max(int(np.sum(tested)), 1))


def nees(
    mean: Float[Array, "*t n"], covariance: Float[Array, "*t n n"], truth: Float[Array, " n"]
) -> Float[np.ndarray, "*t"]:
    """Normalised estimation error squared (x − x̂)ᵀ P⁻¹ (x − x̂); χ² with n degrees of freedom when consistent.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.innovation_tests import nees
    >>> nees(jnp.array([1.0, 2.0]), jnp.diag(jnp.array([0.25, 1.0])), jnp.array([1.5, 2.0]))
    array(1.)
    """
    error = np.asarray(truth) - np.asarray(mean)
    solved = np.linalg.solve(np.asarray(covariance), error[..., None])[..., 0]
    return np.asarray(np.sum(error * solved, axis=-1))


def _whiteness(x: np.ndarray, lags: int = 10) -> tuple[float, float]:
    """(lag-one correlation, p-value of Ljung and Box 1978) of one row."""
    n = len(x)
    if n < 2 * lags:
        return np.nan, np.nan
    x = x - x.mean()
    power = max(float(x @ x), 1e-300)
    r = np.array([x[k:] @ x[:-k] for k in range(1, lags + 1)]) / power
    q = n * (n + 2) * np.sum(r**2 / (n - np.arange(1, lags + 1)))
    return float(r[0]), float(scipy.stats.chi2.sf(q, lags))
