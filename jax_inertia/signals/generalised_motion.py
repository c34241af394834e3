"""From joint columns by name to generalised coordinates in the robot's order.

`Motion` is what dynamics reads: q, v, τ as MuJoCo orders them, and which rows of τ were measured.
`Robot` satisfies `Joints`, the little that is needed of it here.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.logs.log import AnyArray, Log, LogError
from jax_inertia.maths.finite_difference import centred_slopes, continuous_signs, derivative
from jax_inertia.signals.filtering import Masked, mask
from jax_inertia.text.closest_names import suggestion

_Q_SIZE = {"free": 7, "ball": 4, "slide": 1, "hinge": 1}
_V_SIZE = {"free": 6, "ball": 3, "slide": 1, "hinge": 1}


@runtime_checkable
class Joints(Protocol):
    """A robot's joints: name, type ('free', 'ball', 'slide', 'hinge') and first entry in q and in
    v.
    """

    @property
    def joint_names(self) -> tuple[str, ...]: ...
    @property
    def joint_type(self) -> tuple[str, ...]: ...
    @property
    def joint_qposadr(self) -> tuple[int, ...]: ...
    @property
    def joint_dofadr(self) -> tuple[int, ...]: ...
    @property
    def nq(self) -> int: ...
    @property
    def nv(self) -> int: ...


class Motion(eqx.Module):
    """Generalised coordinates over time (leading axis T) or at one sample (none), in MuJoCo's
    order.

    `valid` marks the rows of the equations of motion that stand on measurements. `quaternions` are
    the addresses in q of unit quaternions (wxyz). `wrench` and `contact_bodies` are the log's, or
    of forces that were not measured; then `unsure` is the torque of one standard deviation of each
    number that those take for exact.
    """

    time: Float[AnyArray, "*T"]
    q: Float[AnyArray, "*T nq"]
    v: Float[AnyArray, "*T nv"]
    tau: Float[AnyArray, "*T nv"]
    valid: Bool[AnyArray, "*T nv"]
    wrench: Float[AnyArray, "*T C 6"] | None = None
    unsure: Float[AnyArray, "*T nv k"] | None = None
    contact_bodies: tuple[str, ...] = eqx.field(static=True, default=())
    quaternions: tuple[int, ...] = eqx.field(static=True, default=())
    notes: tuple[str, ...] = eqx.field(static=True, default=())


def generalised(
    log: Log | Masked,
    robot: Joints,
    fixed: Mapping[str, float | Sequence[float]] | None = None,
) -> Motion:
    """Put a log's joints, by name, and its base into q (T, nq), v (T, nv) and τ (T, nv).

    The base rows of τ are zero and valid, for nothing drives them. `fixed` gives the position of
    joints that the log lacks and that did not move (a ball joint its quaternion wxyz); their rows
    of τ are not valid. Velocities that the log lacks are central differences of positions, said in
    `Motion.notes`. Raises `LogError` naming the joints that are missing on either side, and for a
    floating base without `base_pos` and `base_quat`.
    """
    source = log if isinstance(log, Masked) else mask(log)
    data, fixed = source.log, dict(fixed or {})
    if data.tau is None:
        raise LogError("the log has no torque (tau): the equations of motion cannot be closed")
    base = _base_joint(data, robot, fixed)
    _check_names(data, robot, fixed, base)
    samples = len(data.time)
    time = np.asarray(data.time, dtype=float)
    q, v, tau = (np.zeros((samples, size)) for size in (robot.nq, robot.nv, robot.nv))
    valid = np.zeros((samples, robot.nv), dtype=bool)
    qvel, notes = _joint_velocity(data, time)
    for name, kind, qadr, vadr in zip(
        robot.joint_names, robot.joint_type, robot.joint_qposadr, robot.joint_dofadr, strict=True
    ):
        q_at, v_at = slice(qadr, qadr + _Q_SIZE[kind]), slice(vadr, vadr + _V_SIZE[kind])
        if name == base:
            q[:, q_at], v[:, v_at], base_notes = _base(data, time)
            valid[:, v_at] = source.motion_valid[:, None]
            notes += base_notes
        elif name in fixed:
            q[:, q_at] = _fixed_position(name, kind, fixed[name])
        else:
            column = data.joint_names.index(name)
            q[:, qadr], v[:, vadr] = np.asarray(data.qpos)[:, column], qvel[:, column]
            tau[:, vadr] = np.asarray(data.tau)[:, column]
            valid[:, vadr] = source.rows[:, column]
    return Motion(
        time=time,
        q=q,
        v=v,
        tau=tau,
        valid=valid,
        wrench=data.contact_wrench,
        contact_bodies=data.contact_bodies,
        quaternions=_quaternions(robot),
        notes=data.notes + notes,
    )


def body_rates(
    time: Float[np.ndarray, "T"], quat: Float[np.ndarray, "T 4"]
) -> Float[np.ndarray, "T 3"]:
    """Angular velocity in the body frame, rad/s, from unit quaternions wxyz.

    Over each interval the constant rate log(q_k⁻¹ q_{k+1}) / h, turned into rates at the stamps as
    in `centred_slopes`: second order where the axis turns, as there where it does not.
    """
    quat = continuous_signs(quat / np.linalg.norm(quat, axis=1, keepdims=True))
    w0, u0, w1, u1 = quat[:-1, :1], quat[:-1, 1:], quat[1:, :1], quat[1:, 1:]
    w = w0 * w1 + np.sum(u0 * u1, axis=1, keepdims=True)
    u = w0 * u1 - w1 * u0 - np.cross(u0, u1)
    sine = np.linalg.norm(u, axis=1, keepdims=True)
    # 2 atan2(s, w) / s tends to 2 / w as the rotation vanishes.
    scale = np.where(sine > 1e-12, 2 * np.arctan2(sine, w) / np.maximum(sine, 1e-12), 2.0)
    return centred_slopes(time, scale * u / np.diff(time)[:, None])


def _base_joint(log: Log, robot: Joints, fixed: Mapping) -> str | None:
    free = [
        n for n, kind in zip(robot.joint_names, robot.joint_type, strict=True) if kind == "free"
    ]
    free = [name for name in free if name not in fixed]
    if len(free) > 1:
        raise LogError(f"the model floats at {free}, a log has one base; fix all but one")
    if free and (log.base_pos is None or log.base_quat is None):
        raise LogError(
            f"the model floats at {free[0]!r}; the log needs base_quat, and base_pos or an IMU's base_linacc"
        )
    return free[0] if free else None


def _check_names(log: Log, robot: Joints, fixed: Mapping, base: str | None) -> None:
    kinds = dict(zip(robot.joint_names, robot.joint_type, strict=True))
    for name in fixed:
        if name not in kinds:
            raise LogError(
                f"fixed joint {name!r} is not in the model; {suggestion(name, [*kinds])}"
            )
        if name in log.joint_names:
            raise LogError(f"joint {name!r} is fixed and in the log; leave out one of the two")
    scalar = [name for name, kind in kinds.items() if kind in ("slide", "hinge")]
    for name in log.joint_names:
        if name not in scalar:
            raise LogError(
                f"the log's joint {name!r} is no hinge or slide of the model; "
                f"{suggestion(name, scalar)}"
            )
    if missing := [n for n in kinds if n not in log.joint_names and n not in fixed and n != base]:
        raise LogError(
            f"the log has no joints {missing}; log them, or give the positions they were fixed at"
        )


def _fixed_position(name: str, kind: str, value: float | Sequence[float]) -> np.ndarray:
    position = np.atleast_1d(np.asarray(value, dtype=float))
    if position.shape != (_Q_SIZE[kind],) or not np.isfinite(position).all():
        raise LogError(f"fixed joint {name!r} ({kind}) takes {_Q_SIZE[kind]} numbers, got {value}")
    if kind in ("free", "ball"):
        if not 0.9 < np.linalg.norm(position[-4:]) < 1.1:
            raise LogError(f"fixed joint {name!r} needs a unit quaternion wxyz, got {value}")
        position[-4:] /= np.linalg.norm(position[-4:])
    return position


def _joint_velocity(log: Log, time: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    if log.qvel is not None:
        return np.asarray(log.qvel), ()
    return derivative(time, np.asarray(log.qpos)), (
        "qvel is missing: taken from qpos by central differences",
    )


def _base(log: Log, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    pos, quat = np.asarray(log.base_pos), np.asarray(log.base_quat)
    norm = np.linalg.norm(quat, axis=1, keepdims=True)
    if not np.all((norm > 0.5) & (norm < 2.0)):
        k = int(np.flatnonzero(~((norm > 0.5) & (norm < 2.0)))[0])
        raise LogError(
            f"base_quat[{k}] has length {norm[k, 0]:.3g}; expected unit quaternions wxyz"
        )
    quat, notes = quat / norm, ()
    linvel, angvel = log.base_linvel, log.base_angvel
    if linvel is None:
        linvel = derivative(time, pos)
        notes += ("base_linvel is missing: taken from base_pos by central differences",)
    if angvel is None:
        angvel = body_rates(time, quat)
        notes += ("base_angvel is missing: taken from base_quat by central differences",)
    return np.hstack([pos, quat]), np.hstack([np.asarray(linvel), np.asarray(angvel)]), notes


def _quaternions(robot: Joints) -> tuple[int, ...]:
    shift = {"free": 3, "ball": 0}
    kinds = zip(robot.joint_type, robot.joint_qposadr, strict=True)
    return tuple(adr + shift[kind] for kind, adr in kinds if kind in shift)
