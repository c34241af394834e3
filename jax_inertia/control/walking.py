"""Walking by the divergent component of motion ξ = c + ċ/ω, replanned every tick, branch-free.

ξ̇ = ω (ξ − p) runs away from the zero-moment point p (Englsberger et al. 2015). The plan puts p under the stance foot
in single support and moves it in a straight line in double support; running the equation backwards over the next
three steps gives ξ_ref now. Feedback p = p_ref + (1 + k/ω)(ξ − ξ_ref), clipped to the soles, sets the centre of
mass's acceleration ω² (c − p). Only the error that the clipped p cannot remove before touchdown moves the next step.

The ground is flat boxes on a grid, known or not. A robot that does not know it takes the next step to be as high as its
last ones were, a mean that forgets (`level_share`): heights about a plane differ from it by half the variance by which
they differ from one another.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jax_inertia.control.terms import Terms
from jax_inertia.control.whole_body import LEFT, RIGHT, Reference

GRAVITY = 9.81
_SIGNS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
_NEARBY = np.array([[0.02 * i, 0.03 * j] for i in range(-6, 7) for j in (-1, 0, 1)])  # m


class Ground(eqx.Module):
    """Boxes of side `cell` [m]: `height` [m] by cell, cell (0, 0) with its low corner at `corner`; 0 outside."""

    height: Float[Array, "nx ny"]
    corner: Float[Array, "2"]
    cell: Float[Array, ""]

    def at(self, xy: Float[Array, "*b 2"]) -> Float[Array, "*b"]:
        """Height under each point [m]."""
        nx, ny = self.height.shape
        i = jnp.floor((xy - self.corner) / self.cell).astype(int)
        inside = (i >= 0).all(-1) & (i[..., 0] < nx) & (i[..., 1] < ny)
        value = self.height[jnp.clip(i[..., 0], 0, nx - 1), jnp.clip(i[..., 1], 0, ny - 1)]
        return jnp.where(inside, value, 0.0)


class Walk(eqx.Module):
    """How to walk; all figures may differ from robot to robot in a batch."""

    ground: Ground
    posture: Float[Array, " nu"]
    """Joint angles for what no other task needs [rad]."""
    start: Float[Array, ""]
    """When to begin [s]; before that the robot stands."""
    step: Float[Array, ""]
    """Length of a step [m]; 0 walks in place."""
    knows_ground: Float[Array, ""]
    half_width: Float[Array, ""]
    """Half the distance between the feet [m]."""
    pelvis_height: Float[Array, ""]
    """Of the pelvis over the soles [m]."""
    sole_centre: Float[Array, ""]
    """x of the sole's centre in the foot's frame [m]."""
    sole_depth: Float[Array, ""]
    sole_half: Float[Array, "2"]
    """Half length and half width of the sole that p is clipped to [m]."""
    single: Float[Array, ""]
    double: Float[Array, ""]
    apex: Float[Array, ""]
    """Height of the swing over the highest ground on its way [m]."""
    landing_speed: Float[Array, ""]
    """Downward speed with which a foot meets the ground, and goes on looking for it [m/s]."""
    feedback: Float[Array, ""]
    """k, in 1/s."""
    height_rate: Float[Array, ""]
    """Of the critically damped filter from support height to pelvis height [rad/s]."""
    touchdown_force: Float[Array, ""]
    """Vertical force by which a foot is taken to have landed [N]."""
    level_share: Float[Array, ""]
    """How much of what unknown ground is expected to be comes from the last foothold, 0 to 1."""


class Plan(eqx.Module):
    """Where in its step a robot is."""

    single: Float[Array, ""]
    """1 in single support, 0 in double support."""
    time: Float[Array, ""]
    """Since the phase began [s]."""
    double: Float[Array, ""]
    """How long this double support lasts [s]."""
    stance: Float[Array, ""]
    """The foot that carries, or will: 0 left, 1 right."""
    lifted: Float[Array, "3"]
    """Where the swing foot left the ground."""
    target: Float[Array, "3"]
    """Where it is to land."""
    zmp: Float[Array, "2"]
    """p at the start of this double support."""
    height: Float[Array, "2"]
    """Pelvis height's reference and its velocity."""
    steps: Float[Array, ""]
    level: Float[Array, ""]
    """Mean height of the footholds so far [m], the last counting most."""


def begin(walk: Walk, height: Float[Array, ""] | float) -> Plan:
    """Standing with both feet at x = 0, the pelvis at `height` [m]; the first step is the left foot's."""
    zero = jnp.zeros(())
    return Plan(
        single=zero,
        time=zero,
        double=jnp.asarray(0.8),
        stance=jnp.asarray(1.0),
        lifted=jnp.zeros(3),
        target=jnp.zeros(3),
        zmp=jnp.stack([walk.sole_centre, zero]),
        height=jnp.stack([jnp.asarray(height), zero]),
        steps=zero,
        level=zero,
    )


