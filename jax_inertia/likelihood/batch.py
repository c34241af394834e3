"""Many logs of position-controlled robots at once: motion, columns, response and fit as one program (`jit`, `vmap`).

No simulator is asked: along the measured motion the torque that a model lacks is e = needed(q, q̇, q̈) − τ_loop, and
G e is what its replay errs by, to first order; so

    G e = G E θ + noise,     ln p(set) = ½ bᵀ C b − ½ ln det(1 + S H S)        (`evidence`)

with G at the numbers of the round before. Ordinary numbers are given up one after the other while evidence grows.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jax_inertia.dynamics import rigid_body
from jax_inertia.likelihood import linearised, motion
from jax_inertia.likelihood.columns import ALL, Number, Seen, columns
from jax_inertia.likelihood.drive import FAMILIES, Drive, DriveNumbers
from jax_inertia.likelihood.linearised import Joints
from jax_inertia.likelihood.motion import Along, Grid, Moments, Targets
from jax_inertia.likelihood.response import Loop, response
from jax_inertia.logs.log import AnyArray
from jax_inertia.maths.precision import in_full_precision
from jax_inertia.model.robot import Robot

ROUNDS = 4
_PAD = 32
"""Samples by which a log is continued at its ends for the low-pass, turned about them."""


class Logs(NamedTuple):
    """Logs of equal length, B of them; times start at 0 s."""

    q: Float[AnyArray, "B T n"]
    """Positions at even stamps [rad]."""
    target: Float[AnyArray, "B S n"]
    """Each held from its stamp to the next [rad]."""
    kp: Float[AnyArray, "B n"]
    kd: Float[AnyArray, "B n"]


class Fitted(NamedTuple):
    """Numbers of every log (B, P); those that were given up are 0."""

    theta: Float[Array, "B P"]
    deviation: Float[Array, "B P"]
    """Posterior standard deviation."""
    there: Bool[Array, "B P"]
    gain: Float[Array, "B P"]
    """What evidence loses without each number that is there [nats]."""
    before: Float[Array, "B n"]
    """Rms of G e: what replays of the model err by, to first order [rad]."""
    after: Float[Array, "B n"]
    """Rms of what the numbers leave of it [rad]."""


class Settings(NamedTuple):
    """What logs of one call have in common."""

    joints: Joints
    numbers: tuple[Number, ...]
    grid: Grid
    stamps: Float[AnyArray, " S"]
    """Of the targets [s]."""
    floor: float
    """Least rms of noise [rad]."""
    settles: float
    """Of the start, what does not count [s]."""


def fitted(
    robot: Robot,
    logs: Logs,
    *,
    period: float,
    stamps: Float[AnyArray, " S"],
    joints: Joints,
    numbers: Sequence[Number],
    stiffest: float,
    floor: float = 1e-4,
    settles: float = 0.3,
) -> Fitted:
    """The numbers of every log, of one robot or of one each (leaves with a leading axis).

    `period`: of positions [s]; `stiffest`: largest natural frequency of the loops [rad/s], which sets the step.
    Computed in the dtype of `logs`: float32 on a GPU, float64 to compare. Compiled once per robot and shape.
    """
    steps = motion.steps_of(period, logs.q.shape[1], stiffest)
    settings = Settings(joints, tuple(numbers), steps, jnp.asarray(stamps), floor, settles)
    return _all(
        robot, logs, _as(settings, logs.q.dtype), settings.numbers, steps.every, steps.steps
    )


def ordinary(
    robot: Robot,
    joints: Joints,
    kp: Float[AnyArray, " n"],
    kd: Float[AnyArray, " n"],
    q: Float[AnyArray, "T n"],
) -> tuple[Number, ...]:
    """What any robot's model may be off by: five numbers a joint, the targets' delay and the loop's clock.

    Prior deviations are of a size with the robot: inertia at the posture where a log `q` begins, damping up to half of
    critical, and dry friction that would hold a joint 20 mrad from its target.
    """
    zero = jnp.zeros(len(joints.dofs))
    mass = linearised.linearised((robot, joints), (jnp.asarray(q[0]), zero, zero)).mass
    inertia, out = np.diagonal(np.asarray(mass)), []
    rows = np.array(joints.dofs)
    own = [np.asarray(x)[rows] for x in (robot.armature, robot.damping, robot.frictionloss)]
    for j, (m, p, d) in enumerate(zip(inertia, kp, kd, strict=True)):
        critical = max(float(d), 0.5 * float(np.sqrt(p * m)))
        out += [
            Number("armature", j, sd=0.5 * float(m), low=-float(own[0][j] + 0.1 * m)),
            Number("viscous_friction", j, sd=critical, low=-float(own[1][j] + 0.5 * d)),
            Number("coulomb_friction", j, sd=0.02 * float(p), low=-float(own[2][j])),
            Number("encoder_offset", j, sd=0.05),
            Number("kp_scale", j, sd=0.3, low=-0.95),
        ]
    delay = Number("target_delay", sd=0.02, low=-0.02, high=0.3)
    return (*out, delay, Number("loop_hold", sd=1e-3, low=0.0, high=8e-3))


def _as(settings: Settings, dtype) -> tuple[Joints, Array, Array, Array, Array]:
    """The part that is traced."""
    joints = jax.tree.map(lambda x: jnp.asarray(x, dtype), settings.joints)
    rest = settings.grid.step, settings.stamps, settings.floor, settings.settles
    step, stamps, floor, settles = (jnp.asarray(x, dtype) for x in rest)
    return joints, step, stamps, floor, settles


@partial(jax.jit, static_argnames=("numbers", "every", "steps"))
@in_full_precision
def _all(robot, logs: Logs, shared, numbers, every: int, steps: int) -> Fitted:
    own = 0 if jnp.ndim(robot.pi) == 3 else None
    dtype = logs.q.dtype
    robot = jax.tree.map(lambda x: jnp.asarray(x, dtype), robot)
    one = partial(_one, shared=shared, numbers=numbers, every=every, steps=steps)
    return jax.vmap(one, (own, 0))(robot, logs)


def _one(robot: Robot, log: Logs, *, shared, numbers, every: int, steps: int) -> Fitted:
    joints, step, stamps, floor, settles = shared
    edges = jnp.append(stamps, 2.0 * stamps[-1] - stamps[-2])
    area = jnp.cumsum(log.target * jnp.diff(edges)[:, None], axis=0)
    targets = Targets(edges, jnp.concatenate([jnp.zeros_like(area[:1]), area]))
    start = step * jnp.arange(steps, dtype=log.q.dtype)
    moments = smoothed(jnp.asarray(log.q), step, every)
    drive = Drive(log.kp, log.kd, targets, jnp.zeros_like(moments.q), start, step)
    rigid = _rigid(robot, joints, moments)
    times = step * every * jnp.arange(1, log.q.shape[0])
    counts = (times >= settles).astype(log.q.dtype)
    late = [k for k, x in enumerate(numbers) if x.family == "target_delay"]

    def round_(theta: Array, _):
        seen, loop, lacking = _about(robot, joints, drive, moments, rigid, numbers, theta)
        own = columns(numbers, seen)
        # The law is linear in all but delays, which are measured from where it was linearised.
        lacking = lacking + own[:, :, late] @ theta[jnp.array(late, int)]
        torque = jnp.concatenate([own, lacking[:, :, None]], axis=2)
        moved = response(loop, torque, step, every) * counts[:, None, None]
        out = _solved(numbers, moved[:, :, :-1], moved[:, :, -1], counts, floor)
        return out.theta, out

    start = jnp.zeros(len(numbers), log.q.dtype)
    rounds = jax.lax.scan(round_, start, None, ROUNDS)[1]
    last = jax.tree.map(lambda x: x[-1], rounds)
    return last._replace(before=rounds.before[0])


def smoothed(q: Float[Array, "T n"], step: Array, every: int) -> Moments:
    """The motion at the steps' middles, below `motion.BAND`: a zero-phase Butterworth low-pass in frequency."""
    count = q.shape[0]
    ends = 2.0 * q[:1] - q[1 : _PAD + 1][::-1], 2.0 * q[-1:] - q[-_PAD - 1 : -1][::-1]
    wide = jnp.concatenate([ends[0], q, ends[1]])
    # A line through both ends is taken out, so that the period of a Fourier series has no jump.
    line = jnp.linspace(0.0, 1.0, len(wide), dtype=q.dtype)[:, None]
    slope = (wide[-1] - wide[0])[None]
    spectrum = jnp.fft.rfft(wide - wide[:1] - line * slope, axis=0)
    period = step * every
    frequency = (jnp.arange(len(spectrum)) / (len(wide) * period))[:, None]
    shift = jnp.exp(1j * jnp.pi * frequency * step)
    low = spectrum * shift / (1.0 + (frequency / motion.BAND) ** 4)
    turn = 2j * jnp.pi * frequency
    rise = slope / ((len(wide) - 1) * period)
    at = _PAD * every + np.arange(every * (count - 1))
    base = wide[:1] + slope * line[0] + rise * ((at + 0.5) * step)[:, None]
    fine = (
        jnp.fft.irfft(x, len(wide) * every, axis=0)[at] * every
        for x in (low, low * turn, low * turn**2)
    )
    x, v, a = (y.astype(q.dtype) for y in fine)
    v = v + rise
    still = jnp.full(q.shape[1], motion.STILL, q.dtype)
    return Moments(base + x, v, a, motion.side_of(v, still), (jnp.abs(v) < still).astype(q.dtype))


