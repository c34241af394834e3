"""Rows of the batch fit: one equation per joint and sample, compressed so that the solver never sees a sample."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_inertia import dynamics
from jax_inertia.differences import Observation
from jax_inertia.measurement import torque_residuals
from jax_inertia.robot import Robot

# Dry friction inside a regressor: soft enough to bear velocity noise, far below working speeds.
FRICTION_VELOCITY = 0.01
TERMS = 4
"""Columns of each joint's own terms, the last ones: damping, dry friction, armature, offset."""


class Rows(eqx.Module):
    """columns @ w + base = gain · raw + noise, row by row; all zero where not valid."""

    columns: Float[np.ndarray, "T nv c"]
    """Regressors of the bodies that are fitted, of the load carried, then the joint terms."""
    base: Float[np.ndarray, "T nv"]
    """What the chosen bodies must explain besides the logged torque: minus all else that the model knows."""
    raw: Float[np.ndarray, "T nv"]
    """The logged torque in its own unit."""
    valid: Bool[np.ndarray, "T nv"]

    def residual(
        self, w: Float[np.ndarray, "nv c"], gain: Float[np.ndarray, " nv"]
    ) -> Float[np.ndarray, "T nv"]:
        """What is left of every row, in the log's own unit."""
        return (self.base - np.einsum("tjc,jc->tj", self.columns, w)) / gain + self.raw

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
        self, gain: Float[np.ndarray, " nv"], free: Bool[np.ndarray, " nv"]
    ) -> Float[np.ndarray, "T nv"]:
        """What least squares over each joint's own columns leaves, each joint by itself, in the log's own unit.

        Where the gain is free it is one more unknown, and elsewhere as given.
        """
        out = np.zeros_like(self.raw)
        for j in range(len(gain)):
            x, y = self.columns[:, j], self.raw[:, j]
            if free[j]:
                x = np.concatenate([x, self.base[:, j, None]], axis=1)
            else:
                y = y + self.base[:, j] / gain[j]
            size = np.linalg.norm(x, axis=0)
            q, r = np.linalg.qr(x[:, size > 0] / size[size > 0])
            u, s, _ = np.linalg.svd(r)
            seen = q @ u[:, s > 1e-8 * s.max(initial=0.0)]
            out[:, j] = y - seen @ (seen.T @ y)
        return out


def rows_of(
    robot: Robot,
    observations: Sequence[Observation],
    chosen: tuple[int, ...],
    bias: Float[np.ndarray, " nv"],
    carrier: int | None,
    carrying: Sequence[int],
) -> Rows:
    """The rows of all the logs; those of the logs `carrying` also see a load on the body `carrier`."""
    parts = []
    for k, one in enumerate(observations):
        motion = one.motion
        silent = eqx.tree_at(lambda o: o.motion.tau, one, np.zeros_like(motion.tau))
        regressor, base = _residuals(robot, silent, chosen, jnp.asarray(bias))
        v, a = np.asarray(motion.v), np.asarray(one.a)
        blocks = [np.asarray(regressor).reshape(*v.shape, -1)]
        if carrier is not None:
            load = _load_regressor(robot, one, carrier) if k in carrying else 0.0
            blocks.append(np.broadcast_to(np.asarray(load), (*v.shape, 10)))
        blocks.append(np.stack([v, np.tanh(v / FRICTION_VELOCITY), a, np.ones_like(v)], axis=-1))
        columns = np.concatenate(blocks, axis=-1)
        finite = np.isfinite(columns).all(axis=-1) & np.isfinite(base) & np.isfinite(motion.tau)
        parts.append((columns, np.asarray(base), np.asarray(motion.tau), motion.valid & finite))
    columns, base, raw, valid = (np.concatenate(x) for x in zip(*parts, strict=True))
    return Rows(
        np.where(valid[:, :, None], columns, 0.0),
        np.where(valid, base, 0.0),
        np.where(valid, raw, 0.0),
        valid,
    )


_residuals = eqx.filter_jit(torque_residuals)


@eqx.filter_jit
def _load_regressor(robot: Robot, observations: Observation, body: int):
    def one(x):
        q, v, a = x
        return dynamics.torque_regressor(robot, q, v, a, [body])[:, 0]

    motion = observations.motion
    states = [jnp.asarray(x) for x in (motion.q, motion.v, observations.a)]
    return jax.lax.map(one, states, batch_size=64)


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
