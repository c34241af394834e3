"""What a wrist's force/torque sensor carries: its mass, centre and inertia, with the sensor's offset and drift.

The sensor sits at a body's frame and feels what is beyond it. In that body's axes, with a the acceleration of the
frame's origin less gravity, ω and α the body's angular velocity and acceleration, the carried body needs

    f = m a + α × h + ω × (ω × h),        n = I α + ω × I ω + h × a        (h = m c, about the frame's origin),

which is linear in its ten parameters π. The sensor says the force on the robot, the opposite, and adds an offset b and
a drift d that grows with time: w = −Y π + b + d t. Joint torques are not needed.
"""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.dynamics.rigid_body import body_poses
from jax_inertia.estimation.batch_rows import correlation_inflation
from jax_inertia.estimation.priors import Load
from jax_inertia.logs.log import Log, LogError
from jax_inertia.maths.inertial_parameters import PI_NAMES, is_physical
from jax_inertia.maths.precision import in_double_precision
from jax_inertia.model.robot import Robot
from jax_inertia.signals.bands import of_estimate
from jax_inertia.signals.differences import central_differences
from jax_inertia.signals.filtering import low_pass, resample
from jax_inertia.signals.generalised_motion import generalised

AXES = ("fx", "fy", "fz", "mx", "my", "mz")
Z95 = 1.96
_ROUNDS = 4
# Offsets may be so many times what the sensor says [N, N m]; wide enough to be no prior at all.
_OFFSET = 10.0
# The load's interval over the prior's, and the encoders' noise over the motion (energies of the acceleration): from
# here on the log does not tell load and offset apart.
_UNTOLD, _SHAKES = 0.5, 0.1
# Another reading of the axes leaves less than this share of the energy that the plain one leaves.
_LEAVES = 1.0 / 9.0
# Residuals beyond so many times their noise, and this share of the signal, are something else than noise.
_TIMES, _SHARE = 5.0, 0.1


@dataclasses.dataclass(frozen=True)
class SensedLoad:
    """What the sensor at a body carries, in that body's axes about its frame's origin; σ are standard deviations."""

    body: str
    pi: Float[np.ndarray, " 10"]
    sigma_pi: Float[np.ndarray, " 10"]
    com: Float[np.ndarray, " 3"]
    sigma_com: Float[np.ndarray, " 3"]
    offset: Float[np.ndarray, " 6"]
    """At the middle of the log [N, N m]."""
    sigma_offset: Float[np.ndarray, " 6"]
    drift: Float[np.ndarray, " 6"]
    """Per second."""
    sigma_drift: Float[np.ndarray, " 6"]
    rms_before: Float[np.ndarray, " 6"]
    """Of what the sensor says about its mean."""
    rms_after: Float[np.ndarray, " 6"]
    modelled: float
    """Mass of the model's bodies from this one outward [kg]."""
    duration: float
    notes: tuple[str, ...]

    def to_report(self) -> dict[str, Any]:
        """JSON's own types; keys carry units."""

        def interval(value: float, sigma: float) -> dict[str, Any]:
            half = Z95 * float(sigma)
            return {"value": float(value), "ci95": [float(value) - half, float(value) + half]}

        def by_axis(value: np.ndarray, sigma: np.ndarray) -> dict[str, Any]:
            return {name: interval(*pair) for name, *pair in zip(AXES, value, sigma, strict=True)}

        mass = interval(self.pi[0], self.sigma_pi[0])
        return {
            "body": self.body,
            "carried": {
                "mass_kg": mass,
                "com_m": [interval(*x) for x in zip(self.com, self.sigma_com, strict=True)],
                "pi": dict(zip(PI_NAMES, map(float, self.pi), strict=True)),
                "pi_sigma": dict(zip(PI_NAMES, map(float, self.sigma_pi), strict=True)),
                "is_physical": bool(is_physical(jnp.asarray(self.pi))),
            },
            "model_mass_kg": self.modelled,
            "offset": by_axis(self.offset, self.sigma_offset),
            "drift_per_s": by_axis(self.drift, self.sigma_drift),
            "rms": {
                name: {"sensor": float(x), "left": float(y)}
                for name, x, y in zip(AXES, self.rms_before, self.rms_after, strict=True)
            },
            "notes": list(self.notes),
        }


