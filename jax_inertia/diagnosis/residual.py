"""A log as rows of torque residual: y = M q̈ + h − τ in one band, on one slow grid, with a weight for each row."""

import copy
import dataclasses
import functools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Columns, Effect
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.logs.log import Log
from jax_inertia.model.robot import Robot
from jax_inertia.signals.bands import DIAGNOSIS, DIAGNOSIS_IN_CONTACT
from jax_inertia.signals.ground.support import BASE
from jax_inertia.signals.sensor_noise import perturbed
from jax_inertia.signals.torque_residual import Prepared, prepare

REPLICAS = 2


@dataclasses.dataclass(frozen=True)
class Ordinary:
    """Ordinary numbers of each row beyond the model's own."""

    viscous: Float[np.ndarray, " n"]
    """N m s/rad."""
    coulomb: Float[np.ndarray, " n"]
    """N m."""
    armature: Float[np.ndarray, " n"]
    """kg m²."""
    offset: Float[np.ndarray, " n"]
    """Constant torque of link or motor, none where it is a torque sensor's zero [N m]."""


class _Calibrated(Context):
    """What effects are made of on a model with friction and rotor inertia beyond `nominal`'s."""

    def __init__(self, prepared: Prepared, nominal: Context, offset: Float[np.ndarray, " n"]):
        super().__init__(prepared)
        self._nominal, self.offset = nominal, offset

    def rubs(self, row):
        # Friction that the model does not state is taken for the motor's.
        return self._nominal.rubs(row)

    def bristle(self, row, reach, *, straight=False):
        return self._nominal.bristle(row, reach, straight=straight)

    @functools.cached_property
    def sensitivity(self):
        """∂/∂q, ∂/∂v, ∂/∂a: the nominal model's, and those of what is beyond it, which are diagonal."""
        dq, dv, da = self._nominal.sensitivity
        damping = self.damping - self._nominal.damping
        return dq, dv + np.diag(damping), da + np.diag(self.armature - self._nominal.armature)


