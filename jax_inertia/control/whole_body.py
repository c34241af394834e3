"""Whole-body control by one quadratic program a tick, as the paper's robot has it (Foster et al., sec. III-D).

    min over v̇, λ   Σ_tasks w ‖A v̇ + b − d‖² + ε ‖λ‖²
    subject to      the six floating-base rows of  M v̇ + c = Sᵀ τ + Jᵀ λ,   λ in the friction pyramid,   |τ| ≤ τ_max

λ is written by the pyramid's edges, f ≥ 0, four at every contact point. Given f, the best v̇ is a linear solve, so v̇
is eliminated and what `qp.solve` sees is small: with H = Σ AᵀwA, g = Σ Aᵀw(d − b) and base rows M_b v̇ = F f − c_b,

    v̇ = H⁻¹ (g + M_bᵀ μ),   μ = Λ (F f − r),   Λ = (M_b H⁻¹ M_bᵀ)⁻¹,   r = c_b + M_b H⁻¹ g,

and the cost left is ½ (F f − r)ᵀ Λ (F f − r) + ½ ε ‖f‖². Torque limits are linear in f, and soft, so that there is
always an answer; torques are clipped to them at the end. The robot comes with every tick: its inertial parameters may
be the estimator's latest (`Robot.with_pi`).
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_solve
from jaxtyping import Array, Bool, Float

from jax_inertia.control.qp import Program, solve
from jax_inertia.control.terms import Terms, terms
from jax_inertia.maths import spatial
from jax_inertia.model.robot import Robot

PELVIS, TORSO, LEFT, RIGHT = range(4)
# Arrays where a loop is compiled once for all gains.
_Pair = tuple[float | Float[Array, ""], float | Float[Array, ""]]
_TOLERANCE = 1e-3  # of the forces, far below what a contact model is worth
_EDGES = np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, -1.0, 1.0]])


class Reference(eqx.Module):
    """What the robot should do now; world axes, SI."""

    com_acceleration: Float[Array, "2"]
    height: Float[Array, "3"]
    """Pelvis height, its velocity and its acceleration."""
    heading: Float[Array, ""]
    """Yaw of pelvis and torso; both are kept upright [rad]."""
    foot: Float[Array, "2 3 3"]
    """Position, velocity and acceleration of each foot's frame, for a foot in the air."""
    foot_heading: Float[Array, "2"]
    contact: Float[Array, " points"]
    """How much of its full force each contact point may carry, 0 to 1."""
    stance: Float[Array, "2"]
    """1 for a foot that must not move, 0 for one that follows `foot`."""
    posture: Float[Array, "3 nu"]
    """Joint positions, velocities and accelerations, for what no other task needs."""


class Gains(eqx.Module):
    """Feedback of the tasks, (1/s², 1/s), and their weights; a task's error is in m/s² or rad/s²."""

    height: tuple[float, float] = (120.0, 22.0)
    orientation: tuple[float, float] = (120.0, 22.0)
    foot: tuple[float, float] = (300.0, 35.0)
    stance_damping: float = 20.0
    momentum_damping: float = 3.0
    posture: tuple[float, float] = (100.0, 20.0)

    com_weight: float = 10.0
    height_weight: float = 20.0
    orientation_weight: float = 10.0
    torso_weight: float = 5.0
    stance_weight: float = 1000.0
    swing_weight: float = 100.0
    momentum_weight: float = 0.02
    """Times (kg m²/s²)² per kg² of the robot."""
    arm_weight: float = 1.0
    other_weight: float = 1e-3
    force_weight: float = 1e-3
    """ε, with forces in units of the robot's weight shared by all points."""
    torque_softness: float = 1e-4


_GAINS = Gains()


class Command(eqx.Module):
    """Joint torques, and what the controller expects of them."""

    torque: Float[Array, " nu"]
    acceleration: Float[Array, " nv"]
    force: Float[Array, "points 3"]
    """Force that each contact point should carry, world axes [N]."""
    residual: Float[Array, ""]
    converged: Bool[Array, ""]


