"""A link behind a spring or behind play, moved by a motor whose path is known: how far the two are apart.

The encoder sits on the motor, so its path θ(t) is what the log holds; the link is at q = θ − δ. With n(t) the torque
that the link alone would need to follow θ, and the model linearised about the logged motion,

    M_jj δ̈ + (∂ID/∂v)_jj δ̇ + (∂ID/∂q)_jj δ + f(δ, δ̇) = n(t),

where f is the torque through the coupling: K δ + D δ̇, for teeth with a dead zone b nothing between ±b/2. Solving
this forward needs two derivatives of the encoder; going from motor torque to δ and back to torque would take four.

A link on a spring rings, teeth rattle, and the smallest error of n, of M or of the spring's law grows at its resonance.
What the coupling carried is known from the motor's side as well, s = n − y = τ − J θ̈ − friction, and where it touches
δ̇ ≈ ṡ/K. So the computed path is drawn to that rate (an observer: Luenberger 1964),

    M_jj δ̈ + ... + f(δ, δ̇) + D₀ (δ̇ − ṡ/K) = n(t),    D₀ = 2 ζ₀ √(K mean M_jj)

which the true path obeys as well, but for the coupling's own loss, and in which errors decay.
"""

import dataclasses
import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jax_inertia.slopes import derivative

# A tooth's contact lasts some milliseconds.
STEP = 5e-4
# Damping ratio ζ₀ of the path's errors.
OBSERVED = 0.3
# Of the most torque on its teeth, what tells on which side they lie.
LEANS = 0.03


Coupling = tuple[float, float, float, float]
"""(K [N m/rad], damping ratio ζ, dead zone b [rad], s): D = 2 ζ √(K mean M_jj), the path begins at s b/2."""


@dataclasses.dataclass(frozen=True)
class DrivenLink:
    """One joint's motor and link along a log, and how far apart the couplings tried so far let them be."""

    time: Float[np.ndarray, " T"]
    needed: Float[np.ndarray, " T"]
    """n [N m]."""
    carried: Float[np.ndarray, " T"]
    """s [N m]."""
    inertia: Float[np.ndarray, " T"]
    damping: Float[np.ndarray, " T"]
    stiffness: Float[np.ndarray, " T"]
    """The link's own: M_jj, (∂ID/∂v)_jj and (∂ID/∂q)_jj."""
    _paths: dict[Coupling, np.ndarray] = dataclasses.field(default_factory=dict)

    @functools.cached_property
    def leans(self) -> float:
        """On which side the teeth lie when the log begins, −1 or 1; zero where that is not told.

        A link that no weight turns rests anywhere within its play.
        """
        first = self.carried[0]
        clear = abs(first) > LEANS * np.percentile(np.abs(self.carried), 99.5)
        return float(np.sign(first)) if clear else 0.0

    def separation(self, coupling: Coupling) -> Float[np.ndarray, " T"]:
        """δ: how far the motor is ahead of the link through a coupling.

        Where the log begins with torque on the teeth that says on which side they lie, whatever s is.
        """
        self.separate([coupling])
        return self._paths[coupling]

    def separate(self, couplings: list[Coupling]) -> None:
        """`separation` of many couplings at once; every later call finds them.

        Trapezoidal rule with the branch (touching or not) fixed at each step's start; teeth never pull. A path begins
        with what the spring is wound up.
        """
        new = [c for c in dict.fromkeys(couplings) if c not in self._paths]
        if not new:
            return
        values = np.array(new)
        if self.leans:
            values[:, 3] = self.leans
        period = float(self.time[1] - self.time[0])
        rate = derivative(self.time, self.carried)
        signals = np.stack([self.needed, rate, self.inertia, self.damping, self.stiffness])
        # As an array: a number would be compiled in, and every log has another.
        first = jnp.asarray(self.carried[0])
        substeps = max(1, math.ceil(period / STEP))
        paths = _separation(jnp.asarray(signals), jnp.asarray(values), first, period, substeps)
        self._paths.update(zip(new, np.asarray(paths), strict=True))


@eqx.filter_jit
def _separation(
    signals: Array, coupling: Array, first: Array, period: float, substeps: int
) -> Array:
    k, ratio, gap, side = coupling.T
    critical = 2.0 * jnp.sqrt(k * jnp.mean(signals[2]))
    d, drawn = ratio * critical, OBSERVED * critical
    half, h = 0.5 * gap, period / substeps

    def substep(state, x):
        delta, rate = state
        n, ds, m, c, kq = x
        tooth = jnp.sign(delta)
        force = k * (delta - tooth * half) + d * rate
        touching = (half == 0.0) | ((jnp.abs(delta) > half) & (force * tooth >= 0.0))
        kt, ct = jnp.where(touching, k, 0.0) + kq, jnp.where(touching, d + drawn, 0.0) + c
        push = n + jnp.where(touching, k * tooth * half + drawn * ds / k, 0.0)
        left = m / h + 0.5 * ct + 0.25 * kt * h
        new = (push + rate * (m / h - 0.5 * ct - 0.25 * kt * h) - kt * delta) / left
        return (delta + 0.5 * h * (rate + new), new), None

    def sample(state, x):
        before, after = x
        weights = (jnp.arange(substeps) + 0.5) / substeps
        inner = before + weights[:, None] * (after - before)
        state, _ = jax.lax.scan(substep, state, inner)
        return state, state[0]

    # A log may begin in the middle of a motion.
    start = first / k + side * half
    pairs = (signals.T[:-1], signals.T[1:])
    _, path = jax.lax.scan(sample, (start, signals[1, 0] / k), pairs)
    return jnp.concatenate([start[None], path]).T
