"""What a log's torque is made of if its model is right: gravity, inertia, friction, a load, row by row.

One joint's torque is, for a motion (q, v, a) of the log,

    τ = g(q) + M(q) a + c(q, v) + spring + F sign(v) + d v + J a + b + load,

with friction, rotor inertia J and offset b free at every joint. `Parts` holds these columns on rows of the log, and
the same after friction, rotor inertia and offset were taken out by least squares, so that what remains is compared by
inner products alone.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jax_inertia.dynamics import rigid_body
from jax_inertia.logs.log import Log
from jax_inertia.model.robot import HINGE, Robot
from jax_inertia.signals.bands import ESTIMATE
from jax_inertia.signals.differences import central_differences
from jax_inertia.signals.filtering import low_pass, mask, resample
from jax_inertia.signals.generalised_motion import generalised
from jax_inertia.signals.held import FASTER, position_loop

ROWS = 512
"""As many moments of a log are looked at: one size, so that a robot is compiled for once."""
LAG = 0.3
"""Channels may be that late [s]."""
# Rows of a joint slower than this share of its quick ones (95th percentile) tell nothing of dry friction.
_SLOW, _STANDS = 0.1, 0.02
# Point masses of a load: in the middle, at the corners and in front of the faces of a cube about the centre of mass of
# a body that carries no other. Any body within is some mixture of them. The cube's half side is a share of the robot's
# reach, and reaches back to the body's frame.
_SHARE, _REACH = 0.25, 0.15
_CARRIERS = 3
_FEW = 100


@dataclasses.dataclass(frozen=True)
class Parts:
    """Columns on R rows of n hinges and slides, in the log's order of joints [N m or N]."""

    names: tuple[str, ...]
    period: float
    """Of the grid, on which `torque` can be shifted [s]."""
    index: np.ndarray
    """Of the rows in the grid."""
    torque: Float[np.ndarray, "T n"]
    """As logged, low-passed, on the grid."""
    used: Bool[np.ndarray, "R n"]
    friction: tuple[np.ndarray, ...]
    """An orthonormal basis of each joint's offset, rotor inertia, dry and viscous friction (R, 4), in that order."""
    motion: tuple[np.ndarray, np.ndarray, np.ndarray]
    """q, v, a of the rows."""
    robot: Robot
    rows: np.ndarray
    """Each joint's row of the equations of motion."""
    places: np.ndarray
    """Each joint's place in q."""
    kp: Float[np.ndarray, " n"] | None = None
    """Gains of the position loop whose torque it is [N m/rad]; None of a torque that was logged."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """What the joints are: hinge, slide."""
        return tuple(self.robot.joint_kinds[name] for name in self.names)

    @property
    def hinges(self) -> Bool[np.ndarray, " n"]:
        """Which joints are hinges."""
        return np.array([kind == HINGE for kind in self.kinds])

    @property
    def direction(self) -> Float[np.ndarray, " 3"]:
        """The model's gravity [m/s²]."""
        return np.asarray(self.robot.gravity)

    @functools.cached_property
    def gravity(self) -> Float[np.ndarray, "R n 3"]:
        """Torque against 1 m/s² of gravity along each axis of the world."""
        return _against_gravity(self.robot, self.motion[0])[:, self.rows]

    @functools.cached_property
    def inertia(self) -> Float[np.ndarray, "R n"]:
        """Inertial and spring torques."""
        # Made by NumPy: each small operation of jax would be compiled for itself.
        weightless = dataclasses.replace(self.robot, gravity=jnp.asarray(np.zeros(3)))
        return _needed(weightless, *self.motion)[:, self.rows]

    @functools.cached_property
    def load(self) -> Float[np.ndarray, "R n masses"]:
        """Torque against each of some point masses of 1 kg at the robot's ends."""
        robot, ends = self.robot, carriers(self.robot)
        half = min(_SHARE * reach(robot), _REACH)
        regressor = _on_rows(_regressor(ends), robot, *self.motion)[:, self.rows]
        each = [
            regressor[:, :, k] @ _points(_centre(robot, body), half).T
            for k, body in enumerate(ends)
        ]
        return np.concatenate(each, axis=-1)

    def reordered(self, motion: Sequence[int], torque: Sequence[int]) -> "Parts":
        """The same log if joint j moves as column `motion[j]` says, by the torque of column `torque[j]`."""
        motion = list(motion)
        moved = []
        for x, at in zip(self.motion, (self.places, self.rows, self.rows), strict=True):
            x = np.array(x)
            x[:, at] = x[:, at[motion]]
            moved.append(x)
        return dataclasses.replace(
            self,
            torque=self.torque[:, list(torque)],
            used=self.used[:, motion],
            friction=tuple(self.friction[k] for k in motion),
            motion=(moved[0], moved[1], moved[2]),
        )

    @property
    def weight(self) -> Float[np.ndarray, "R n"]:
        """The model's torque against gravity."""
        return self.gravity @ self.direction

    def logged(self, shifts: np.ndarray) -> Float[np.ndarray, "R n"]:
        """Each joint's torque so many samples of the grid later, less friction."""
        return np.stack([self.later(int(s), j) for j, s in enumerate(shifts)], axis=1)

    def later(self, shift: int, joint: int) -> Float[np.ndarray, " R"]:
        """The same of one joint."""
        return self.one(self.torque[self.index + shift, joint], joint)

    def one(self, x: np.ndarray, j: int) -> np.ndarray:
        """What friction of joint j leaves of columns (R, ...); zero in rows that are not used."""
        x = np.where(self.used[:, j].reshape(-1, *[1] * (x.ndim - 1)), x, 0.0)
        basis = self.friction[j]
        return x - np.tensordot(basis, basis.T @ x.reshape(len(x), -1), 1).reshape(x.shape)

    def lost(self, missing: Float[np.ndarray, "R n"]) -> Float[np.ndarray, " n"]:
        """Root mean square of what friction explains of joints' torque residual, given offset and rotor inertia."""
        out = []
        for j, basis in enumerate(self.friction):
            part = basis[:, 2:].T @ np.where(self.used[:, j], missing[:, j], 0.0)
            out.append(np.sqrt(part @ part / max(self.used[:, j].sum(), 1)))
        return np.array(out)

    def less_friction(self, x: np.ndarray) -> np.ndarray:
        """`one` of every joint: (R, n, ...) to the same shape."""
        return np.stack([self.one(x[:, j], j) for j in range(x.shape[1])], axis=1)

    def moved(self, scale: Float[np.ndarray, " n"], offset: Float[np.ndarray, " n"]) -> np.ndarray:
        """What the model needs (R, n), less friction, if its joints are at scale · position + offset."""
        q, v, a = (np.array(x) for x in self.motion)
        q[:, self.places] = q[:, self.places] * scale + offset
        v[:, self.rows] *= scale
        a[:, self.rows] *= scale
        return self.less_friction(_needed(self.robot, q, v, a)[:, self.rows])

    def at(
        self, scale: Float[np.ndarray, " n"], offset: Float[np.ndarray, " n"] | None = None
    ) -> "Parts":
        """The same log if its joints are at scale · position + offset; a loop's torque, kp (q* − q), scales along."""
        q, v, a = (np.array(x) for x in self.motion)
        q[:, self.places] = q[:, self.places] * scale + (0.0 if offset is None else offset)
        v[:, self.rows] *= scale
        a[:, self.rows] *= scale
        torque = self.torque if self.kp is None else self.torque * scale
        return dataclasses.replace(self, motion=(q, v, a), torque=torque)

    def forces(self) -> Iterator[Float[np.ndarray, "R n 3"]]:
        """Torque, less friction, against 1 N along each axis of the world at each moving body's centre of mass."""
        q, bare = self.motion[0], _bare(self.robot)
        for body in np.flatnonzero(self.robot.topology.body_dof.any(axis=1)).tolist():
            one = _with_masses(bare, body, _points(_centre(self.robot, body), 0.0)[0])
            yield self.less_friction(_against_gravity(one, q)[:, self.rows])


