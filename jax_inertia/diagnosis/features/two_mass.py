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

A model has one friction per joint. Of a geared motor it sits on the motor, of bearings and seals behind the coupling on
the link. There it takes part in n and s, and follows the link's velocity θ̇ − δ̇: while the teeth part it may hold the
link, whatever the motor does. So it is with a constant torque that the robot has and the model has not: a hose pulls at
the link, which needs less by it and drifts through its play; a current sensor's zero is the motor's.
"""

import dataclasses
import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import polynomial

from jax_inertia.maths.finite_difference import derivative

# A tooth's contact lasts some milliseconds.
STEP = 5e-4
# Damping ratio ζ₀ of the path's errors.
OBSERVED = 0.3
# Of the most torque on its teeth, what tells on which side they lie.
LEANS = 0.03


Coupling = tuple[float, float, float, float, float]
"""(K [N m/rad], damping ratio ζ, dead zone b [rad], o, h): D = 2 ζ √(K mean M_jj).

o, h: one where a constant torque, and the joint's own friction, is the link's, zero where it is the motor's.
"""


@dataclasses.dataclass(frozen=True)
class OwnFriction:
    """A joint's friction as the model has it, which may be the motor's or the link's."""

    speed: Float[np.ndarray, " T"]
    """θ̇."""
    viscous: float
    dry: float
    carried: Float[np.ndarray, " T"]
    """s where it is the link's [N m]."""


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
    """The link's own: M_jj, (∂ID/∂v)_jj and (∂ID/∂q)_jj, like `needed` and `carried` without the joint's friction."""
    friction: OwnFriction | None = None
    offset: float = 0.0
    """Constant torque that the robot has and the model has not [N m]."""
    predicted: bool = False
    """Whether `carried` is no torque that was logged."""
    _paths: dict[Coupling, np.ndarray] = dataclasses.field(default_factory=dict)
    _begins: dict[int, np.ndarray] = dataclasses.field(default_factory=dict)
    """s and ṡ of either friction at the first sample, by how many samples they are read off."""

    @functools.cached_property
    def leans(self) -> float:
        """On which side the teeth lie when the log begins, −1 or 1; zero where that is unknown.

        A path begins on that side; a link that no weight turns rests anywhere within its play.
        """
        first = self.carried[0]
        clear = abs(first) > LEANS * np.percentile(np.abs(self.carried), 99.5)
        return float(np.sign(first)) if clear else 0.0

    def by_motion(self, needed: Float[np.ndarray, " T"]) -> "DrivenLink":
        """The same whose paths are predictions: `needed`, n within the chain's band, is taken for what is carried.

        A path drawn to the logged torque holds a part of what it is to predict: a false spring that resonates within
        the band then explains all of the torque there. What its link would need on a stiff joint is not what a spring
        carries near its resonance: its path is drawn to nothing, and how it begins is no part of it (`ringing`).
        """
        own = self.friction
        if own is not None:
            own = dataclasses.replace(own, carried=needed + own.carried - self.carried)
        return dataclasses.replace(
            self, carried=needed, friction=own, predicted=True, _paths={}, _begins={}
        )

    def ringing(self, coupling: Coupling) -> Float[np.ndarray, "T 2"]:
        """How a link on a spring rings by itself, from apart and from moving: exp(−ζ'ωt) cos and sin ω't [1]."""
        stiffness, ratio, *_ = coupling
        omega = np.sqrt(stiffness / np.mean(self.inertia))
        loss = ratio + 0.5 * np.mean(self.damping) / np.sqrt(stiffness * np.mean(self.inertia))
        since = self.time - self.time[0]
        turn = omega * np.sqrt(max(1.0 - loss**2, 0.0)) * since
        return np.exp(-loss * omega * since)[:, None] * np.stack([np.cos(turn), np.sin(turn)], 1)

    def separation(self, coupling: Coupling) -> Float[np.ndarray, " T"]:
        """δ: how far the motor is ahead of the link through a coupling."""
        self.separate([coupling])
        return self._paths[coupling][:, 0]

    def rubbing(self, coupling: Coupling) -> Float[np.ndarray, " T"]:
        """Torque of dry friction on the link along that path; zero where friction is the motor's."""
        self.separate([coupling])
        return self._paths[coupling][:, 1]

    def separate(self, couplings: list[Coupling]) -> None:
        """`separation` of many couplings at once; every later call finds them.

        Trapezoidal rule with the branch (touching or not) fixed at each step's start; teeth never pull. A path begins
        with what the spring is wound up.
        """
        new = [c for c in dict.fromkeys(couplings) if c not in self._paths]
        if not new:
            return
        values = np.array(new)
        period = float(self.time[1] - self.time[0])
        still = np.zeros_like(self.needed)
        own = self.friction or OwnFriction(still, 0.0, 0.0, self.carried)
        signals = [self.needed, self.inertia, self.damping, self.stiffness, own.speed]
        carried = np.stack([self.carried, own.carried])
        rates = [derivative(self.time, s) for s in carried]
        # As arrays: a number would be compiled in, and every log has another.
        first, slope = self._begun(carried, values)
        drawn = 0.0 if self.predicted else OBSERVED
        of_either = jnp.array([own.viscous, own.dry, drawn, self.offset, self.leans])
        numbers = (of_either, jnp.asarray(first), jnp.asarray(slope))
        substeps = max(1, math.ceil(period / STEP))
        paths = _separation(
            jnp.asarray(np.stack([*signals, *rates])),
            jnp.asarray(values),
            numbers,
            period,
            substeps,
        )
        self._paths.update(zip(new, np.asarray(paths), strict=True))

    def _begun(
        self, carried: Float[np.ndarray, "2 T"], couplings: Float[np.ndarray, "K 5"]
    ) -> tuple[Float[np.ndarray, "2 K"], Float[np.ndarray, "2 K"]]:
        """s and ṡ at the first sample by a cubic through its first stretch, for friction on the motor or the link."""
        periods = 2.0 * np.pi * np.sqrt(np.mean(self.inertia) / couplings[:, 0])
        since = self.time - self.time[0]
        stretches = np.maximum(OF_PERIOD * periods, SHORTEST)
        counts = np.maximum(DEGREE + 2, np.searchsorted(since, stretches, side="right")).tolist()
        for count in set(counts) - set(self._begins):
            cubic = polynomial.polyfit(since[:count], carried[:, :count].T, DEGREE)
            self._begins[count] = cubic[:2]
        first, slope = np.stack([self._begins[count] for count in counts], axis=-1)
        return first, slope