@in_double_precision
def sensed_load(
    robot: Robot,
    log: Log,
    body: str,
    *,
    prior_mass: float | None = None,
    prior_reach: float = 0.2,
    cutoff: float | None = None,
    rate: float | None = None,
) -> SensedLoad:
    """What the force/torque sensor at `body` carries, from `log.contact_wrench` of that body; tau is not looked at.

    The prior is a load of `prior_mass` (default: the robot's mass) within `prior_reach` [m]; `cutoff` and `rate` are
    as in `estimate`. Raises ValueError for a body that the robot does not have, LogError for a log without that
    body's wrench, one of a floating base, and one that means other axes or the opposite sign.
    """
    index = robot.body_index(body)
    wrench, rows, time = _measured(robot, log, body, cutoff, rate)
    reach = robot.topology.body_dof[index]
    outward = np.all(robot.topology.body_dof >= reach, axis=1) & (np.arange(robot.nb) >= index)
    mass = float(np.sum(robot.pi[:, 0])) if prior_mass is None else prior_mass
    prior = np.asarray(Load(mass, prior_reach).sigma_pi())
    turned = rows.rotation
    fit = _Fit.of(rows.needed, wrench(turned), time, prior)
    axes = {"body": np.broadcast_to(np.eye(3), turned.shape), "world": turned @ turned}
    for name, turn in axes.items():
        _check_axes(fit, _Fit.of(rows.needed, wrench(turn), time, prior), name, body)
    pi, sigma = fit.value[:10], fit.sigma
    if pi[0] < -3.0 * sigma[0]:
        raise LogError(
            f"the wrench of {body!r} holds a mass of {pi[0]:.3g} kg: it is the robot's on what it carries, and the "
            "opposite is expected; give --flip-wrenches"
        )
    shaken = rows.shaken
    notes = tuple(_notes(fit, sigma[0] > _UNTOLD * prior[0] or shaken > _SHAKES))
    com = pi[1:4] / max(pi[0], 1e-9)
    # Of h / m, to first order.
    slope = np.hstack([-com[:, None], np.eye(3)]) / max(pi[0], 1e-9)
    spread = np.einsum("ij,jk,ik->i", slope, fit.covariance[:4, :4], slope)
    # Noise in the accelerations draws the load towards nothing by its share (regression dilution).
    sigma[:10] = np.hypot(sigma[:10], shaken * pi)
    spread = spread + (shaken * com) ** 2
    return SensedLoad(
        body=body,
        pi=pi,
        sigma_pi=sigma[:10],
        com=com,
        sigma_com=np.sqrt(spread),
        offset=fit.value[10:16],
        sigma_offset=sigma[10:16],
        drift=fit.value[16:],
        sigma_drift=sigma[16:],
        rms_before=fit.before,
        rms_after=fit.after,
        modelled=float(np.asarray(robot.pi)[outward, 0].sum()),
        duration=float(log.duration),
        notes=notes,
    )


@dataclasses.dataclass(frozen=True)
class _Rows:
    needed: Float[np.ndarray, "T 6 10"]
    rotation: Float[np.ndarray, "T 3 3"]
    """Of the body's axes in the world's."""

    @property
    def shaken(self) -> float:
        """The white share of the acceleration's energy about its mean: the encoders' noise, by third differences."""
        felt = self.needed[:, :3, 0]
        white = np.mean(np.diff(felt, 3, axis=0) ** 2, axis=0) / 20.0
        return float(white.sum() / max(np.var(felt, axis=0).sum(), 1e-30))


