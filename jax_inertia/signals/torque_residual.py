"""From a log to the torque residual [N m, on slides N]: the one chain, and the one sign, of `estimate` and `diagnose`.

The residual of a sample is what the model, moved as the log says, needs beyond what was logged:

    y = M a + c − τ_passive − Σ Jᵀλ + b − τ        (−Δτ of Foster et al., eq. delta-tau, b the calibration's bias)

An effect of the real robot is a torque e(t; θ) on the same rows, and y = e + noise. Bodies that are estimated are left
out of M and c (`torque_residual`): with parameters π the model needs Y π more, so y + Y π is noise where π is right.

Rates and low-passes are settings (`signals.bands`): a log goes through one low-pass before the physics (`observed`),
signals and all, and the diagnosis's y and columns through a second one after it (`Prepared.finish`), so that columns
with corners (sign, clip, |τ|) are formed on the fast grid and no side is ever differentiated or smoothed alone.
"""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy import ndimage, signal

from jax_inertia.dynamics import rigid_body
from jax_inertia.logs.log import Log
from jax_inertia.maths.over_samples import OverSamples
from jax_inertia.model.robot import Robot
from jax_inertia.signals.bands import DIAGNOSIS, DIAGNOSIS_IN_CONTACT, Bands, holds
from jax_inertia.signals.base_motion import motion_of, unmoved
from jax_inertia.signals.creep import softness
from jax_inertia.signals.differences import Observation, central_differences
from jax_inertia.signals.dry_friction import at_rest, direction
from jax_inertia.signals.filtering import Masked, bridged_smoothly, low_pass, mask, resample
from jax_inertia.signals.generalised_motion import Motion, generalised
from jax_inertia.signals.ground.errors import unsure
from jax_inertia.signals.ground.support import BASE, Support, supported
from jax_inertia.signals.held import PositionLoop, later, of_loop, position_loop, timing_of
from jax_inertia.signals.outliers import without_outliers
from jax_inertia.signals.spikes import torque_spikes

FRICTION_VELOCITY = 0.01
"""The estimate's dry friction is F tanh(v / this) [rad/s]: it bears velocity noise and is far below working speeds."""


