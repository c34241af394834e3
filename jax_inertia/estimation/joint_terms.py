"""Friction and offset of every joint as unknowns of a filter: their columns, and how large they usually are.

The torque that drives a joint is that of the model and, besides,

    d q̇ + F tanh(q̇ / 0.01 rad/s) + b,

a viscous and a dry friction beyond the model's own and the offset of its sensor (Armstrong-Hélouvry, Dupont and Canudas
de Wit, Automatica 30(7), 1994). At rest dry friction is whatever balances: a row's variance grows by F² (1 − tanh²).
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import block_diag
from jaxtyping import Array, Float

from jax_inertia.maths.kalman import Belief
from jax_inertia.model.robot import Robot
from jax_inertia.signals.torque_residual import FRICTION_VELOCITY

NAMES = ("damping", "frictionloss", "offset")
# Standard deviations of the three, in parts of a joint's peak torque, as in the diagnosis' ordinary physics; of viscous
# friction at the joint's usual speed, a radian a second at most.
_SHARES = np.array([0.15, 0.15, 0.05])
# Of the torque's and the speed's size: what is above is a spike.
_PEAK = 99.5


class JointTerms(eqx.Module):
    """How far each row's terms may be from the model's own, one standard deviation; zero: they are exact."""

    sigma: Float[Array, "nv 3"]
    """[N m s/rad, N m, N m], on slides [N s/m, N, N]."""

    def columns(self, v: Float[Array, "*t nv"]) -> Float[Array, "*t nv 3"]:
        """∂τ of each row by its own terms, at joint velocities."""
        return columns(v, jnp)


def columns(v: Any, xp: Any = np) -> Any:
    """∂τ of each row by the three terms, at joint velocities (..., nv): (..., nv, 3).

    >>> import numpy as np
    >>> from jax_inertia.estimation.joint_terms import columns
    >>> columns(np.array([2.0])).tolist()
    [[2.0, 1.0, 1.0]]
    """
    return xp.stack([v, xp.tanh(v / FRICTION_VELOCITY), xp.ones_like(v)], axis=-1)


class FoundTerms(eqx.Module):
    """What a filter has found of the terms, one entry for each row that its bodies move."""

    value: Float[Array, "*t rows 3"]
    """Beyond the model's own: N m s/rad, N m, N m."""
    sigma: Float[Array, "*t rows 3"]


def of_log(
    robot: Robot, tau: Float[np.ndarray, "T nv"], v: Float[np.ndarray, "T nv"]
) -> JointTerms:
    """Terms of the usual sizes for a log with these torques and speeds; none on rows of balls and free joints.

    >>> import numpy as np
    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import joint_terms
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> full = np.full((9, 2), 10.0)
    >>> joint_terms.of_log(load_model(double_pendulum()), full, 0.5 * full / 10).sigma[0].round(6)
    Array([3. , 1.5, 0.5], dtype=float64)
    """
    peak, top = (np.nanpercentile(np.abs(x), _PEAK, axis=0) for x in (tau, v))
    usual = np.clip(top, 1e-6, robot.topology.dof_radian)
    sigma = _SHARES * peak[:, None] / np.stack([usual, *[np.ones_like(usual)] * 2], axis=1)
    scalar = np.asarray(robot.topology.dof_scalar)[:, None]
    return JointTerms(
        jnp.asarray(np.where(scalar & np.isfinite(sigma), sigma, 0.0), robot.pi.dtype)
    )


# Seconds in which friction and offsets may drift by the prior: they change with temperature.
_DRIFT = 3600.0


def with_terms(
    bodies: Belief,
    growth: Float[Array, "b b"],
    joints: JointTerms,
    rows: tuple[int, ...],
) -> tuple[Belief, Float[Array, "n n"]]:
    """A belief about bodies, and how it grows per second, with the terms of `rows` as further states about zero."""
    variance = joints.sigma[np.array(rows)].ravel().astype(bodies.mean.dtype) ** 2
    mean = jnp.concatenate([bodies.mean, jnp.zeros_like(variance)])
    covariance = block_diag(bodies.covariance, jnp.diag(variance))
    return Belief(mean, covariance), block_diag(growth, jnp.diag(variance / _DRIFT))
