"""Rows of the batch fit: one equation per joint and sample, compressed so that the solver never sees a sample."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jax_inertia.dynamics import rigid_body
from jax_inertia.model.model_errors import ModelErrors
from jax_inertia.model.robot import Robot
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.torque_residual import FRICTION_VELOCITY, torque_residuals

TERMS = 4
"""Columns of each joint's own terms, the last ones: damping, dry friction, armature, offset."""


class Rows(eqx.Module):
    """columns @ w + base − gain · raw = noise, row by row: the torque residual; all zero where not valid."""

    columns: Float[np.ndarray, "T nv c"]
    """Regressors of the bodies that are fitted, of the load carried, of the model's errors, then the joint terms."""
    base: Float[np.ndarray, "T nv"]
    """What the model needs without the chosen bodies [N m]."""
    raw: Float[np.ndarray, "T nv"]
    """The logged torque in its own unit."""
    valid: Bool[np.ndarray, "T nv"]

    def residual(
        self, w: Float[np.ndarray, "nv c"], gain: Float[np.ndarray, " nv"]
    ) -> Float[np.ndarray, "T nv"]:
        """The torque residual of every row, in the log's own unit."""
        return (self.base + np.einsum("tjc,jc->tj", self.columns, w)) / gain - self.raw

    def rms(self, x: Float[np.ndarray, "T nv"]) -> Float[np.ndarray, " nv"]:
        """Root mean square of each joint's valid rows."""
        total = np.sum(np.where(self.valid, x, 0.0) ** 2, axis=0)
        return np.sqrt(total / np.maximum(self.valid.sum(axis=0), 1))

    def triangles(self) -> Float[np.ndarray, "nv k k"]:
        """Triangle of each joint's [columns, base, raw]: same sums of squares, no samples."""
        k = self.columns.shape[2] + 2
        out = np.zeros((self.columns.shape[1], k, k))
        for j in range(len(out)):
            rows = np.column_stack([self.columns[:, j], self.base[:, j], self.raw[:, j]])
            rows = rows[self.valid[:, j]]
            # A joint sees only the bodies it moves: most columns of most rows are exactly zero.
            seen = np.flatnonzero(np.any(rows != 0, axis=0))
            if len(seen):
                r = np.asarray(np.linalg.qr(rows[:, seen], mode="r"))
                out[j][: len(r), seen] = r
        return out

    def linear_residual(
        self,
        triangles: Float[np.ndarray, "nv k k"],
        gain: Float[np.ndarray, " nv"],
        free: Bool[np.ndarray, " nv"],
    ) -> Float[np.ndarray, "T nv"]:
        """Residual of least squares over each joint's own columns, each joint by itself, in the log's own unit.

        Where the gain is free it is one more unknown, and elsewhere as given.
        """
        out = np.zeros_like(self.raw)
        for j, r in enumerate(triangles):
            inverse = 0.0 if free[j] else 1.0 / gain[j]
            x = r[:, : -1 if free[j] else -2]
            size = np.maximum(np.linalg.norm(x, axis=0), 1e-300)
            w, *_ = np.linalg.lstsq(x / size, r[:, -1] - inverse * r[:, -2], rcond=1e-8)
            w = np.append(w / size, [inverse] * (not free[j]))
            out[:, j] = self.base[:, j] * w[-1] - self.raw[:, j] + self.columns[:, j] @ w[:-1]
        return out


def rows_of(
    robot: Robot,
    observations: Sequence[Observation],
    chosen: tuple[int, ...],
    bias: Float[np.ndarray, " nv"],
    carrier: int | None,
    carrying: Sequence[int],
    errors: ModelErrors | None = None,
) -> Rows:
    """The rows of all the logs; those of the logs `carrying` also see a load on the body `carrier`.

    The model's `errors` are columns of unit variance; those of the chosen bodies are in their own.
    """
    parts = []
    for k, one in enumerate(observations):
        motion = one.motion
        others = () if errors is None else uncertain_bodies(errors, chosen)
        every, base, load = _in_blocks(robot, one, (*chosen, *others), jnp.asarray(bias), carrier)
        regressor, of_others = np.split(every, [len(chosen)], axis=2)
        base = base + np.einsum("tjbi,bi->tj", of_others, np.asarray(robot.pi)[list(others)])
        terms = joint_columns(one)
        load, v = load if k in carrying else np.zeros_like(load), np.asarray(motion.v)
        off = np.zeros((*v.shape, 0))
        if errors is not None:
            off = error_columns(errors, others, of_others, terms)
        columns = np.concatenate([regressor.reshape(*v.shape, -1), load, off, terms], axis=-1)
        finite = np.isfinite(columns).all(axis=-1) & np.isfinite(base) & np.isfinite(motion.tau)
        parts.append((columns, base, np.asarray(motion.tau), motion.valid & finite))
    columns, base, raw, valid = (np.concatenate(x) for x in zip(*parts, strict=True))
    return Rows(
        np.where(valid[:, :, None], columns, 0.0),
        np.where(valid, base, 0.0),
        np.where(valid, raw, 0.0),
        valid,
    )


