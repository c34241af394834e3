"""Settings of the inertial filter: what is taken where nothing is said, and each fault in one line."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import block_diag
from jaxtyping import Array, Float

from jax_inertia.estimation.priors import Each, Uncertainty
from jax_inertia.maths import charts
from jax_inertia.maths.argument_checks import is_positive, known, require
from jax_inertia.maths.gates import ChiSquaredGate, FixedGate, Gate
from jax_inertia.maths.noise import IndependentNoise, Noise
from jax_inertia.model.robot import Robot


class Preset(NamedTuple):
    """What `make_estimator` takes for each argument left out."""

    chart: type[charts.Chart]
    iterations: int
    gate: float
    """Probability of keeping a good sample; 1: no gate."""
    reopen_after: float
    """[s]"""
    weighs_outliers: bool
    """Whether samples that no gate refuses are made consistent by more noise (`kalman.update`)."""
    loads_are_bodies: bool
    """Whether a load of the prior that says nothing of its shape gets one (`Load.of_a_body`)."""


GATE, REOPEN_AFTER = 0.9999, 0.5
"""Real residuals have bursts (gears at reversal) of a few tenths of a second; a load stays."""
# In U Uᵀ mass and centre of mass are coordinates of their own, in UᵀU the mass depends on four: there the UR10e's
# payload comes out at 6 kg or 0, whatever the iterations.
SAFE = Preset(
    charts.LogCholeskyUUt, 5, GATE, REOPEN_AFTER, weighs_outliers=True, loads_are_bodies=True
)
PAPER = Preset(
    charts.LogCholesky, 1, 1.0, float("inf"), weighs_outliers=False, loads_are_bodies=False
)
# Sudden changes are the affair of a gate that reopens; drift is for the slow rest. Without one, drift is for both.
_SLOW, _QUICK = 3600.0, 3.0


def gate_of(gate: Gate | float, robot: Robot) -> Gate:
    """The gate of a probability of keeping a good sample (1: none), or the one given; ValueError for neither."""
    if isinstance(gate, Gate):
        return gate
    if isinstance(gate, bool) or not isinstance(gate, int | float | np.number):
        raise ValueError(f"gate is {gate!r}; give a probability, or a Gate such as FixedGate(30.0)")
    if not 0 < gate <= 1:
        raise ValueError(
            f"gate probability is {gate}; it must lie above 0, and not above 1 (no gate)"
        )
    return ChiSquaredGate(float(gate), robot.nv) if gate < 1 else FixedGate()


def drift_seconds(
    gate: Gate, reopen_after: Float[Array, ""] | float, robot: Robot
) -> Float[Array, ""]:
    """Time in which bodies may drift by the prior [s]: long where a gate notices sudden changes and reopens."""
    closes = jnp.isfinite(gate.threshold(jnp.asarray(float(robot.nv))))
    return jnp.where(closes & jnp.isfinite(jnp.asarray(reopen_after)), _SLOW, _QUICK)


def require_filter(
    iterations: int, gate: Gate, reopen_after: Float[Array, ""] | float, robot: Robot
) -> None:
    """ValueError for settings that no filter of this robot can have."""
    if not isinstance(iterations, int | np.integer) or iterations < 1:
        raise ValueError(f"iterations is {iterations!r}; it must be a whole number, at least one")
    if isinstance(gate, ChiSquaredGate) and gate.max_rows < robot.nv:
        raise ValueError(
            f"the gate has max_rows {gate.max_rows}; a sample of this robot has {robot.nv}"
        )
    require("reopen_after", reopen_after, lambda x: x > 0, "positive [s], or infinite")


def require_physical(
    robot: Robot, chosen: tuple[int, ...], chart: charts.Chart, mean: Float[Array, "bodies 10"]
) -> None:
    """ValueError for a body that has no coordinates in the chart."""
    numbers = known(mean)
    if numbers is None or np.all(np.isfinite(numbers)):
        return
    body = chosen[int(np.argmin(np.all(np.isfinite(numbers), axis=1)))]
    raise ValueError(
        f"body {robot.body_names[body]!r} is not physical (mass {float(robot.pi[body, 0]):.4g} kg): "
        f"{type(chart).__name__} needs a positive-definite pseudo-inertia; estimate the link that carries it, or "
        "correct its inertial"
    )


def noise_of(
    noise: Noise | None,
    sigma_tau: Float[Array, "#nv"] | Float[Array, ""] | Sequence[float] | float,
    robot: Robot,
) -> Noise:
    """The noise given, or independent noise of `sigma_tau` [N m, N]; ValueError for one that no filter can have."""
    if noise is None:
        noise = IndependentNoise(of_rows("sigma_tau", sigma_tau, robot) ** 2)
    require_noise(noise, robot)
    return noise


def require_noise(noise: Noise, robot: Robot) -> None:
    """ValueError for noise of other rows than the robot's, or of none."""
    if not isinstance(noise, Noise) or noise.variances().shape != (robot.nv,):
        raise ValueError(f"noise is {noise!r}; give a Noise of the robot's {robot.nv} rows")
    sizes = jnp.sqrt(noise.variances())
    require("sigma of the noise", sizes, is_positive, "positive in all rows")


