"""Accelerations by differences, with every other channel given the same delay.

A difference over a window of samples is not the acceleration at its last stamp: it is the mean of
the acceleration over the window, half a window late. Combined with torques and positions of the last
stamp, it makes a filter see inertia in phase with velocity, that is, friction. The paper (sec.
III-D) takes accelerations "via finite differences, and the other signals are delayed to compensate
for the lag introduced". Here, with t_{k−w}, …, t_k the window's stamps,

    v̇ = (v_k − v_{k−w}) / (t_k − t_{k−w}),        the mean of v̇ over the window, exactly, x̄ = ∫ x
    dt / (t_k − t_{k−w}),                 the same mean of q, v, τ and wrenches, by the trapezoid
    rule.

So all channels pass one filter (a moving mean), not only one delay: they agree to O(h²), and
exactly where signals are linear in time. `time` is averaged too and says what moment a row belongs
to.

`Differentiator` does this sample by sample in JAX, `aligned_differences` for a whole log in NumPy,
with the same numbers. `central_differences` is for logs only: no delay at all, v̇_k at t_k from its
neighbours on both sides.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.lib.stride_tricks import sliding_window_view

from jax_inertia.logs.log import AnyArray
from jax_inertia.logs.schema import check_time
from jax_inertia.maths.finite_difference import continuous_signs, derivative
from jax_inertia.maths.precision import in_full_precision
from jax_inertia.signals.generalised_motion import Motion

RIGID_BODY_ERROR = 0.003
"""Relative error of a rigid body's torque along a log, one standard deviation [1]: its equation is exact, filters and
differences of the motion are not."""


class Observation(eqx.Module):
    """A motion and the acceleration v̇ (…, nv) that belongs to the same moments."""

    motion: Motion
    a: Float[AnyArray, "*T nv"]


def aligned_differences(motion: Motion, window: int = 1) -> Observation:
    """Difference v and average all else over each window of `window` + 1 samples: T − `window`
    rows.

    Row k is known at stamp k + `window` of the motion and belongs to its own `time`. It is valid
    where the whole window is. Raises `ValueError` for a window below one or longer than the motion,
    and `LogError` for a stamp that does not come after the one before.
    """
    _check_window(window, len(motion.time))
    time = np.asarray(motion.time)
    check_time(time)
    weight = _trapezoid(np, sliding_window_view(time, window + 1))

    def mean(x: AnyArray) -> np.ndarray:
        # sliding_window_view puts the window last.
        return np.einsum(
            "t...w,tw->t...", sliding_window_view(np.asarray(x), window + 1, 0), weight
        )

    smooth = dataclasses.replace(
        motion,
        time=mean(time),
        q=_unit_quaternions(np, mean(_continuous(motion)), motion.quaternions),
        v=mean(motion.v),
        tau=mean(motion.tau),
        valid=sliding_window_view(np.asarray(motion.valid), window + 1, 0).all(axis=-1),
        wrench=None if motion.wrench is None else mean(motion.wrench),
    )
    v = np.asarray(motion.v)
    return Observation(
        smooth, (v[window:] - v[:-window]) / (time[window:] - time[:-window])[:, None]
    )


def central_differences(motion: Motion) -> Observation:
    """Accelerations at the stamps themselves, from the neighbours on both sides: T − 2 rows, no
    delay.

    v̇_k as in `finite_difference.centred_slopes`; the other channels stay as they are. A difference amplifies noise:
    low-pass the log first, all channels alike. Raises `ValueError` for fewer than three samples,
    and `LogError` for a stamp that does not come after the one before.
    """
    _check_window(2, len(motion.time))
    time, v, valid = (np.asarray(x) for x in (motion.time, motion.v, motion.valid))
    check_time(time)
    a = derivative(time, v)
    inner = jax.tree.map(lambda x: x[1:-1], motion)
    inner = dataclasses.replace(inner, valid=valid[:-2] & valid[1:-1] & valid[2:])
    return Observation(inner, a[1:-1])


class Differentiator(eqx.Module):
    """`aligned_differences` online: `step(state, sample) -> (state, observation)`, for `jit`,
    `scan` and `vmap`.

    Stamps keep their precision in float32 for some minutes only: count them from the start of the
    run. Until `window` + 1 samples have come, observations are not valid. What is not finite in a
    sample is replaced by the value before and marked: a torque its own row, anything else all rows,
    for as long as a window holds it. A stamp that does not come after the one before marks all rows
    too.
    """

    window: int = eqx.field(static=True, default=1)

    def __check_init__(self) -> None:
        _check_window(self.window, self.window + 1)

    def init(self, sample: Motion) -> "DifferentiatorState":
        """Start from the first sample (no leading axis); it counts as seen."""
        first, valid = _held(sample, jax.tree.map(jnp.zeros_like, sample))
        first = dataclasses.replace(first, valid=valid)
        buffer = jax.tree.map(lambda x: jnp.repeat(x[None], self.window + 1, axis=0), first)
        return DifferentiatorState(buffer, jnp.asarray(1))

    @in_full_precision
    def step(
        self, state: "DifferentiatorState", sample: Motion
    ) -> tuple["DifferentiatorState", Observation]:
        """Take the next sample."""
        last = jax.tree.map(lambda x: x[-1], state.buffer)
        held, valid = _held(sample, last)
        held = dataclasses.replace(
            held, q=_same_signs(held.q, last.q, held.quaternions), valid=valid
        )
        buffer = jax.tree.map(
            lambda old, new: jnp.concatenate([old[1:], new[None]]), state.buffer, held
        )
        count = jnp.minimum(state.count + 1, self.window + 1)
        # The first samples repeat in the buffer: no time passes between them, no weight falls on
        # them.
        span = buffer.time[-1] - buffer.time[0]
        span = jnp.where(span > 0, span, 1.0)
        weight = _trapezoid(jnp, buffer.time)
        seen = (count > self.window) & jnp.all(jnp.diff(buffer.time) > 0)

        def mean(x: Array) -> Array:
            return jnp.tensordot(weight, x, axes=1)

        smooth = dataclasses.replace(
            held,
            time=mean(buffer.time),
            q=_unit_quaternions(jnp, mean(buffer.q), held.quaternions),
            v=mean(buffer.v),
            tau=mean(buffer.tau),
            valid=buffer.valid.all(axis=0) & seen,
            wrench=None if buffer.wrench is None else mean(buffer.wrench),
        )
        a = (buffer.v[-1] - buffer.v[0]) / span
        return DifferentiatorState(buffer, count), Observation(smooth, a)


class DifferentiatorState(eqx.Module):
    """The last `window` + 1 samples (leading axis, oldest first) and how many of them have come."""

    buffer: Motion
    count: Int[Array, ""]


def _check_window(window: int, samples: int) -> None:
    if window < 1 or samples < window + 1:
        raise ValueError(f"a window of {window} periods in {samples} samples; expected 1 to T - 1")


def _trapezoid(xp, time: AnyArray) -> AnyArray:
    """Weights of the trapezoid rule over the last axis, of sum one."""
    h = xp.diff(time, axis=-1)
    zero = xp.zeros_like(time[..., :1])
    weight = xp.concatenate([zero, h], axis=-1) + xp.concatenate([h, zero], axis=-1)
    span = 2 * (time[..., -1:] - time[..., :1])
    even = xp.ones_like(time) / time.shape[-1]
    return xp.where(span > 0, weight / xp.where(span > 0, span, 1.0), even)


def _unit_quaternions(xp, q: AnyArray, addresses: tuple[int, ...]) -> AnyArray:
    parts, end = [], 0
    for adr in sorted(addresses):
        quat = q[..., adr : adr + 4]
        norm = xp.sqrt(xp.sum(quat**2, axis=-1, keepdims=True))
        parts += [q[..., end:adr], quat / xp.where(norm > 0, norm, 1.0)]
        end = adr + 4
    return xp.concatenate([*parts, q[..., end:]], axis=-1)


def _continuous(motion: Motion) -> np.ndarray:
    q = np.array(motion.q)
    for adr in motion.quaternions:
        q[:, adr : adr + 4] = continuous_signs(q[:, adr : adr + 4])
    return q


def _same_signs(q: AnyArray, last: AnyArray, addresses: tuple[int, ...]) -> Array:
    q = jnp.asarray(q)
    for adr in addresses:
        quat, before = q[adr : adr + 4], last[adr : adr + 4]
        q = q.at[adr : adr + 4].set(jnp.where(quat @ before < 0, -quat, quat))
    return q


def _held(sample: Motion, last: Motion) -> tuple[Motion, Bool[Array, "nv"]]:
    """The sample with the last values where it is not finite, and which rows are measured."""
    sample = jax.tree.map(jnp.asarray, sample)
    moved = [sample.time, sample.q, sample.v]
    moved += [] if sample.wrench is None else [sample.wrench]
    motion_valid = jnp.stack([jnp.isfinite(x).all() for x in moved]).all()
    valid = jnp.asarray(sample.valid) & jnp.isfinite(sample.tau) & motion_valid

    def hold(new: Array, old: Array) -> Array:
        return jnp.where(jnp.isfinite(new), new, old)

    return jax.tree.map(hold, sample, last), valid