def joint_columns(observation: Observation) -> Float[np.ndarray, "T nv 4"]:
    """∂τ of each row by its joint's damping, dry friction, armature and offset."""
    v = np.asarray(observation.motion.v)
    one = np.ones_like(v)
    return np.stack([v, np.tanh(v / FRICTION_VELOCITY), np.asarray(observation.a), one], axis=-1)


def error_columns(
    errors: ModelErrors,
    bodies: tuple[int, ...],
    regressor: Float[np.ndarray, "T nv bodies 10"],
    terms: Float[np.ndarray, "T nv 4"],
) -> Float[np.ndarray, "T nv k"]:
    """∂τ by each unknown of a model's errors, of the joints and of these bodies [N m, N]."""
    of_bodies = np.einsum("tjbi,bik->tjk", regressor, np.asarray(errors.pi)[list(bodies)])
    return of_bodies + np.einsum("tjm,jmk->tjk", terms, np.asarray(errors.joints))


def uncertain_bodies(errors: ModelErrors, chosen: tuple[int, ...]) -> tuple[int, ...]:
    """Bodies other than the chosen that a model's errors are of."""
    off = np.flatnonzero(np.any(np.asarray(errors.pi) != 0, axis=(1, 2)))
    return tuple(int(b) for b in off if b not in chosen)


_BLOCK = 512


def _in_blocks(
    robot: Robot,
    observation: Observation,
    chosen: tuple[int, ...],
    bias: Float[Array, " nv"],
    carrier: int | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`_block` over a log, in blocks of one size: compiled once for logs of any length."""
    motion = observation.motion
    silent = eqx.tree_at(lambda o: o.motion.tau, observation, np.zeros_like(motion.tau))
    silent = dataclasses.replace(silent, motion=dataclasses.replace(silent.motion, notes=()))
    samples = len(motion.time)
    parts = []
    for start in range(0, samples, _BLOCK):
        index = np.minimum(np.arange(start, start + _BLOCK), samples - 1)
        block = jax.tree.map(lambda x, i=index: np.asarray(x)[i], silent)
        parts.append(_block(robot, block, chosen, bias, carrier))
    regressor, base, load = (
        np.concatenate([np.asarray(p) for p in x])[:samples] for x in zip(*parts, strict=True)
    )
    return regressor, base, load


@eqx.filter_jit
def _block(
    robot: Robot,
    observation: Observation,
    chosen: tuple[int, ...],
    bias: Float[Array, " nv"],
    carrier: int | None,
) -> tuple[Array, Array, Array]:
    """(regressors of the chosen bodies, what the model needs without them, the carrier's regressor or no columns)."""
    regressor, base = torque_residuals(robot, observation, chosen, bias)
    if carrier is None:
        return regressor, base, jnp.zeros((*base.shape, 0))

    def one(x):
        q, v, a = x
        return rigid_body.torque_regressor(robot, q, v, a, [carrier])[:, 0]

    states = [observation.motion.q, observation.motion.v, observation.a]
    return regressor, base, jax.lax.map(one, states, batch_size=64)


def correlation_inflation(
    residual: Float[np.ndarray, "T nv"], valid: Bool[np.ndarray, "T nv"]
) -> Float[np.ndarray, " nv"]:
    """√(1 + 2 Σ ρ_k): how much noisier white noise would have to be to average out as slowly as this residual.

    ρ is summed up to its first zero (Geyer's initial positive sequence).
    """
    out = np.ones(residual.shape[1])
    for j, (e, ok) in enumerate(zip(residual.T, valid.T, strict=True)):
        e = np.where(ok, e, 0.0)
        size = 2 ** int(np.ceil(np.log2(2 * len(e))))
        correlation = np.fft.irfft(np.abs(np.fft.rfft(e, size)) ** 2)[: len(e) // 4 + 1]
        if correlation[0] <= 1e-300:
            continue
        rho = correlation / correlation[0]
        ends = np.flatnonzero(rho <= 0)
        stop = ends[0] if len(ends) else len(rho)
        out[j] = np.sqrt(1.0 + 2.0 * rho[1:stop].sum())
    return out