class Prepared(eqx.Module):
    """A log on the fast grid, with what the model says of it. Rows are generalised coordinates."""

    robot: Robot
    observation: Observation
    tau: Float[np.ndarray, "T nv"]
    inverse: Float[np.ndarray, "T nv"]
    """What the model needs: M a + c − τ_passive − Σ Jᵀλ [N m]; free of torque noise, so it serves as instrument."""
    rest: Bool[np.ndarray, "T nv"]
    """Where a joint stands still."""
    dry: Float[np.ndarray, "T nv"]
    """The part of `inverse` that is the model's own dry friction [N m]."""
    measured: Float[np.ndarray, "T nv"]
    """1 where a row stands on measurements, 0 where it leans on what was bridged."""
    bands: Bands = eqx.field(static=True)
    rate: float = eqx.field(static=True)
    support: Support | None = None
    """Forces of the ground that are not measured."""
    knows_velocity: bool = eqx.field(static=True, default=True)
    """Whether that of the base is measured, and not only its changes."""
    by_feet: bool = eqx.field(static=True, default=False)
    """Whether how the base accelerates is taken from its feet alone."""
    loop: PositionLoop | None = None
    driven: tuple[int, ...] = ()
    """Row of each of the log's joints, in its order."""
    """Of the log's joints, in their order, where their torque was taken for that of one."""

    @property
    def time(self) -> Float[np.ndarray, "T"]:
        return np.asarray(self.observation.motion.time)

    @property
    def missing(self) -> Float[np.ndarray, "T nv"]:
        """The torque residual y on the fast grid [N m]."""
        return self.inverse - self.tau

    def finish(self, x: Float[np.ndarray, "T *c"]) -> Float[np.ndarray, "R *c"]:
        """The chain's last low-pass, then its slow grid; leading axis time."""
        wide = x.reshape(len(x), -1)
        # What one leg does is seen on a few of a humanoid's rows, and filters are slow.
        live = np.any(wide, axis=0)
        out = np.zeros((len(self.kept), wide.shape[1]))
        if live.any():
            out[:, live] = below(self.bands.cutoff, wide[:, live], self.rate)[self.kept]
        return out.reshape(len(out), *x.shape[1:])

    def finish_torque(
        self, x: Float[np.ndarray, "T *c"], row: int | None = None
    ) -> Float[np.ndarray, "R *d"]:
        """`finish` of torques on all rows (T, nv, ...), or of one row (T, ...): what was not measured weighs nothing.

        Residual and effects lose the same moments before the same filter, so a gap in the log leaks into neither;
        and what forces of the ground that are not measured might explain. A row that those reach comes back on all.
        """
        if self.support is not None and (row is None or self.spreads(row)):
            x, row = self.support.left_of(x, row), None
        if self.measured.all():
            return self.finish(x)
        weight = self.measured if row is None else self.measured[:, row]
        return self.finish(x * weight.reshape(weight.shape + (1,) * (x.ndim - weight.ndim)))

    def spreads(self, row: int) -> bool:
        """Whether a torque on a row is seen on others: of a leg that stands on forces that are not measured."""
        return self.support is not None and bool(row < BASE or self.support.used_up[:, row].any())

    @property
    def kept(self) -> np.ndarray:
        """Indices of the slow grid in the fast one."""
        step = max(1, round(self.rate / self.bands.rows))
        edge = round(self.bands.margin * self.rate)
        return np.arange(edge, len(self.time) - edge, step)

    @property
    def valid(self) -> np.ndarray:
        """Rows of the slow grid that stand on measurements for the most part, (R, nv)."""
        return self.finish(self.measured) > 0.7


def observed(
    log: Log | Masked, robot: Robot, bands: Bands, rng: np.random.Generator | None = None
) -> Observation:
    """A log on the grid of `bands`: every channel low-passed alike, then accelerations by differences.

    Where velocities come from positions, gaps are bridged by cubics (`filtering.bridged_smoothly`). `rng` draws errors
    of what feet say of a base whose position is not measured (`base_motion`).
    """
    source = resample(log, bands.grid)
    if source.log.qvel is None:
        source = bridged_smoothly(source)
    return central_differences(motion_of(low_pass(source, bands.before), robot, rng))


def on_the_ground(robot: Robot, observation: Observation, log: Log, reach: float) -> Observation:
    """Observations of a floating base with the wrenches of the ground that its legs' torques show (`signals.ground`).

    The rows of those legs are then not measured: between two steps a low-pass of 10 Hz leaves next to nothing of a
    swing. As they are where nothing carries the robot; torques in N m. `reach` [s]: of the log's low-pass.
    """
    motion = observation.motion
    residual = _needed_torques(robot, observation) - np.asarray(motion.tau)
    found = supported(robot, motion, residual, log, reach)
    if found is None:
        return observation
    measured = _standing(np.asarray(motion.valid) * 1.0, found) > 0
    measured[:, found.used_up.any(axis=0)] = False
    out = _carried(observation, found)
    errors = unsure(robot, motion, found, FRICTION_VELOCITY)
    motion = dataclasses.replace(out.motion, valid=measured, unsure=errors)
    return dataclasses.replace(out, motion=motion)