def _measured(
    robot: Robot, log: Log, body: str, cutoff: float | None, rate: float | None
) -> tuple[Callable[[np.ndarray], np.ndarray], _Rows, np.ndarray]:
    """The wrench by the axes (T, 3, 3) that it is wanted in, what a load needs, and time from the middle [s].

    Samples are as far apart as the low-pass leaves them independent.
    """
    if robot.has_free_base or not all(robot.topology.dof_scalar):
        raise LogError(
            "a wrist sensor is read on a fixed base of hinges and slides; take what floats out"
        )
    if log.contact_wrench is None or body not in log.contact_bodies:
        have = ", ".join(log.contact_bodies) if log.contact_wrench is not None else "none"
        raise LogError(
            f"the log holds no contact_wrench of {body!r} (it has {have}); name the sensor's columns "
            f"contact_wrench.{body}.fx ... mz, or its topic: --wrench {body}=TOPIC"
        )
    bands = of_estimate(round(log.rate, 6), rate, cutoff)
    log = dataclasses.replace(log, tau=np.zeros(np.shape(log.qpos)), sigma_tau=None)
    motion = generalised(low_pass(resample(log, bands.grid), bands.before), robot)
    edge = int(np.ceil(bands.grid / bands.before))
    if len(motion.time) < 2 * edge + 42:
        raise LogError(
            f"{log.duration:.3g} s of log are too short to weigh anything; record some seconds"
        )
    o = central_differences(motion)
    step = max(round(bands.grid / (2.0 * bands.before)), 1)
    keep = np.arange(edge, len(o.motion.time) - edge, step)
    keep = keep[np.asarray(o.motion.valid)[keep].all(axis=1)]
    place = log.contact_bodies.index(body)
    sensed = np.asarray(o.motion.wrench)[keep, place]
    keep, sensed = keep[np.isfinite(sensed).all(axis=1)], sensed[np.isfinite(sensed).all(axis=1)]
    if len(keep) < 20:
        raise LogError(
            f"the wrench of {body!r} is finite in {len(keep)} moments; at least 20 are needed"
        )
    q, v, a = (np.asarray(x)[keep] for x in (o.motion.q, o.motion.v, o.a))
    rows = _Rows(*_needed(robot, robot.body_index(body), q, v, a))

    def wrench(turned: np.ndarray) -> np.ndarray:
        return np.einsum("tji,thj->thi", turned, sensed.reshape(-1, 2, 3)).reshape(-1, 6)

    time = np.asarray(o.motion.time)[keep]
    return wrench, rows, time - 0.5 * (time[0] + time[-1])


