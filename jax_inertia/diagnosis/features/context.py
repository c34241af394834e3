"""What the families of effects are made of: the motion on the fast grid, and the model's derivatives along it."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy import signal

from jax_inertia.diagnosis.features import derivatives
from jax_inertia.diagnosis.features.two_mass import DrivenLink, OwnFriction
from jax_inertia.maths.inertial_parameters import centre_of_mass
from jax_inertia.model.robot import HINGE, SLIDE, Robot
from jax_inertia.signals.creep import DAMPING, softness
from jax_inertia.signals.dry_friction import bristle, direction, share_below, stillness
from jax_inertia.signals.torque_residual import (
    Prepared,
    below,
    needed_torques,
    without_friction,
)

# Presliding displacement of dry friction whose own is not known [rad]: that of real ones lies within 1e-4 and 1e-3.
TURNS_OVER = 3e-4
# Share of its level from which such a friction counts as turned round.
TURNED = 0.95

# Longest links of robots for which lengths are stated [m].
USUAL = (0.15, 1.0)

# Over which step second derivatives are taken [rad].
BENT = 0.05
# Above this [Hz] accelerations may be the encoders' noise more than what a joint creeps by.
CREEP_BAND = 40.0


class Context:
    """Cached quantities of one prepared log; arrays have time first, on the fast grid."""

    def __init__(self, prepared: Prepared):
        self.prepared = prepared
        self.robot = prepared.robot
        motion = prepared.observation.motion
        self.time = np.asarray(motion.time) - np.asarray(motion.time)[0]
        self.q, self.v = np.asarray(motion.q), np.asarray(motion.v)
        self.a = np.asarray(prepared.observation.a)
        self.tau, self.inverse = prepared.tau, prepared.inverse
        self.at_rest = prepared.rest
        self.side = direction(self.v / self.radian, self.at_rest)
        # As NumPy: an element of a JAX array costs a dispatch, and families read them shape by shape.
        r = prepared.robot
        self.armature, self.damping = np.asarray(r.armature), np.asarray(r.damping)
        self.stiffness, self.frictionloss = np.asarray(r.stiffness), np.asarray(r.frictionloss)
        self.pi = np.asarray(r.pi)
        self.contacts = motion.contact_bodies
        self.wrench = None if motion.wrench is None else np.asarray(motion.wrench)
        self.windows: tuple[tuple[float, float], ...] = ()
        """Stretches [s] that stand out from the rest of the log: where a push may have been."""
        self.offset = np.zeros(prepared.robot.nv)
        """Constant torque on each row that the robot has and the model has not [N m]."""
        self._driven_links: dict[int, DrivenLink] = {}
        self._bristles: dict[tuple[int, float, bool], np.ndarray] = {}
        self._slides: dict[float, np.ndarray] = {}
        self._bends: dict[int, np.ndarray] = {}
        self._along: dict[int, tuple[np.ndarray, ...]] = {}

    def echo(self, again: Prepared) -> "Context":
        """The same log with more noise; what that hardly changes is shared."""
        out = Context(again)
        # A cached property lives in the instance's dictionary.
        out.__dict__["sensitivity"] = self.sensitivity
        out._bends, out._along = self._bends, self._along
        return out

    @functools.cached_property
    def joint_dofs(self) -> dict[str, int]:
        """Row of each hinge and slide joint, by name."""
        r = self.robot
        rows = zip(r.joint_names, r.joint_type, r.joint_dofadr, strict=True)
        return {name: dof for name, kind, dof in rows if kind in (HINGE, SLIDE)}

    @property
    def row_names(self) -> tuple[str, ...]:
        """What each row is called: its joint's name, or where it is among the base's."""
        names = {dof: name for name, dof in self.joint_dofs.items()}
        return tuple(names.get(j, f"base[{j}]") for j in range(self.robot.nv))

    @functools.cached_property
    def joint_position(self) -> np.ndarray:
        """Position of each hinge and slide row; zero elsewhere (T, nv)."""
        out = np.zeros_like(self.v)
        for dof, qadr in self._qpos_of.items():
            out[:, dof] = self.q[:, qadr]
        return out

    @functools.cached_property
    def _qpos_of(self) -> dict[int, int]:
        """Where in q each hinge and slide row's position stands."""
        r = self.robot
        every = zip(r.joint_type, r.joint_qposadr, r.joint_dofadr, strict=True)
        return {int(dof): int(qadr) for kind, qadr, dof in every if kind in (HINGE, SLIDE)}

    @functools.cached_property
    def peak(self) -> np.ndarray:
        """Peak torque of each row: the 99.5th percentile of what the model needs [N m]."""
        return np.percentile(np.abs(self.inverse), 99.5, axis=0)

    @functools.cached_property
    def speed(self) -> np.ndarray:
        """Peak speed of each row: the 99.5th percentile [rad/s]."""
        return np.percentile(np.abs(self.v), 99.5, axis=0)

    @functools.cached_property
    def radian(self) -> Float[np.ndarray, " nv"]:
        """What of each row's position counts for as much as a radian of a hinge (nv,)."""
        return self.robot.topology.dof_radian

    @functools.cached_property
    def usual_speed(self) -> Float[np.ndarray, " nv"]:
        """Speed at which each row's torques that grow with speed are a share of its peak: a radian a second at most."""
        return np.clip(self.speed, 1e-6, self.radian)

    @functools.cached_property
    def scale(self) -> float:
        """How many times larger the robot is than those with links of 0.15 to 1 m: a crane is, a finger is smaller."""
        robot = self.robot
        carried = np.array(robot.topology.parent) >= 0
        links = np.linalg.norm(np.asarray(robot.placement_position)[carried], axis=1)
        mass = self.pi[:, 0]
        centres = np.linalg.norm(self.pi[:, 1:4], axis=1)[mass > 0] / mass[mass > 0]
        longest = float(np.max([*links, *centres], initial=1e-6))
        return longest / float(np.clip(longest, *USUAL))

    def below(self, cutoff: float, x: np.ndarray) -> np.ndarray:
        """The part of signals on the fast grid (T, ...) below a frequency [Hz]."""
        return below(cutoff, x, self.prepared.rate)

    @functools.cached_property
    def slow_band(self) -> float:
        """Frequency that holds nine tenths of the needed torque's energy and half as much again, 1.5 to 5 Hz."""
        needed = self.inverse / np.maximum(self.inverse.std(axis=0), 1e-9)
        frequency, power = signal.periodogram(needed, self.prepared.rate, axis=0)
        energy = np.cumsum(power.sum(axis=1))
        at = frequency[np.searchsorted(energy, 0.9 * energy[-1])]
        return float(np.clip(1.5 * at, 1.5, 5.0))

    @staticmethod
    def foresee(robot: Robot) -> None:
        """Compile the regressor while a log is prepared."""
        derivatives.regressor.ahead(robot, tuple(map(np.zeros, (robot.nq, robot.nv, robot.nv))))

    def foresee_sensitivity(self) -> None:
        """Compile `sensitivity` while ordinary physics is fitted."""
        first = jax.tree.map(lambda x: np.asarray(x)[0], self.prepared.observation)
        derivatives.sensitivity.ahead(without_friction(self.robot), first)

    @functools.cached_property
    def regressor(self) -> np.ndarray:
        """Torque regressor of all bodies (T, nv, nb, 10)."""
        return derivatives.regressor(self.robot, (self.q, self.v, self.a))

    @functools.cached_property
    def sensitivity(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """∂/∂q, ∂/∂v, ∂/∂a of the needed torque along each hinge or slide row, (T, nv, nv) each.

        Dry friction apart: it depends on the side of a velocity, whose error does not change it.
        """
        return derivatives.sensitivity(without_friction(self.robot), self.prepared.observation)

    def along(self, row: int) -> tuple[np.ndarray, ...]:
        """The rows whose torque a joint's motion changes (n,), and the three of `sensitivity` there (T, n)."""
        if row not in self._along:
            # Families read them shape by shape: side by side in memory.
            every = [x[:, :, row] for x in self.sensitivity]
            at = np.flatnonzero(np.any([x.any(axis=0) for x in every], axis=0))
            self._along[row] = (at, *(x[:, at] for x in every))
        return self._along[row]

    def bend(self, row: int) -> np.ndarray:
        """∂²(needed torque)/∂q² along a hinge or slide row, dry friction apart (T, nv)."""
        if row not in self._bends:
            observation = self.prepared.observation
            at = self._qpos_of[row]

            def moved(by: float) -> np.ndarray:
                q = jnp.asarray(self.q).at[:, at].add(by)
                other = eqx.tree_at(lambda o: o.motion.q, observation, q)
                return needed_torques(without_friction(self.robot), other)

            middle = self.inverse - self.prepared.dry
            self._bends[row] = (moved(BENT) - 2.0 * middle + moved(-BENT)) / BENT**2
        return self._bends[row]

    @functools.cached_property
    def link_torque(self) -> np.ndarray:
        """What each joint's link alone needs (T, nv): the rotor's inertia, damping and dry friction apart.

        A model has one of each per joint; those of a geared joint sit on the motor (see `two_mass` for where not).
        """
        return self.inverse - self.prepared.dry - self._rotor

    @functools.cached_property
    def link_peak(self) -> np.ndarray:
        """Peak of that by row: the 99.5th percentile [N m]."""
        return np.percentile(np.abs(self.link_torque), 99.5, axis=0)

    @functools.cached_property
    def _rotor(self) -> np.ndarray:
        """Torque that each joint's motor takes for itself, dry friction apart (T, nv)."""
        return self.armature * self.a + self.damping * self.v

    @property
    def gravity(self) -> np.ndarray:
        """Of the model, in the world [m/s²]."""
        return np.asarray(self.robot.gravity)

    @functools.cached_property
    def gravity_rows(self) -> np.ndarray:
        """∂(needed torque)/∂(gravity in the world), exactly: it is linear in it (T, nv, 3)."""
        return -np.einsum("b,tbjc->tjc", self.pi[:, 0], self.force_rows)

    @functools.cached_property
    def force_rows(self) -> np.ndarray:
        """Torque of a unit world force at each body's centre of mass, Jᵀ (T, nb, nv, 3)."""
        mass = np.concatenate([np.ones((len(self.pi), 1)), centre_of_mass(self.robot.pi)], axis=1)
        return -np.stack([np.einsum("tjbk,bk->tbj", x, mass) for x in self._held], axis=-1)

    def lever_rows(self, body: int) -> np.ndarray:
        """How that changes as the force's point moves along an axis i of the body, ∂(Jᵀ)/∂pᵢ (T, nv, 3 of i, 3)."""
        return -np.stack([x[:, :, body, 1:] for x in self._held], axis=-1)

    @functools.cached_property
    def _held(self) -> list[np.ndarray]:
        """What holds a unit mass, and a unit first moment, of each body against a gravity of one along each world axis.

        (T, nv, nb, 4) each: one compiled regressor serves for all.
        """
        still, out = np.zeros_like(self.v), []
        for axis in np.eye(3):
            robot = eqx.tree_at(lambda r: r.gravity, self.robot, jnp.asarray(axis))
            out.append(np.array(derivatives.regressor(robot, (self.q, still, still))[..., :4]))
        return out

    @functools.cached_property
    def com_velocity(self) -> np.ndarray:
        """World velocity of each body's centre of mass (T, nb, 3)."""
        return np.einsum("tbjc,tj->tbc", self.force_rows, self.v)

    @functools.cached_property
    def contact_rows(self) -> np.ndarray:
        """Torque of each contact's measured wrench (T, C, nv)."""
        assert self.wrench is not None, "no contact wrench is measured"
        return self.contact_torques(self.wrench)

    def contact_torques(self, wrench: Float[np.ndarray, "T C 6"]) -> np.ndarray:
        """Torque of each contact's wrench (T, C, nv)."""
        return derivatives.contact_rows((self.robot, self.contacts), (self.q, wrench))

    def bristle(self, row: int, reach: float, *, straight: bool = False) -> np.ndarray:
        """Friction direction of a joint with presliding, z in [−1, 1] (T,), see `dry.bristle`.

        After a reversal the direction turns over a displacement of about `reach` [rad], not at once.
        """
        key = row, reach, straight
        if key not in self._bristles:
            self._bristles[key] = self.bristle_of_any(row, reach, straight)
        return self._bristles[key]

    def turns_over(self, row: int) -> float:
        """Presliding displacement of a dry friction whose own is not known [rad, of a slide m]."""
        return TURNS_OVER * float(self.radian[row])

    def bristle_of_any(self, row: int, reach: float | np.ndarray, straight: bool) -> np.ndarray:
        """`bristle`, not kept: the displacement may change along the log (T,)."""
        start = float(np.sign(self.v[0, row]))
        return bristle(self.joint_position[:, row], start, reach, straight=straight)

    def creeping(self, row: int, level: float, band: float = CREEP_BAND) -> np.ndarray:
        """Friction direction of a joint that creeps by a `level` of friction [N m], in [−1, 1] (T,).

        `band`: up to which frequency [Hz] the logged motion is believed.
        """
        return self.creeping_at(row, self.creep_speed(row, level), band)

    def creep_speed(self, row: int, level: float) -> float:
        """Speed at which a `level` of MuJoCo's friction loss is reached [rad/s]."""
        return max(level * float(self._softness[row]), 1e-9)

    def creeping_at(self, row: int, speed: float, band: float = CREEP_BAND) -> np.ndarray:
        """`creeping` by the speed at which its level is reached [rad/s]."""
        return np.clip(self._sliding(band)[:, row] / speed, -1.0, 1.0)

    def _sliding(self, band: float) -> np.ndarray:
        """q̇ + q̈/b of the soft constraint, below a frequency [Hz] (T, nv)."""
        if band not in self._slides:
            slide = self.v + self.a / DAMPING
            self._slides[band] = slide if band == np.inf else self.below(band, slide)
        return self._slides[band]

    @functools.cached_property
    def held(self) -> np.ndarray:
        """Share of each sample's period in which a row is so slow that its own friction may hold it (T, nv).

        Held, friction is whatever balances: not the sign of a velocity that is nothing but noise.
        """
        still = stillness(self.frictionloss * self._softness / self.radian)
        return share_below(self.v / self.radian, still) * (self.frictionloss > 0)

    @functools.cached_property
    def _softness(self) -> np.ndarray:
        return softness(self.robot)

    def driven_link(self, row: int) -> DrivenLink:
        """A joint's motor and link, with whatever may lie between them."""
        if row not in self._driven_links:
            dq, dv, da = self.sensitivity
            self._driven_links[row] = DrivenLink(
                time=self.time,
                needed=self.link_torque[:, row],
                carried=self._carried(row),
                inertia=np.maximum(da[:, row, row] - self.armature[row], 1e-9),
                damping=dv[:, row, row] - self.damping[row],
                stiffness=dq[:, row, row],
                friction=self._own_friction(row),
                offset=float(self.offset[row]),
            )
        return self._driven_links[row]

    def predicted_link(self, row: int) -> DrivenLink:
        """The same by the motion alone: no logged torque is in it."""
        link = self.driven_link(row)
        return link.by_motion(self.below(self.prepared.bands.cutoff, link.needed))

    def rubs(self, row: int) -> bool:
        """Whether the model knows friction of a joint's own."""
        return bool(self.frictionloss[row] > 0 or self.damping[row] > 0)

    def _own_friction(self, row: int) -> OwnFriction | None:
        if not self.rubs(row):
            return None
        carried = self.tau[:, row] - self.armature[row] * self.a[:, row]
        return OwnFriction(
            speed=self.v[:, row],
            viscous=float(self.damping[row]),
            dry=float(self.frictionloss[row]),
            carried=self.below(self.prepared.bands.cutoff, carried),
        )

    def _carried(self, row: int) -> np.ndarray:
        """What a joint's coupling carries by its motor: the logged torque less what the rotor takes (T,).

        As far up as the chain looks: above, its rate would be the noise's. A friction that turned at once would jolt
        the link at each reversal.
        """
        friction = self.frictionloss[row]
        turning = self.bristle(row, self.turns_over(row)) if friction > 0 else 0.0
        carried = self.tau[:, row] - self._rotor[:, row] - friction * turning
        # Where that friction may hold the motor, or turns round, it is not known; and what a spring carries is smooth.
        known = (self.held[:, row] == 0) & ((friction == 0) | (np.abs(turning) > TURNED))
        if 0 < known.sum() < len(known):
            carried = np.interp(self.time, self.time[known], carried[known])
        return self.below(self.prepared.bands.cutoff, carried)