def parts(log: Log, robot: Robot, *, kp: Float[np.ndarray, " n"] | None = None) -> Parts | None:
    """The parts of a log's torque; None where the log does not show them: contacts, a base that floats, little motion.

    Log and robot are such as `preflight` passes; `kp`: gains of the position loop by which its torque was computed from
    its targets.
    """
    touched = log.contact_wrench is not None or bool(log.contact_bodies)
    if robot.has_free_base or touched or not all(robot.topology.dof_scalar):
        return None
    if kp is None and log.rate < FASTER and position_loop(mask(log).log) is not None:
        # Rebuilt from targets: what is off may be the loop's.
        return None
    bands = ESTIMATE.at(round(log.rate, 6))
    edge = int(np.ceil(bands.grid / bands.before))
    if log.duration * bands.grid < 4 * edge + _FEW:
        return None
    smooth = low_pass(resample(dataclasses.replace(log, qvel=None), bands.grid), bands.before)
    observation = central_differences(generalised(smooth, robot))
    motion = observation.motion
    where = dict(zip(robot.joint_names, robot.joint_dofadr, strict=True))
    at = dict(zip(robot.joint_names, robot.joint_qposadr, strict=True))
    rows = np.array([where[name] for name in log.joint_names])
    places = np.array([at[name] for name in log.joint_names])
    grid = len(motion.time)
    margin = edge + min(int(LAG * bands.grid), grid // 10)
    index = np.linspace(margin, grid - 1 - margin, min(ROWS, grid - 2 * margin)).astype(int)
    q, v, a = (np.asarray(x)[index] for x in (motion.q, motion.v, observation.a))
    speed, quick = v[:, rows], np.percentile(np.abs(np.asarray(motion.v)[:, rows]), 95, axis=0)
    used = np.asarray(motion.valid)[index][:, rows] & (np.abs(speed) > _SLOW * quick)
    used &= (quick > _STANDS) & (used.sum(axis=0) >= min(_FEW, len(index) // 4))
    friction = []
    for j in range(len(rows)):
        columns = [np.ones(len(index)), a[:, rows[j]], np.sign(speed[:, j]), speed[:, j]]
        stacked = np.stack(columns, axis=1) * used[:, [j]]
        stacked = stacked / np.maximum(np.linalg.norm(stacked, axis=0), 1e-300)
        basis, triangle = np.linalg.qr(stacked)
        friction.append(basis * (np.abs(np.diag(triangle)) > 1e-6))
    return Parts(
        log.joint_names,
        1.0 / bands.grid,
        index,
        np.asarray(motion.tau)[:, rows],
        used,
        tuple(friction),
        (q, v, a),
        robot,
        rows,
        places,
        kp,
    )


def _against_gravity(robot: Robot, q: np.ndarray) -> Float[np.ndarray, "R nv 3"]:
    """Torque against 1 m/s² of gravity along each axis of the world."""
    limp = dataclasses.replace(robot, stiffness=jnp.asarray(np.zeros(robot.nv)))
    still = np.zeros((len(q), robot.nv))
    each = (dataclasses.replace(limp, gravity=jnp.asarray(e)) for e in np.eye(3))
    return np.stack([_needed(one, q, still, still) for one in each], axis=-1)


def _bare(robot: Robot) -> Robot:
    """The robot without springs, rotors and held weights."""
    none = jnp.asarray(np.zeros(robot.nv))
    bare = dataclasses.replace(robot, stiffness=none, armature=none)
    if robot.compensated is not None:
        bare = dataclasses.replace(bare, compensated=jnp.asarray(np.zeros(robot.compensated.shape)))
    return bare


def _with_masses(robot: Robot, body: int, pi: Float[np.ndarray, "10"]) -> Robot:
    """The robot with one body's inertial parameters, and nothing else that weighs."""
    every = np.zeros((robot.nb, 10))
    every[body] = pi
    return dataclasses.replace(robot, pi=jnp.asarray(every))


def _needed(robot: Robot, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> Float[np.ndarray, "R nv"]:
    """Torque that the model needs without its dry and viscous friction."""
    none = jnp.asarray(np.zeros(robot.nv))
    robot = dataclasses.replace(robot, frictionloss=none, damping=none)
    return _on_rows(_torque, robot, q, v, a)


def _on_rows(
    function: Callable[..., Array], robot: Robot, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> Float[np.ndarray, "R ..."]:
    """A compiled function of a robot and `ROWS` samples, on no more than so many."""
    count = len(q)
    padded = [np.concatenate([x, np.repeat(x[-1:], ROWS - count, axis=0)]) for x in (q, v, a)]
    return np.asarray(function(robot, *padded))[:count]


def _compiled(function: Callable[..., Array]) -> Callable[..., Array]:
    """`function` of a robot, q, v and a, compiled for a row of samples.

    It runs in a few milliseconds; to compile it with all optimisation takes far longer.
    """
    return eqx.filter_jit(  # pyright: ignore[reportCallIssue]
        jax.vmap(function, in_axes=(None, 0, 0, 0)),
        compiler_options={"xla_backend_optimization_level": 0},
    )


@_compiled
def _torque(robot: Robot, q: Array, v: Array, a: Array) -> Array:
    passive = rigid_body.passive_torque(robot, q, v)
    return rigid_body.inverse_dynamics(robot, q, v, a) - passive


@functools.cache
def _regressor(bodies: tuple[int, ...]) -> Callable[..., Array]:
    """The same of some bodies' inertial parameters (nv, bodies, 10): a torque is linear in them."""
    return _compiled(functools.partial(rigid_body.torque_regressor, bodies=bodies))


def reach(robot: Robot) -> float:
    """Sum of the distances from joint to joint [m], and at least a decimetre."""
    return max(float(np.linalg.norm(robot.placement_position, axis=1)[1:].sum()), 0.1)


def carriers(robot: Robot) -> tuple[int, ...]:
    """Bodies that carry no other, by index; those at the end of the longest chains where there are many."""
    moves = robot.topology.body_dof
    inner = {
        i
        for i in range(robot.nb)
        for j in range(robot.nb)
        if moves[j].sum() > moves[i].sum() and np.all(moves[j] >= moves[i])
    }
    ends = [i for i in range(robot.nb) if i not in inner]
    return tuple(sorted(ends, key=lambda i: -moves[i].sum())[:_CARRIERS])


def _centre(robot: Robot, body: int) -> Float[np.ndarray, "3"]:
    """Centre of mass of a body in its frame [m]."""
    pi = np.asarray(robot.pi)[body]
    return pi[1:4] / max(float(pi[0]), 1e-12)


def _points(centre: Float[np.ndarray, "3"], half: float) -> Float[np.ndarray, "masses 10"]:
    """Inertial parameters of 1 kg at each of some points."""
    half = max(half, float(np.linalg.norm(centre)))
    corners = half * np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
    rows = []
    faces = half * np.concatenate([np.eye(3), -np.eye(3)])
    for c in centre + np.concatenate([np.zeros((1, 3)), corners, faces]):
        i = c @ c * np.eye(3) - np.outer(c, c)
        rows.append([1.0, *c, i[0, 0], i[0, 1], i[0, 2], i[1, 1], i[1, 2], i[2, 2]])
    return np.array(rows)