class _Rigid(NamedTuple):
    """What a robot's bodies make of a motion."""

    own: linearised.Matrices
    needed: Float[Array, "K n"]
    regressor: Float[Array, "K nv nb 10"]


def _rigid(robot: Robot, joints: Joints, moments: Moments) -> _Rigid:
    motions = jnp.asarray(moments.q), jnp.asarray(moments.v), jnp.asarray(moments.a)
    own = jax.vmap(partial(linearised.linearised, (robot, joints)))(motions)
    needed = jax.vmap(partial(linearised.needed, robot, joints))(*motions)
    full = joints.whole(moments.q), joints.rates(moments.v), joints.rates(moments.a)
    return _Rigid(own, needed, jax.vmap(partial(rigid_body.torque_regressor, robot))(*full))


def _about(
    robot: Robot,
    joints: Joints,
    drive: Drive,
    moments: Moments,
    rigid: _Rigid,
    numbers: tuple[Number, ...],
    theta: Array,
) -> tuple[Seen, Loop, Array]:
    """What columns read, the loop at some numbers, and the torque that the model lacks at their delay (K, n)."""
    rows, n = np.array(joints.dofs), moments.q.shape[1]

    def of(family: str) -> Array:
        out = jnp.zeros(n, theta.dtype)
        for number, value in zip(numbers, theta, strict=True):
            if number.family == family:
                out = out.at[... if number.joint == ALL else number.joint].add(value)
        return out

    none = {family: jnp.zeros(n, theta.dtype) for family in FAMILIES}
    limit = jnp.full(n, jnp.inf, theta.dtype)
    x = DriveNumbers(**none | {"target_delay": of("target_delay"), "torque_saturation": limit})
    rub = drive.torque(x, moments) - rigid.needed
    level = robot.frictionloss[rows]
    resting = motion.balanced(moments, rub, level)
    dry = jnp.where(
        jnp.asarray(moments.still) > 0, jnp.clip(rub, -level, level), level * moments.side
    )
    v, a, side = (joints.rates(y) for y in (moments.v, moments.a, resting.side))
    along = Along(robot, drive.start, v, a, side, rigid.regressor)
    seen = Seen(along, drive.columns(x, moments), rigid.own.stiffness, joints.dofs)
    gain, clock, diagonal = 1.0 + of("torque_gain"), of("loop_hold"), jnp.eye(n, dtype=theta.dtype)
    kp, kd = gain * drive.kp * (1.0 + of("kp_scale")), gain * drive.kd * (1.0 + of("kd_scale"))
    loop = Loop(
        rigid.own.mass + diagonal * (of("armature") - clock * kd),
        rigid.own.damping + diagonal * (of("viscous_friction") + kd - clock * kp),
        rigid.own.stiffness + diagonal * kp,
        resting.still,
    )
    return seen, loop, dry - rub