class WholeBody(eqx.Module):
    """The controller's constants; make one with `make_whole_body`."""

    torque_limit: Float[Array, " nu"]
    points: Float[Array, "2 per_foot 3"]
    """Contact points in their foot's frame [m]."""
    friction: Float[Array, ""]
    arm: tuple[bool, ...] = eqx.field(static=True)
    bodies: tuple[int, ...] = eqx.field(static=True)
    gains: Gains = _GAINS
    iterations: int = eqx.field(static=True, default=7)

    def terms(self, robot: Robot, q: Float[Array, " nq"], v: Float[Array, " nv"]) -> Terms:
        """Kinematics and dynamics at (q, v); bodies in the order PELVIS, TORSO, LEFT, RIGHT."""
        return terms(robot, q, v, self.bodies)

    def command(
        self, now: Terms, q: Float[Array, " nq"], v: Float[Array, " nv"], reference: Reference
    ) -> Command:
        """Torques for this tick; `converged` says whether the program was solved, within limits they are always."""
        rows, wanted, weight = self._tasks(now, q, v, reference)
        posture, posture_weight = self._posture(q, v, reference)
        nv = len(v)
        h = (rows.T * weight) @ rows
        h = h + jnp.diag(jnp.concatenate([jnp.full(6, 1e-4, q.dtype), posture_weight]))
        g = (rows.T * weight) @ wanted
        g = g.at[6:].add(posture_weight * posture)

        unit = now.weight * 9.81 / reference.contact.size
        generalised, edges = self._contact(now, reference)
        generalised = generalised * unit
        base, f_base = now.mass[:6], generalised[:6]
        solved = _solve_positive(h, jnp.concatenate([g[:, None], base.T], axis=1))
        free, shape = solved[:, 0], solved[:, 1:]
        compliance = base @ shape
        r = now.bias[:6] + base @ free
        push = _solve_positive(compliance, jnp.concatenate([f_base, r[:, None]], axis=1))
        n = f_base.shape[1]
        # v̇ = free + shape (push f − push r)
        per_force = shape @ push[:, :n]
        rest = free - shape @ push[:, n]
        per_torque = now.mass[6:] @ per_force - generalised[6:]
        torque_rest = now.mass[6:] @ rest + now.bias[6:]
        limit = self.torque_limit
        program = Program(
            p=f_base.T @ push[:, :n] + self.gains.force_weight * jnp.eye(n, dtype=q.dtype),
            q=-f_base.T @ push[:, n],
            c=jnp.concatenate([jnp.eye(n, dtype=q.dtype), per_torque / limit[:, None]]),
            lower=jnp.concatenate([jnp.zeros(n, q.dtype), -1.0 - torque_rest / limit]),
            upper=jnp.concatenate([jnp.full(n, jnp.inf, q.dtype), 1.0 - torque_rest / limit]),
            softness=jnp.concatenate(
                [jnp.zeros(n, q.dtype), jnp.full(nv - 6, self.gains.torque_softness, q.dtype)]
            ),
        )
        found = solve(program, iterations=self.iterations, tolerance=_TOLERANCE)
        f = jnp.maximum(found.x, 0.0)
        torque = jnp.clip(torque_rest + per_torque @ f, -limit, limit)
        force = jnp.sum((edges * (unit * f)[:, None]).reshape(-1, 4, 3), axis=1)
        return Command(torque, rest + per_force @ f, force, found.residual, found.converged)

    def _tasks(
        self, now: Terms, q: Float[Array, " nq"], v: Float[Array, " nv"], reference: Reference
    ) -> tuple[Float[Array, "rows nv"], Float[Array, " rows"], Float[Array, " rows"]]:
        """(A, d − b, w) of all tasks but posture."""
        gains, nv = self.gains, len(v)
        height = reference.height
        up = height[2] + _pd(gains.height, height[0] - q[2], height[1] - v[2])
        turn = _yaw(reference.heading)
        spin = [self._upright(now, i, turn, gains.orientation) for i in (PELVIS, TORSO)]
        calm = -gains.momentum_damping * now.momentum
        feet = [self._foot(now, i, reference) for i in (0, 1)]
        rows = [
            now.com_jacobian[:2],
            jnp.eye(nv, dtype=q.dtype)[2:3],
            *(now.jacobian[i, 3:] for i in (PELVIS, TORSO)),
            now.momentum_jacobian / now.weight,
            *(now.jacobian[i] for i in (LEFT, RIGHT)),
        ]
        wanted = [
            reference.com_acceleration - now.com_bias[:2],
            up[None],
            *(spin[k] - now.jacobian_bias[i, 3:] for k, i in enumerate((PELVIS, TORSO))),
            (calm - now.momentum_bias) / now.weight,
            *(feet[k] - now.jacobian_bias[i] for k, i in enumerate((LEFT, RIGHT))),
        ]
        sizes = [gains.com_weight] * 2 + [gains.height_weight]
        sizes += [gains.orientation_weight] * 3 + [gains.torso_weight] * 3
        sizes += [gains.momentum_weight * 100.0] * 3
        foot = jnp.where(reference.stance > 0.5, gains.stance_weight, gains.swing_weight)
        weight = jnp.concatenate([jnp.array(sizes, q.dtype), jnp.repeat(foot.astype(q.dtype), 6)])
        return jnp.concatenate(rows), jnp.concatenate(wanted), weight

    def _posture(
        self, q: Float[Array, " nq"], v: Float[Array, " nv"], reference: Reference
    ) -> tuple[Float[Array, " nu"], Float[Array, " nu"]]:
        want = reference.posture
        gains = self.gains
        acceleration = want[2] + _pd(gains.posture, want[0] - q[7:], want[1] - v[6:])
        weight = jnp.where(np.array(self.arm), gains.arm_weight, gains.other_weight)
        return acceleration, weight.astype(q.dtype)

    def _upright(
        self, now: Terms, body: int, turn: Float[Array, "3 3"], gain: _Pair
    ) -> Float[Array, "3"]:
        return _pd(gain, _rotation_error(now.rotation[body], turn), -now.velocity[body, 3:])

    def _foot(self, now: Terms, side: int, reference: Reference) -> Float[Array, "6"]:
        body, gain = (LEFT, RIGHT)[side], self.gains.foot
        want = reference.foot[side]
        move = want[2] + _pd(gain, want[0] - now.position[body], want[1] - now.velocity[body, :3])
        turn = self._upright(now, body, _yaw(reference.foot_heading[side]), gain)
        held = -self.gains.stance_damping * now.velocity[body]
        return jnp.where(reference.stance[side] > 0.5, held, jnp.concatenate([move, turn]))

    def _contact(
        self, now: Terms, reference: Reference
    ) -> tuple[Float[Array, "nv edges"], Float[Array, "edges 3"]]:
        """Generalised force of each pyramid edge, and the edges [unit of normal force]."""
        friction = jnp.array([1.0, 1.0, 0.0]) * self.friction + jnp.array([0.0, 0.0, 1.0])
        edges = jnp.asarray(_EDGES, now.bias.dtype) * friction.astype(now.bias.dtype)
        out, share = [], reference.contact.reshape(2, -1)
        for side, body in enumerate((LEFT, RIGHT)):
            arm = self.points[side] @ now.rotation[body].T
            moment = spatial.cross(arm[:, None], edges[None])
            wrench = jnp.concatenate([jnp.broadcast_to(edges, moment.shape), moment], axis=-1)
            wrench = wrench * share[side][:, None, None]
            out.append(wrench.reshape(-1, 6) @ now.jacobian[body])
        scaled = edges[None] * reference.contact[:, None, None]
        return jnp.concatenate(out).T, scaled.reshape(-1, 3)