def walking(
    walk: Walk,
    plan: Plan,
    now: Terms,
    foot_force: Float[Array, "2"],
    time: Float[Array, ""],
    dt: float,
) -> tuple[Plan, Reference]:
    """One tick: `foot_force` are the measured vertical forces [N], `time` the run's."""
    feet = now.position[jnp.array([LEFT, RIGHT])]
    plan = _advance(walk, plan, feet, foot_force, time, dt)
    right = plan.stance > 0.5
    stance, swing = _pick(right, feet)
    centre = jnp.stack([walk.sole_centre, 0.0 * walk.sole_centre])

    ground = jnp.minimum(stance[2] - walk.sole_depth, walk.ground.height.max() + 0.1)
    height = jnp.maximum(now.com[2] - ground, 0.5)
    omega = jnp.sqrt(GRAVITY / height)
    dcm = now.com[:2] + now.com_velocity[:2] / omega
    side = jnp.where(right, 1.0, -1.0)  # the swing foot is on this side

    nominal = _next_step(walk, stance, side)
    steps = _sequence(walk, stance, nominal, side) + centre
    end = _dcm_at_lift_off(walk, steps, omega)
    single = plan.single > 0.5
    left = jnp.maximum(jnp.where(single, walk.single, plan.double) - plan.time, 0.0)
    p_ref, dcm_ref = _reference_now(walk, plan, steps[0], end, omega, left)
    p_ref = jnp.where(time < walk.start, plan.zmp, p_ref)
    error = dcm - jnp.where(time < walk.start, plan.zmp, dcm_ref)

    lower, upper = _support(walk, single, stance, swing, centre)
    p = jnp.clip(p_ref + (1.0 + walk.feedback / omega) * error, lower, upper)
    push = omega**2 * (now.com[:2] - p)

    # What p, at the edge of the sole from now on, leaves of the error at touchdown.
    removable = 1.0 - jnp.exp(-omega * left)
    room_low, room_high = (lower - p_ref) * removable, (upper - p_ref) * removable
    beyond = (error - jnp.clip(error, room_low, room_high)) * jnp.exp(omega * left)
    target = _target(walk, plan, nominal, stance, jnp.clip(beyond, -0.15, 0.15), dt)

    foot = _swing(walk, plan, target)
    # Rising before the rear foot has left the ground would stretch its leg.
    lowest = jnp.where(single, target[2], swing[2]) - walk.sole_depth
    support = jnp.where(time < walk.start, ground, jnp.minimum(ground, lowest))
    goal = support + walk.pelvis_height
    rate = walk.height_rate
    up = rate**2 * (goal - plan.height[0]) - 2.0 * rate * plan.height[1]
    speed = plan.height[1] + dt * up
    filtered = jnp.stack([plan.height[0] + dt * speed, speed])
    on_feet, carried = _load_of_feet(walk, plan, time)
    reference = Reference(
        com_acceleration=push,
        height=jnp.concatenate([filtered, up[None]]),
        heading=jnp.zeros(()),
        foot=jnp.stack([foot, foot]),
        foot_heading=jnp.zeros(2),
        contact=jnp.repeat(carried, 4),
        stance=on_feet,
        posture=jnp.stack([walk.posture, 0.0 * walk.posture, 0.0 * walk.posture]),
    )
    return eqx.tree_at(lambda s: (s.target, s.height), plan, (target, filtered)), reference


def _target(
    walk: Walk,
    plan: Plan,
    nominal: Float[Array, "3"],
    stance: Float[Array, "3"],
    shift: Float[Array, "2"],
    dt: float,
) -> Float[Array, "3"]:
    """Where the swing foot is to come down: the planned step, moved by `shift` and kept to what can be reached."""
    single = plan.single > 0.5
    side = jnp.where(plan.stance > 0.5, 1.0, -1.0)
    wanted = nominal[:2] + jnp.where(single, shift, 0.0)
    apart = jnp.maximum(side * (wanted[1] - stance[1]), 0.8 * 2.0 * walk.half_width)
    wanted = jnp.stack([wanted[0], stance[1] + side * apart])
    wanted = _foothold(walk, wanted)
    target = jnp.concatenate([wanted, _level(walk, wanted, plan)[None] + walk.sole_depth])
    settle = jnp.where(single & (plan.time > 0.85 * walk.single), 0.0, 0.15)
    target = plan.target + jnp.where(plan.time < 2 * dt, 1.0, settle) * (target - plan.target)
    return jnp.where(single, target, jnp.concatenate([nominal[:2], target[2:]]))