class Residual:
    """R rows of n generalised coordinates; made once per log, never changed."""

    def __init__(self, robot: Robot, log: Log, settings: Settings):
        touches = log.contact_wrench is not None or robot.has_free_base
        wanted = DIAGNOSIS_IN_CONTACT if touches else DIAGNOSIS
        wanted = dataclasses.replace(
            wanted, rows=settings.rows_per_cutoff, periods=settings.margin_periods
        )
        band = wanted.at(log.rate)
        self.log, self.robot, self.settings, self.band = log, robot, settings, band
        self.prepared: Prepared = prepare(robot, log, band)
        self.context = Context(self.prepared)
        self.beside = self.context
        """Of the calibrated model, once there is one."""
        self.y = self.prepared.finish_torque(self.prepared.missing)
        """Torque residual (R, n) [N m]."""
        self.loaded = False
        """Whether loads are those of the robot as found."""
        self.ordinary: Ordinary | None = None
        """What the calibrated model has beyond the nominal one."""
        self._replicas: tuple[Residual, ...] | None = None
        self.known: dict[tuple, tuple] = {}
        """Columns of hypotheses on this log, made once (`hypothesis.hypothesis`)."""

    def calibrated(
        self, ordinary: Ordinary, carried: Float[np.ndarray, "T nv"] | None = None
    ) -> "Residual":
        """The same rows, of a model that has each joint's friction and rotor inertia.

        `carried`: what the links need beyond the nominal model [N m], where loads are those of the robot as found.
        """
        out = copy.copy(self)
        out.ordinary, out._replicas, out.known = ordinary, None, {}
        out.loaded = carried is not None
        links = 0.0 if carried is None else carried
        c, robot = self.context, self.robot
        dry = ordinary.coulomb * c.side
        prepared = dataclasses.replace(
            self.prepared,
            robot=dataclasses.replace(
                robot,
                armature=jnp.asarray(np.asarray(robot.armature) + ordinary.armature),
                damping=jnp.asarray(np.asarray(robot.damping) + ordinary.viscous),
                frictionloss=jnp.asarray(np.asarray(robot.frictionloss) + ordinary.coulomb),
            ),
            inverse=c.inverse + links + ordinary.armature * c.a + ordinary.viscous * c.v + dry,
            dry=self.prepared.dry + dry,
        )
        out.beside = _Calibrated(prepared, c, ordinary.offset)
        return out

    def context_of(self, effect: Effect) -> Context:
        """What an effect's columns are made of."""
        return (
            self.beside if effect.calibrated or (self.loaded and effect.by_load) else self.context
        )

    @property
    def time(self) -> Float[np.ndarray, " R"]:
        """Of each row [s], from the log's beginning."""
        return self.context.time[self.prepared.kept]

    @functools.cached_property
    def weight(self) -> Float[np.ndarray, "R n"]:
        """1 where a row is measured and its joint moves, 0 where it rests: there friction is whatever balances."""
        return self._moves * self.prepared.valid

    @functools.cached_property
    def _moves(self) -> Float[np.ndarray, "R n"]:
        speed, moving = np.abs(self.context.v / self.context.radian), np.ones_like(self.context.v)
        for row in self.context.joint_dofs.values():
            moving[:, row] = speed[:, row] > self.settings.rest_speed
        return np.clip(self.prepared.finish(moving), 0.0, 1.0) ** 4

    def shown(self, row: int) -> Float[np.ndarray, " R"]:
        """1 where a joint moves and its friction is seen: on its own row, or on the base's while its leg stands."""
        if not self.prepared.spreads(row):
            return self.weight[:, row]
        valid = self.prepared.valid
        return self._moves[:, row] * np.maximum(valid[:, row], valid[:, :BASE].max(axis=1))

    @functools.cached_property
    def moving(self) -> Float[np.ndarray, "R n"]:
        """1 where a row is measured and its joint moves at that moment, 0 elsewhere: rows that errors are quoted of."""
        speed = np.abs(self.context.v / self.context.radian)[self.prepared.kept]
        moves = np.ones_like(speed)
        for row in self.context.joint_dofs.values():
            moves[:, row] = speed[:, row] > self.settings.rest_speed
        return moves * self.prepared.valid

    def rotates(self, row: int) -> bool:
        """Whether a row is a hinge's."""
        return bool(self.robot.topology.dof_rotates[row])

    def rows_of(self, columns: Columns) -> tuple[np.ndarray, int | None]:
        """Columns of the fast grid on the slow one; on one row, (R, k), where they act on one."""
        values = self.prepared.finish_torque(columns.values, columns.row)
        return values, (columns.row if values.ndim == 2 else None)

    @functools.cached_property
    def torque(self) -> Float[np.ndarray, "R n"]:
        """What the log gives each row [N m]."""
        return self.prepared.finish_torque(self.prepared.tau)

    @functools.cached_property
    def sensors(self) -> Float[np.ndarray, " n"]:
        """Standard deviation that the sensors' noise leaves on each row [N m]: encoders' and torques' alike.

        From replicas of the log with its noise, as stated or as its samples show, added once more.
        """
        changes = [x.finish_torque(x.missing) - self.y for x in self._noisy]
        count = np.maximum(self.weight.sum(axis=0), 1e-9)
        return np.sqrt(np.mean([(self.weight * x**2).sum(axis=0) / count for x in changes], axis=0))

    @functools.cached_property
    def _noisy(self) -> tuple[Prepared, ...]:
        rng = np.random.default_rng(0)
        return tuple(
            prepare(self.robot, perturbed(self.log, rng), self.band, rng) for _ in range(REPLICAS)
        )

    @property
    def replicas(self) -> tuple["Residual", ...]:
        """The same log with its noise once more, a few times; made once for each calibrated model."""
        if self._replicas is None:
            self._replicas = tuple(map(self._again, self._noisy))
        return self._replicas

    def _again(self, prepared: Prepared) -> "Residual":
        out = copy.copy(self)
        out.known = {}
        out.prepared, out.context = prepared, self.context.echo(prepared)
        out.beside, out.y = out.context, prepared.finish_torque(prepared.missing)
        return out if self.ordinary is None else out.calibrated(self.ordinary)
