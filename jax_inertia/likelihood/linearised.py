"""A robot's equations of motion along a motion: what it needs, linearised, and what columns of effects read of it.

    needed(q, q̇, q̈) = M q̈ + c − τ_passive,   M = ∂/∂q̈,   H_v = ∂/∂q̇,   H_q = ∂/∂q        (forward-mode derivatives)

Dry friction is left out: it is a column of its own, and holds a joint (`response.Loop.held`).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jax_inertia.diagnosis.features import derivatives
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.dynamics import rigid_body
from jax_inertia.likelihood.motion import Moments
from jax_inertia.logs.log import AnyArray
from jax_inertia.maths.over_samples import OverSamples
from jax_inertia.model.robot import HINGE, SLIDE, Robot
from jax_inertia.signals.bands import DIAGNOSIS
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.generalised_motion import Motion
from jax_inertia.signals.torque_residual import Prepared, without_friction

REFRESHED = 0.01
"""The matrices are computed this often [s]: a robot's posture changes little in that time."""


class Joints(eqx.Module):
    """Where a log's joints are in a robot, and where all other joints stay."""

    names: tuple[str, ...] = eqx.field(static=True)
    dofs: tuple[int, ...] = eqx.field(static=True)
    qadr: tuple[int, ...] = eqx.field(static=True)
    rest: Float[AnyArray, " nq"]
    """Reference position."""

    def whole(self, q: Float[AnyArray, "*T n"]) -> Float[Array, "*T nq"]:
        """All positions, of the joints' ones."""
        out = jnp.broadcast_to(self.rest, (*q.shape[:-1], len(self.rest)))
        return out.at[..., np.array(self.qadr)].set(q)

    def rates(self, v: Float[AnyArray, "*T n"]) -> Float[Array, "*T nv"]:
        """All velocities, accelerations or torques, of the joints' ones; of scalar joints nv is nq."""
        out = jnp.zeros((*v.shape[:-1], len(self.rest)), v.dtype)
        return out.at[..., np.array(self.dofs)].set(v)


def joints_of(robot: Robot, names: tuple[str, ...]) -> Joints | None:
    """The named joints; None where the linear response does not hold: chains that close, joints that follow others.

    Joints that the log does not have are taken to stay at their reference.
    """
    scalar = all(kind in (HINGE, SLIDE) for kind in robot.joint_type)
    if not scalar or robot.loops or robot.driven or not set(names) <= set(robot.joint_names):
        return None
    at = [robot.joint_index(name) for name in names]
    rest = np.zeros(robot.nq)
    nodes = robot.topology
    for kind, adr, value in zip(
        nodes.kind, nodes.qpos_adr, np.asarray(robot.joint_reference), strict=True
    ):
        if kind in (HINGE, SLIDE):
            rest[adr] = value
    dofs, qadr = ([int(x[k]) for k in at] for x in (robot.joint_dofadr, robot.joint_qposadr))
    return Joints(tuple(names), tuple(dofs), tuple(qadr), jnp.asarray(rest))


class Matrices(NamedTuple):
    """Along a motion, of the log's joints."""

    mass: Float[AnyArray, "*K n n"]
    damping: Float[AnyArray, "*K n n"]
    """∂needed/∂q̇, the model's own damping with it."""
    stiffness: Float[AnyArray, "*K n n"]


def needed(
    robot: Robot,
    joints: Joints,
    q: Float[Array, " n"],
    v: Float[Array, " n"],
    a: Float[Array, " n"],
) -> Float[Array, " n"]:
    """Torque of the log's joints that the model needs for a moment, dry friction apart [N m]."""
    smooth = eqx.tree_at(lambda r: r.frictionloss, robot, jnp.zeros_like(robot.frictionloss))
    full = joints.whole(q), joints.rates(v), joints.rates(a)
    rigid = rigid_body.inverse_dynamics(smooth, *full)
    return (rigid - rigid_body.passive_torque(smooth, *full[:2]))[np.array(joints.dofs)]


def linearised(shared: tuple[Robot, Joints], x: tuple[Array, Array, Array]) -> Matrices:
    """`Matrices` of one moment (q, q̇, q̈)."""
    dq, dv, da = jax.jacfwd(lambda *y: needed(*shared, *y), argnums=(0, 1, 2))(*x)
    return Matrices(da, dv, dq)


_linearised = OverSamples(linearised)


@OverSamples
def _passive(robot, x):
    """Passive torque at (q, q̇) (T, nv)."""
    return rigid_body.passive_torque(robot, *x)


def matrices(robot: Robot, joints: Joints, moments: Moments, every: int) -> Matrices:
    """`Matrices` at each moment, computed at every `every`-th and held between."""
    some = tuple(np.asarray(x)[::every] for x in (moments.q, moments.v, moments.a))
    found = _linearised((robot, joints), some)
    return Matrices(*(np.repeat(x, every, axis=0)[: len(moments.q)] for x in found))


def context(
    robot: Robot,
    joints: Joints,
    time: Float[np.ndarray, " K"],
    moments: Moments,
) -> Context:
    """What the effects of the library read of a motion; what the loop gives along it, its `tau`, is 0."""
    q = np.asarray(joints.whole(jnp.asarray(moments.q)))
    v, a, side = (
        np.asarray(joints.rates(jnp.asarray(x))) for x in (moments.v, moments.a, moments.side)
    )
    tau = np.zeros_like(v)
    rigid = derivatives.regressor(robot, (q, v, a))
    inverse = np.einsum("tjbk,bk->tj", rigid, np.asarray(robot.pi)) + np.asarray(robot.armature) * a
    smooth = without_friction(robot)
    passive = np.asarray(_passive(smooth, (q, v)))
    seen = Motion(time, q, v, tau, np.ones(v.shape, bool))
    rate = 1.0 / float(time[1] - time[0])
    prepared = Prepared(
        robot, Observation(seen, a), tau, inverse - passive, np.zeros(v.shape, bool), np.zeros_like(v),
        np.ones_like(v), DIAGNOSIS.at(rate), rate,
    )  # fmt: skip
    out = Context(prepared)
    # Its own direction has nothing at rest, where friction is whatever balances.
    out.side = side
    # A cached property lives in the instance's dictionary.
    out.__dict__["regressor"] = rigid
    return out