def _needed(
    robot: Robot, index: int, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The wrench that each unit of π needs (T, 6, 10), in the body's axes, and these axes in the world (T, 3, 3)."""

    moments = (jnp.asarray(x) for x in (q, v, a))
    turn, linear, omega, both = (np.asarray(x) for x in _carried(robot, index, *moments))
    alpha = both - omega @ omega
    w, dw = (np.stack([x[:, 2, 1], x[:, 0, 2], x[:, 1, 0]], axis=1) for x in (omega, alpha))
    out = np.zeros((len(q), 6, 10))
    out[:, :3, 0] = linear
    out[:, :3, 1:4] = both
    out[:, 3:, 1:4] = -_cross(linear)
    out[:, 3:, 4:] = _of_inertia(dw) + _cross(w) @ _of_inertia(w)
    return out, turn


@eqx.filter_jit
def _carried(robot: Robot, index: int, q: jax.Array, v: jax.Array, a: jax.Array):
    """R, Rᵀ (p̈ − g), Rᵀ Ṙ = [ω]× and Rᵀ R̈ = [α]× + [ω]×² of a body's frame, p and R in the world."""

    def one(q, v, a):
        def pose(t):
            rotation, position = body_poses(robot, q + v * t + 0.5 * a * t * t)
            return rotation[index], position[index]

        def rates(t):
            return jax.jvp(pose, (t,), (1.0,))[1]

        (turn, _), ((spin, _), (twice, fall)) = pose(0.0), jax.jvp(rates, (0.0,), (1.0,))
        return turn, turn.T @ (fall - robot.gravity), turn.T @ spin, turn.T @ twice

    return jax.vmap(one)(q, v, a)


def _cross(x: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3 3"]:
    """[x]×, with [x]× y = x × y."""
    o = np.zeros(len(x))
    a, b, c = x.T
    return np.stack([o, -c, b, c, o, -a, -b, a, o], axis=1).reshape(-1, 3, 3)


def _of_inertia(x: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3 6"]:
    """I x, linear in the entries xx, xy, xz, yy, yz, zz of I."""
    o = np.zeros(len(x))
    a, b, c = x.T
    rows = [[a, b, c, o, o, o], [o, a, o, b, c, o], [o, o, a, o, b, c]]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


@dataclasses.dataclass(frozen=True)
class _Fit:
    """Gaussian posterior of π, offset and drift, noise of each axis learned."""

    value: Float[np.ndarray, " 22"]
    covariance: Float[np.ndarray, "22 22"]
    before: Float[np.ndarray, " 6"]
    after: Float[np.ndarray, " 6"]
    noise: Float[np.ndarray, " 6"]
    """White part of the residual, by third differences."""

    @property
    def sigma(self) -> Float[np.ndarray, " 22"]:
        return np.sqrt(np.diag(self.covariance))

    @property
    def energy(self) -> float:
        """Mean share of the axes' energy that is left."""
        return float(np.mean(self.after**2 / np.maximum(self.before**2, 1e-12)))

    @classmethod
    def of(
        cls,
        needed: Float[np.ndarray, "T 6 10"],
        wrench: Float[np.ndarray, "T 6"],
        time: Float[np.ndarray, " T"],
        prior: Float[np.ndarray, " 10"],
    ) -> "_Fit":
        one = np.broadcast_to(np.eye(6), (len(time), 6, 6))
        columns = np.concatenate([-needed, one, one * time[:, None, None]], axis=2)
        size = np.sqrt(np.mean(wrench.reshape(-1, 2, 3) ** 2, axis=(0, 2)))
        wide = np.repeat(_OFFSET * np.maximum(size, 1e-3), 3)
        spread = np.concatenate([prior, wide, wide / max(float(np.ptp(time)), 1e-9)])
        before = np.std(wrench, axis=0)
        weight = np.repeat(np.maximum(0.1 * size, 1e-6), 3)
        valid: Bool[np.ndarray, "T 6"] = np.ones(wrench.shape, bool)
        value, covariance, left = np.zeros(22), np.eye(22), wrench
        for _ in range(_ROUNDS):
            a = (columns / weight[:, None]).reshape(-1, 22)
            information = a.T @ a + np.diag(spread**-2.0)
            covariance = np.linalg.inv(information)
            value = covariance @ (a.T @ (wrench / weight).ravel())
            left = wrench - columns @ value
            # Of residuals that average out slowly, as of what the model does not hold, fewer count.
            weight = np.std(left, axis=0) * correlation_inflation(left, valid)
            weight = np.maximum(weight, 1e-9 * np.repeat(np.maximum(size, 1e-3), 3))
        noise = np.sqrt(np.mean(np.diff(left, 3, axis=0) ** 2, axis=0) / 20.0)
        return cls(value, covariance, before, np.sqrt(np.mean(left**2, axis=0)), noise)


def _check_axes(fit: _Fit, other: _Fit, axes: str, body: str) -> None:
    """LogError where the wrench fits a load in other axes than it was said to be in."""
    if other.energy < _LEAVES * fit.energy and other.energy < _SHARE:
        of = "its body's own" if axes == "body" else "the world's"
        raise LogError(
            f"the wrench of {body!r} fits a load if it is in {of} axes ({100 * other.energy:.2g} % of its energy is "
            f"left, and {100 * fit.energy:.2g} % as it was read); give --wrench-axes {axes}"
        )


def _notes(fit: _Fit, untold: bool) -> Iterator[str]:
    if untold:
        yield (
            "the sensor was turned and moved too little to distinguish the load from its offset: hold it in poses that "
            "differ by tens of degrees"
        )
    off = (fit.after > _TIMES * fit.noise) & (fit.after > _SHARE * fit.before)
    if off.any():
        told = ", ".join(
            f"{AXES[k]} {fit.after[k]:.2g}, noise {fit.noise[k]:.2g}" for k in np.flatnonzero(off)
        )
        yield (
            f"the residual is larger than noise ({told}, rms in N and N m): something touched the tool, a cable pulls, "
            "or the "
            "sensor is turned against the body"
        )