def prepare(
    robot: Robot, log: Log, bands: Bands | None = None, rng: np.random.Generator | None = None
) -> Prepared:
    """Put a log through the chain up to the diagnosis's fast grid.

    Velocities are taken from positions: a driver's own velocity may be late or smoothed, and the two sides of the
    equation must agree. When torques act after their stamps is as `timing_of` has it. Single samples of torque that no
    motor makes (`preflight` names them) are taken for missing, those of an encoder for what they should be. `rng` draws
    errors of what is taken from feet: the base's velocity (`base_motion`) and moments at a ball (`signals.ground`).
    Raises LogError for what `generalised` refuses.
    """
    if bands is None:
        touches = log.contact_wrench is not None or robot.has_free_base
        bands = (DIAGNOSIS_IN_CONTACT if touches else DIAGNOSIS).at(log.rate)
    source, loop = _in_time(robot, log)
    rate = bands.grid
    observation = observed(source, robot, bands, rng)
    v = np.asarray(observation.motion.v)
    # As slow as the chain ends: noise of the encoders does not move a joint.
    radian = robot.topology.dof_radian
    slow = below(bands.cutoff, v, rate) / radian
    creeping = np.asarray(robot.frictionloss) * softness(robot) / radian
    rest = at_rest(slow, rate, creeping) & robot.topology.dof_scalar
    dry = np.asarray(robot.frictionloss) * direction(v / radian, rest)
    inverse = needed_torques(without_friction(robot), observation) + dry
    tau = np.asarray(observation.motion.tau)
    # The first low-pass carries what was bridged about a period of its cut-off outwards.
    reach = 2 * round(rate / bands.before) + 1
    ok = np.asarray(observation.motion.valid)
    measured = ndimage.minimum_filter1d(ok * 1.0, reach, axis=0, mode="nearest")
    support = None
    if robot.has_free_base and log.contact_wrench is None:
        support = supported(robot, observation.motion, inverse - tau, log, 1.0 / bands.before)
        if support is not None:
            observation = _carried(observation, support)
            inverse = inverse - support.torque
            measured = _standing(measured, support)
            if rng is not None:
                q = np.asarray(observation.motion.q)
                inverse = inverse - support.pivoting(robot, q, rate, rng)
    return Prepared(
        robot,
        observation,
        tau,
        inverse,
        rest,
        dry,
        measured,
        bands,
        rate,
        support,
        knows_velocity=not robot.has_free_base or log.base_pos is not None,
        by_feet=robot.has_free_base and log.base_pos is None and log.base_linacc is None,
        loop=loop,
        driven=tuple(_rows_of(robot, log)),
    )


def _in_time(robot: Robot, log: Log) -> tuple[Masked, PositionLoop | None]:
    """A log whose torques and wrenches are those about their stamps, without spikes, and the loop behind them."""
    tau = np.where(torque_spikes(log), np.nan, np.asarray(log.tau))
    log = dataclasses.replace(log, qpos=without_outliers(np.asarray(log.qpos)), tau=tau)
    source = mask(log)
    data = source.log
    late = timing_of(data).late
    if (loop := position_loop(data)) is None:
        tau = later(np.asarray(data.tau), late)
    else:
        inertia = _inertia(robot, data)
        tau = np.where(
            loop.kp > 0, of_loop(data, loop, *inertia), later(np.asarray(data.tau), late)
        )
    data = dataclasses.replace(data, tau=tau, qvel=None)
    if data.contact_wrench is not None:
        data = dataclasses.replace(data, contact_wrench=later(data.contact_wrench, 0.5))
    return dataclasses.replace(source, log=data), loop


def _carried(observation: Observation, support: Support) -> Observation:
    """With the ground's wrenches."""
    motion = dataclasses.replace(
        observation.motion, wrench=support.wrench, contact_bodies=support.bodies
    )
    return dataclasses.replace(observation, motion=motion)


# Postures of a log in which inertia is looked at.
_POSTURES = 64


def _inertia(robot: Robot, log: Log) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m n n"]]:
    """Of a log's joints, at moments throughout the log."""
    motion = generalised(unmoved(log), robot)
    picked = np.linspace(0, len(log.time) - 1, _POSTURES).astype(int)
    every = jax.vmap(rigid_body.mass_matrix, (None, 0))(robot, jnp.asarray(motion.q)[picked])
    rows = _rows_of(robot, log)
    return np.asarray(log.time)[picked], np.asarray(every)[:, rows][:, :, rows]