def _solved(numbers, columns: Array, target: Array, counts: Array, floor: Array) -> Fitted:
    """Numbers, by evidence, of a target (T, n) that columns (T, n, P) explain."""

    def of(field: str) -> Array:
        return jnp.asarray([getattr(x, field) for x in numbers], target.dtype)

    sd, low, high, odds = of("sd"), of("low"), of("high"), of("odds")
    fixed = np.array([x.always for x in numbers])
    total = jnp.sum(counts)
    information = jnp.einsum("tjp,tjq->jpq", columns, columns) * sd * sd[:, None]
    pull = jnp.einsum("tjp,tj->jp", columns, target) * sd
    eye = jnp.eye(len(numbers), dtype=target.dtype)

    def weights(z: Array) -> tuple[Array, Array]:
        left = target - columns @ (z * sd)
        sigma = jnp.maximum(jnp.sqrt(jnp.sum(left**2, axis=0) / total), floor)
        return 1.0 / (sigma**2 * jax.vmap(_correlation_time, 1)(left)), sigma

    def inverse(h: Array, there: Array) -> Array:
        return jnp.linalg.inv(there[:, None] * h * there + eye)

    def one_less(state: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        h, b, there, _ = state
        c = inverse(h, there)
        z = c @ (b * there)
        size = jnp.diagonal(c)
        loss = 0.5 * z**2 / size + 0.5 * jnp.log(size) + odds
        loss = loss + jnp.where((there > 0) & ~jnp.asarray(fixed), jnp.zeros(()), jnp.inf)
        k = jnp.argmin(loss)
        goes = loss[k] < 0.0
        return h, b, jnp.where(goes & (jnp.arange(len(there)) == k), 0.0, there), goes

    z, there = jnp.zeros_like(sd), jnp.ones_like(sd)
    w = weights(z)[0]
    for _ in range(2):
        h, b = jnp.tensordot(w, information, 1), w @ pull
        z = jnp.clip(inverse(h, there) @ b, low / sd, high / sd)
        w = weights(z)[0]
    h, b = jnp.tensordot(w, information, 1), w @ pull
    there = jax.lax.while_loop(lambda s: s[3], one_less, (h, b, there, jnp.array(True)))[2]
    c = inverse(h, there)
    z = jnp.clip(c @ (b * there), low / sd, high / sd) * there
    size = jnp.diagonal(c)
    gain = (0.5 * z**2 / size + 0.5 * jnp.log(size) + odds) * there
    rms = jnp.sqrt(jnp.sum(target**2, axis=0) / total)
    return Fitted(z * sd, jnp.sqrt(size) * sd * there, there > 0, gain, rms, weights(z)[1])


def _correlation_time(x: Float[Array, " T"]) -> Array:
    """`maths.sample_weight.autocorrelation_time`, traced."""
    n = x.shape[0]
    x = x - jnp.mean(x)
    rho = jnp.fft.irfft(jnp.abs(jnp.fft.rfft(x, 2 * n)) ** 2)[: n // 2]
    rho = rho / jnp.maximum(rho[0], jnp.finfo(x.dtype).tiny)
    positive = jnp.cumprod(jnp.where(rho > 0, 1.0, 0.0))
    return jnp.maximum(2.0 * jnp.sum(rho * positive) - 1.0, 1.0).astype(x.dtype)
