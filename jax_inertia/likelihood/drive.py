"""The position loop of a joint as a law of its numbers, and torque columns as derivatives of it.

    τ = g (clip(kp (1 + κ) dz(q*(t − d) − q + c q̇; w₀) − kd (1 + λ) (q̇ − c q̈) + τ_fed + b + e q̇, ± L) − e q̇)

q* may be behind a first-order lag, and τ behind another one; dz is 0 within ± w₀ and goes on from there. e is stall
torque over no-load speed: a limit that falls with speed.

A loop that samples and holds acts on the past of its own joint: late by c (half its period, and what it computes), it
has kp c less damping and kd c less inertia. c is one number of the whole robot, its clock. A simulation in steps of its
own adds kd times half a step to its inertia, or takes it where the integrator takes kd explicitly; what the robot does
not have of it, and has less by a velocity that is older than its position, is another number w: kd w of inertia goes.
"""

import dataclasses
from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import signal

from jax_inertia.likelihood.motion import Grid, Moments, Run, Targets
from jax_inertia.logs.log import AnyArray


class DriveNumbers(eqx.Module):
    """Numbers of the law, one for each joint (n,), or derivatives by each (K, n).

    All are 0 where the model is right; the limit is infinite or as stated.
    """

    kp_scale: Float[AnyArray, "*K n"]
    """κ."""
    kd_scale: Float[AnyArray, "*K n"]
    """λ."""
    target_delay: Float[AnyArray, "*K n"]
    """d [s]."""
    loop_hold: Float[AnyArray, "*K n"]
    """c [s]."""
    own_steps: Float[AnyArray, "*K n"]
    """w [s]."""
    torque_bias: Float[AnyArray, "*K n"]
    """b [N m]."""
    torque_gain: Float[AnyArray, "*K n"]
    """g − 1."""
    torque_saturation: Float[AnyArray, "*K n"]
    """L [N m]."""
    torque_speed: Float[AnyArray, " n"] | None = None
    """e [N m s/rad]."""
    dead_band: Float[AnyArray, " n"] | None = None
    """w₀ [rad]."""
    target_lag: Float[AnyArray, " n"] | None = None
    """Time constant of the targets [s]."""
    actuator_lag: Float[AnyArray, " n"] | None = None
    """Time constant of the torque [s]."""


FINITE = "torque_saturation", "torque_speed", "dead_band", "target_lag", "actuator_lag"
"""Families that the torque is not linear in: their columns are differences of the law between a size and none."""
FAMILIES = tuple(x for x in DriveNumbers.__dataclass_fields__ if x not in FINITE)
"""Families whose columns are derivatives of the law."""


class Drive(eqx.Module):
    """A run's loop and what it acts on, at the steps of a grid: NumPy's of a log, traced in a batch."""

    kp: Float[AnyArray, " n"]
    kd: Float[AnyArray, " n"]
    targets: Targets
    fed: Float[AnyArray, "K n"]
    start: Float[AnyArray, " K"]
    """When each step begins [s]."""
    step: float | Array
    of_steps: float | Array = 1.0
    """Inertia that goes with w, of kd w; −1 where it comes."""

    def asked(self, x: DriveNumbers, motion: Moments) -> Float[AnyArray, "K n"]:
        """What the loop asks for, before its limit [N m]."""
        aim = self.targets.mean(self.start, self.step, x.target_delay)
        miss = _lagging(aim, x.target_lag, self.step) - motion.q + x.loop_hold * motion.v
        if x.dead_band is not None:
            miss = miss - miss.clip(-x.dead_band, x.dead_band)
        late = x.loop_hold + self.of_steps * x.own_steps
        damper = self.kd * (1.0 + x.kd_scale) * (motion.v - late * motion.a)
        asked = self.kp * (1.0 + x.kp_scale) * miss - damper + self.fed + x.torque_bias
        return asked if x.torque_speed is None else asked + x.torque_speed * motion.v

    def torque(self, x: DriveNumbers, motion: Moments) -> Float[AnyArray, "K n"]:
        """What the loop gives [N m]."""
        within = self.asked(x, motion).clip(-x.torque_saturation, x.torque_saturation)
        if x.torque_speed is not None:
            within = within - x.torque_speed * motion.v
        return (1.0 + x.torque_gain) * _lagging(within, x.actuator_lag, self.step)

    def columns(self, x: DriveNumbers, motion: Moments) -> Mapping[str, Float[AnyArray, "K n"]]:
        """∂τ/∂(each family's number), each joint by its own: its torque does not depend on others' numbers."""
        none = jax.tree.map(jnp.zeros_like, x)

        def one(family: str) -> Array:
            along = eqx.tree_at(lambda y: getattr(y, family), none, jnp.ones_like(x.kp_scale))
            return jax.jvp(lambda y: self.torque(y, motion), (x,), (along,))[1]

        return {family: one(family) for family in FAMILIES}

    def changed(
        self, x: DriveNumbers, motion: Moments, family: str, size: AnyArray, none: AnyArray
    ) -> Float[AnyArray, "K n"]:
        """What a family's numbers at some size change of the torque at `none` of them [N m]."""
        there, not_there = (dataclasses.replace(x, **{family: y}) for y in (size, none))
        return self.torque(there, motion) - self.torque(not_there, motion)

    def differences(self, x: DriveNumbers, motion: Moments) -> Mapping[str, Float[AnyArray, "K n"]]:
        """`columns` of a log, by differences to both sides: a program of NumPy has nothing to compile."""
        out = {}
        for family in FAMILIES:
            own = getattr(x, family)
            changed = self.changed(x, motion, family, own + _SMALL, own - _SMALL)
            out[family] = changed / (2.0 * _SMALL)
        return out

    def within(self, x: DriveNumbers, motion: Moments) -> Float[AnyArray, "K n"]:
        """1 where the loop is within its limit, so that it acts on its joint."""
        return (abs(self.asked(x, motion)) < x.torque_saturation).astype(motion.q.dtype)


_SMALL = 1e-5
"""Half of a difference [1, s, N m]; the law is linear in all but times."""


def _lagging(
    x: Float[AnyArray, "K n"], constant: Float[AnyArray, " n"] | None, step: float | Array
) -> Float[AnyArray, "K n"]:
    """Behind a first-order lag, y ← y + (1 − exp(−h/T)) (x − y), from rest at its first value; of logs alone."""
    if constant is None:
        return x
    out = np.array(x)
    for j in np.flatnonzero(np.asarray(constant) > 0):
        keep = np.exp(-step / constant[j])
        out[:, j] = signal.lfilter([1.0 - keep], [1.0, -keep], x[:, j], zi=[keep * x[0, j]])[0]
    return out


def drive_of(run: Run, grid: Grid) -> Drive:
    """Of a run."""
    edges = grid.edges
    stamps, none = run.commanded_time, np.zeros((grid.steps, run.q.shape[1]))
    fed = none
    if run.fed is not None:
        fed = Targets.of(stamps, run.fed).mean(edges[:-1], grid.step, np.zeros(run.q.shape[1]))
    targets = Targets.of(stamps, run.target)
    return Drive(run.kp, run.kd, targets, fed, edges[:-1], grid.step, run.of_steps)