def covariance(
    name: str, uncertainty: Uncertainty, chart: charts.Chart, nominal: Float[Array, "bodies 10"]
) -> Float[Array, "bodies 10 10"]:
    """Of each body; ValueError for sizes that are none."""
    for part in _parts(uncertainty):
        for what, size in vars(part).items():
            if size is None:
                continue
            require(f"{what} of {name}", size, _is_size, "finite and not negative")
    return uncertainty.covariance(chart, nominal)


# Of the load expected: half a decade apart, an iteration that starts at one of them ends at any load in between.
_TIMES = (1.0, 4.0, 16.0)


def loaded(
    prior: Uncertainty, nominal: Float[Array, "bodies 10"]
) -> list[Float[Array, "bodies 10"]]:
    """The bodies with the prior's load on them, and with several times as much."""
    load = prior.anchor(nominal) - nominal
    return [nominal + times * load for times in _TIMES]


def growth(
    drift: Uncertainty | Float[Array, ""] | float,
    chart: charts.Chart,
    nominal: Float[Array, "bodies 10"],
    prior: Float[Array, "n n"],
) -> Float[Array, "n n"]:
    """Of the covariance per second, from a drift per √second or the seconds in which it reaches the prior."""
    if isinstance(drift, Uncertainty):
        return block_diag(*covariance("drift", drift, chart, nominal))
    # At the body that carries the prior's load. At the bare body, a small load's share of it would be a drift of the
    # same share of a body grown heavy: a flange of 0.2 kg that takes up 3 kg would then drift by 0.7 kg/√s.
    require("drift", drift, lambda x: x > 0, "positive [s], or an Uncertainty")
    return prior / jnp.asarray(drift, prior.dtype)


def of_rows(
    name: str, value: Float[Array, "#nv"] | Float[Array, ""] | Sequence[float] | float, robot: Robot
) -> Float[Array, " nv"]:
    """One size for each row, from one for all or one each; ValueError for another count, or for none."""
    array = jnp.asarray(value, robot.pi.dtype)
    if array.shape not in ((), (1,), (robot.nv,)):
        raise ValueError(
            f"{name} has shape {array.shape}; give one number, or one for each of {robot.nv} rows"
        )
    require(name, array, _is_size, "finite and not negative")
    return jnp.broadcast_to(array, (robot.nv,))


def _parts(uncertainty: Uncertainty) -> tuple[Uncertainty, ...]:
    if isinstance(uncertainty, Each):
        return *_parts(uncertainty.first), *_parts(uncertainty.others)
    return (uncertainty,)


def _is_size(x: np.ndarray) -> bool:
    return bool(np.all(np.isfinite(x) & (x >= 0)))