# The torque that a coupling carries as a log begins, and how fast it changes, are read off this share of a period of
# its resonance, and no fewer seconds: from two samples they would be noise, which rings on.
OF_PERIOD, SHORTEST = 0.5, 0.05
# Of a polynomial that half a period of a sine is, within 5 % of its amplitude.
DEGREE = 3


@eqx.filter_jit
def _separation(
    signals: Array,
    coupling: Array,
    numbers: tuple[Array, Array, Array],
    period: float,
    substeps: int,
) -> Array:
    k, ratio, gap, pulled, on_link = coupling.T
    (*rubs, of_spring, offset, leans), first, slope = numbers
    viscous, dry = (on_link * x for x in rubs)
    critical = 2.0 * jnp.sqrt(k * jnp.mean(signals[1]))
    d, drawn = ratio * critical, jnp.where(gap == 0.0, of_spring, OBSERVED) * critical
    half, h, constant = 0.5 * gap, period / substeps, pulled * offset

    def of_side(motor, link):
        return motor + on_link * (link - motor)

    def substep(state, x):
        delta, rate, _ = state
        needed, m, c, kq, speed, *ds = x
        n = needed - constant
        tooth = jnp.sign(delta)
        force = k * (delta - tooth * half) + d * rate
        touching = (half == 0.0) | ((jnp.abs(delta) > half) & (force * tooth >= 0.0))
        kt = jnp.where(touching, k, 0.0) + kq
        ct = jnp.where(touching, d + drawn, 0.0) + c + viscous
        pull = jnp.where(touching, k * tooth * half + drawn * of_side(*ds) / k, 0.0)
        left = m / h + 0.5 * ct + 0.25 * kt * h
        free = n + viscous * speed + pull + rate * (m / h - 0.5 * ct - 0.25 * kt * h) - kt * delta
        # What would hold the link still, as far as dry friction reaches.
        rub = jnp.clip(left * speed - free, -dry, dry)
        new = (free + rub) / left
        return (delta + 0.5 * h * (rate + new), new, rub), None

    def sample(state, x):
        before, after = x
        weights = (jnp.arange(substeps) + 0.5) / substeps
        inner = before + weights[:, None] * (after - before)
        state, _ = jax.lax.scan(substep, state, inner)
        return state, (state[0], state[2])

    # A log may begin in the middle of a motion.
    start = (of_side(*first) + (1.0 - pulled) * offset) / k + leans * half
    begun = (start, of_side(*slope) / k, dry * jnp.sign(signals[4, 0]))
    pairs = (signals.T[:-1], signals.T[1:])
    _, path = jax.lax.scan(sample, begun, pairs)
    whole = [jnp.concatenate([a[None], b]) for a, b in zip((begun[0], begun[2]), path, strict=True)]
    return jnp.stack(whole, axis=-1).swapaxes(0, 1)