def _load_of_feet(
    walk: Walk, plan: Plan, time: Float[Array, ""]
) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
    """Whether the left and the right foot stand, and what share of its load each may carry."""
    single, right = plan.single > 0.5, plan.stance > 0.5
    on_left = jnp.where(single & right, 0.0, 1.0)
    on_right = jnp.where(single & ~right, 0.0, 1.0)
    # In double support the new foot takes over gradually.
    share = jnp.clip(plan.time / plan.double, 0.0, 1.0)
    fresh = jnp.where(single | (time < walk.start), 1.0, jnp.clip(0.1 + 1.8 * share, 0.1, 1.0))
    fading = jnp.where(single | (time < walk.start), 1.0, jnp.clip(1.9 - 1.8 * share, 0.1, 1.0))
    carried = on_left * jnp.where(right, fading, fresh), on_right * jnp.where(right, fresh, fading)
    return jnp.stack([on_left, on_right]), jnp.stack(carried)


def _advance(
    walk: Walk,
    plan: Plan,
    feet: Float[Array, "2 3"],
    force: Float[Array, "2"],
    time: Float[Array, ""],
    dt: float,
) -> Plan:
    """Time passes; lift-off at the end of double support, touchdown by force after 60 % of the swing."""
    standing = time < walk.start
    elapsed = jnp.where(standing, 0.0, plan.time + dt)
    single, right = plan.single > 0.5, plan.stance > 0.5
    stance, swing = _pick(right, feet)
    swing_force = jnp.where(right, force[0], force[1])
    landed = (elapsed > 0.6 * walk.single) & (swing_force > walk.touchdown_force)
    touchdown = single & (landed | (elapsed > 1.4 * walk.single))
    lift_off = ~single & ~standing & (elapsed >= plan.double)
    changed = touchdown | lift_off
    centre = jnp.stack([walk.sole_centre, 0.0 * walk.sole_centre])
    return Plan(
        single=jnp.where(lift_off, 1.0, jnp.where(touchdown, 0.0, plan.single)),
        time=jnp.where(changed, 0.0, elapsed),
        double=jnp.where(touchdown, walk.double, plan.double),
        stance=jnp.where(touchdown, 1.0 - plan.stance, plan.stance),
        lifted=jnp.where(lift_off, swing, plan.lifted),
        target=plan.target,
        zmp=jnp.where(touchdown, stance[:2] + centre, plan.zmp),
        height=plan.height,
        steps=plan.steps + touchdown,
        level=plan.level
        + jnp.where(lift_off, walk.level_share, 0.0) * (stance[2] - walk.sole_depth - plan.level),
    )