def _rows_of(robot: Robot, log: Log) -> list[int]:
    dofs = dict(zip(robot.joint_names, robot.joint_dofadr, strict=True))
    return [int(dofs[name]) for name in log.joint_names]


def _standing(measured: Float[np.ndarray, "T nv"], support: Support) -> Float[np.ndarray, "T nv"]:
    """Rows that stand on measurements: a leg's own while it swings, the base's with all legs that carry it."""
    out = np.where(support.used_up, 0.0, measured)
    out[:, :BASE] *= np.where(support.used_up, measured, 1.0).min(axis=1, keepdims=True)
    out[support.hidden, :BASE] = 0.0
    if support.turned is not None:
        out[:, support.turned] = 0.0
    return out


def without_friction(robot: Robot) -> Robot:
    """The robot without its own dry friction."""
    return eqx.tree_at(lambda r: r.frictionloss, robot, jnp.zeros_like(robot.frictionloss))


def needed_torques(robot: Robot, observation: Observation) -> Float[np.ndarray, "T nv"]:
    """Torque that the model needs for the motion."""
    return _needed_torques(robot, observation)


@OverSamples
def _needed_torques(robot: Robot, o: Observation) -> jax.Array:
    return needed_torque(robot, o.motion.q, o.motion.v, o.a, o)


def needed_torque(robot: Robot, q, v, a, observation: Observation) -> jax.Array:
    """M a + c − τ_passive − Σ Jᵀλ of one moment [N m]."""
    rigid = rigid_body.inverse_dynamics(robot, q, v, a)
    passive = rigid_body.passive_torque(robot, q, v)
    return _without(rigid, passive, robot, q, observation.motion)


def torque_residual(
    robot: Robot, observation: Observation, bodies: tuple[int, ...], bias: Float[Array, " nv"]
) -> tuple[Float[Array, "nv n 10"], Float[Array, " nv"]]:
    """(Y^est, y) of one moment, y without the chosen bodies; dry friction is F tanh(v / `FRICTION_VELOCITY`).

    Every channel must belong to the same moment (Foster et al., sec. III-D); `jax_inertia.signals.differences` sees
    to it.
    """
    motion = observation.motion
    q, v, a = (jnp.asarray(x) for x in (motion.q, motion.v, observation.a))
    regressor, others = rigid_body.condensed_dynamics(robot, q, v, a, bodies)
    passive = rigid_body.passive_torque(robot, q, v, friction_velocity=FRICTION_VELOCITY)
    return regressor, _without(others - jnp.asarray(motion.tau), passive, robot, q, motion) + bias


def torque_residuals(
    robot: Robot, observations: Observation, bodies: tuple[int, ...], bias: Float[Array, " nv"]
) -> tuple[Float[Array, "T nv n 10"], Float[Array, "T nv"]]:
    """`torque_residual` of every moment of a log, in chunks that stay in cache."""
    return jax.lax.map(
        lambda one: torque_residual(robot, one, bodies, bias),
        jax.tree.map(jnp.asarray, observations),
        batch_size=64,
    )


def _without(torque: jax.Array, passive: jax.Array, robot: Robot, q, motion: Motion) -> jax.Array:
    """A torque less what acts without the motors: joints' passive torques, forces of contact."""
    out = torque - passive
    if motion.wrench is None:
        return out
    wrench = jnp.asarray(motion.wrench)
    return out - rigid_body.contact_torque(robot, q, wrench, motion.contact_bodies)


def below(cutoff: float, x: Float[np.ndarray, "T *c"], rate: float) -> Float[np.ndarray, "T *c"]:
    """The part of signals below a frequency [Hz], without delay; leading axis time.

    On a grid that holds nothing above it (`bands.holds`) that is all of them.
    """
    if not holds(rate, cutoff):
        return x
    return signal.sosfiltfilt(_low_pass(cutoff, rate), x, axis=0)


@functools.cache
def _low_pass(cutoff: float, rate: float) -> np.ndarray:
    return np.asarray(signal.butter(3, cutoff, fs=rate, output="sos"))