def make_whole_body(
    robot: Robot,
    *,
    pelvis: str,
    torso: str,
    feet: tuple[str, str],
    points: Float[np.ndarray, "2 per_foot 3"],
    friction: float,
    torque_limit: Float[np.ndarray, " nu"],
    arm_joints: Sequence[str],
    gains: Gains = _GAINS,
    iterations: int = 7,
) -> WholeBody:
    """Controller of a robot with a floating base on `pelvis` and one motor for every other joint.

    Raises ValueError for a robot without a free base or with ball joints, or names that it does not have.
    """
    if not robot.has_free_base or robot.nq != robot.nv + 1:
        raise ValueError("whole-body control needs a free base, and hinges or slides elsewhere")
    if torque_limit.shape != (robot.nv - 6,):
        raise ValueError(
            f"torque_limit has shape {torque_limit.shape}; expected one for each of {robot.nv - 6} joints"
        )
    bodies = tuple(robot.body_index(name) for name in (pelvis, torso, *feet))
    if bodies[0] != 0:
        raise ValueError(f"{pelvis!r} is not the base; that is {robot.body_names[0]!r}")
    moved = {robot.joint_dofadr[robot.joint_index(name)] - 6 for name in arm_joints}
    return WholeBody(
        torque_limit=jnp.asarray(torque_limit),
        points=jnp.asarray(points),
        friction=jnp.asarray(friction),
        arm=tuple(i in moved for i in range(robot.nv - 6)),
        bodies=bodies,
        gains=gains,
        iterations=iterations,
    )


def _pd(gain: _Pair, error: Float[Array, "*n"], rate: Float[Array, "*n"]) -> Float[Array, "*n"]:
    return gain[0] * error + gain[1] * rate


def _yaw(angle: Float[Array, ""]) -> Float[Array, "3 3"]:
    return spatial.axis_angle_to_matrix(jnp.array([0.0, 0.0, 1.0], angle.dtype), angle)


def _rotation_error(now: Float[Array, "3 3"], want: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """World axes; sin of the angle between them along its axis: ½ Σ now_i × want_i."""
    return 0.5 * jnp.sum(spatial.cross(now.T, want.T), axis=0)


def _solve_positive(m: Float[Array, "n n"], b: Float[Array, "n k"]) -> Float[Array, "n k"]:
    """m⁻¹ b for a positive-definite m, by Cholesky after scaling its diagonal to one."""
    scale = 1.0 / jnp.sqrt(jnp.diagonal(m))
    factor = jnp.linalg.cholesky(m * scale[:, None] * scale[None, :])
    return scale[:, None] * cho_solve((factor, True), scale[:, None] * b)