def _pick(right: Array, feet: Float[Array, "2 3"]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """(stance, swing) of (left, right)."""
    return jnp.where(right, feet[1], feet[0]), jnp.where(right, feet[0], feet[1])


def _next_step(walk: Walk, stance: Float[Array, "3"], side: Float[Array, ""]) -> Float[Array, "3"]:
    """A step ahead of the stance foot, on the other foot's lane."""
    return jnp.stack([stance[0] + walk.step, side * walk.half_width, stance[2]])


def _sequence(
    walk: Walk, stance: Float[Array, "3"], first: Float[Array, "3"], side: Float[Array, ""]
) -> Float[Array, "4 2"]:
    """The stance foot and the next three steps."""
    ahead = jnp.stack([walk.step, 0.0 * walk.step])
    across = jnp.stack([0.0 * side, 2.0 * side * walk.half_width])
    one = first[:2]
    return jnp.stack([stance[:2], one, one + ahead - across, one + 2.0 * ahead])


def _dcm_at_lift_off(
    walk: Walk, steps: Float[Array, "4 2"], omega: Float[Array, ""]
) -> Float[Array, "2"]:
    """ξ at the end of single support on steps[0], backwards from rest over steps[3]."""
    dcm = steps[3]
    for k in (2, 1, 0):
        dcm = _before_shift(steps[k], steps[k + 1], dcm, walk.double, omega)
        if k:
            dcm = steps[k] + jnp.exp(-omega * walk.single) * (dcm - steps[k])
    return dcm


def _before_shift(
    a: Float[Array, "2"],
    b: Float[Array, "2"],
    end: Float[Array, "2"],
    duration: Float[Array, ""],
    omega: Float[Array, ""],
) -> Float[Array, "2"]:
    """ξ before p moves from a to b in `duration`, given ξ after: ξ = p + ṗ/ω + C e^{ωt}."""
    lead = (b - a) / jnp.maximum(duration, 1e-3) / omega
    return a + lead + jnp.exp(-omega * duration) * (end - b - lead)


def _reference_now(
    walk: Walk,
    plan: Plan,
    stance: Float[Array, "2"],
    end: Float[Array, "2"],
    omega: Float[Array, ""],
    left: Float[Array, ""],
) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
    """(p_ref, ξ_ref) with `left` seconds to the end of the phase."""
    in_single = stance + jnp.exp(-omega * left) * (end - stance)
    share = jnp.clip(1.0 - left / plan.double, 0.0, 1.0)
    p = plan.zmp + share * (stance - plan.zmp)
    lift_off = stance + jnp.exp(-omega * walk.single) * (end - stance)
    rate = (stance - plan.zmp) / plan.double / omega
    in_double = p + rate + jnp.exp(-omega * left) * (lift_off - stance - rate)
    single = plan.single > 0.5
    return jnp.where(single, stance, p), jnp.where(single, in_single, in_double)


def _support(
    walk: Walk,
    single: Array,
    stance: Float[Array, "3"],
    swing: Float[Array, "3"],
    centre: Float[Array, "2"],
) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
    """Box that p is kept in: the sole's, or that around both soles."""
    a, b = stance[:2] + centre, jnp.where(single, stance[:2], swing[:2]) + centre
    return jnp.minimum(a, b) - walk.sole_half, jnp.maximum(a, b) + walk.sole_half


def _foothold(walk: Walk, wanted: Float[Array, "2"]) -> Float[Array, "2"]:
    """The nearest place where the sole, and a little around it, would lie on one box; `wanted` on unknown ground."""
    offsets = jnp.asarray(_NEARBY)
    places = wanted + jnp.stack([walk.sole_centre, 0.0 * walk.sole_centre]) + offsets
    corners = places[:, None] + (walk.sole_half + 0.03) * _SIGNS
    height = walk.ground.at(corners)
    spread = jnp.max(height, axis=1) - jnp.min(height, axis=1)
    best = jnp.argmin(spread + 0.15 * jnp.sqrt(jnp.sum(offsets**2, axis=1)))
    return wanted + jnp.where(walk.knows_ground > 0.5, offsets[best], 0.0)


def _level(walk: Walk, foot: Float[Array, "2"], plan: Plan) -> Float[Array, ""]:
    """Height that a foot there would stand on: the highest under its sole, or what the last footholds had."""
    centre = foot + jnp.stack([walk.sole_centre, 0.0 * walk.sole_centre])
    known = jnp.max(walk.ground.at(centre + walk.sole_half * _SIGNS))
    return jnp.where(walk.knows_ground > 0.5, known, plan.level)


def _swing(walk: Walk, plan: Plan, target: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Position, velocity and acceleration of the foot in the air."""
    t, start = plan.time, plan.lifted
    way = (target - start)[:2]
    across = _quintic(t / (0.92 * walk.single), 0.92 * walk.single, way, 0.0 * way)
    path = start[:2] + jnp.linspace(0.0, 1.0, 7)[:, None, None] * way
    sole = jnp.stack([walk.sole_centre, 0.0 * walk.sole_centre]) + walk.sole_half * _SIGNS
    highest = jnp.max(walk.ground.at(path + sole)) + walk.sole_depth
    highest = jnp.where(walk.knows_ground > 0.5, highest, -jnp.inf)
    top = jnp.maximum(jnp.maximum(start[2], target[2]), highest) + walk.apex
    half = 0.5 * walk.single
    rise = _quintic(t / half, half, top - start[2], jnp.zeros(()))
    fall = _quintic(t / half - 1.0, half, target[2] - top, -walk.landing_speed)
    height = jnp.where(t < half, rise, fall) + jnp.zeros(3).at[0].set(
        jnp.where(t < half, start[2], top)
    )
    # Ground that is not where it was expected is looked for at the landing speed.
    late = jnp.maximum(t - walk.single, 0.0)
    height = height - walk.landing_speed * late * jnp.zeros(3).at[0].set(1.0)
    across = across + jnp.zeros((3, 2)).at[0].set(start[:2])
    return jnp.concatenate([across, height[:, None]], axis=1)


def _quintic(
    share: Float[Array, ""],
    duration: Float[Array, ""],
    way: Float[Array, "*n"],
    final_speed: Float[Array, "*n"],
) -> Float[Array, "3 *n"]:
    """Way gone, speed and acceleration of a polynomial from rest to `way` at `final_speed`, both ends unaccelerated."""
    s = jnp.clip(share, 0.0, 1.0)
    v = final_speed * duration
    a, b, c = 10.0 * way - 4.0 * v, -15.0 * way + 7.0 * v, 6.0 * way - 3.0 * v
    return jnp.stack(
        [
            s**3 * (a + s * (b + s * c)),
            s**2 * (3.0 * a + s * (4.0 * b + s * 5.0 * c)) / duration,
            s * (6.0 * a + s * (12.0 * b + s * 20.0 * c)) / duration**2,
        ]
    )
