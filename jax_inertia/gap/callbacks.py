"""What no attribute of a model can say, done before each step: in MuJoCo C, and the same law in jnp for MJX.

    correct = callback(model, effects)          # model: corrected.xml, effects: of the diagnosis or its report.json
    while ...:
        data.qfrc_applied[:] = torque            # as logged, or as commanded
        correct(model, data)                     # now as the real joints get it
        mujoco.mj_step(model, data)

For torques, `qfrc_applied` is read and replaced; dry friction that varies is written to the model's `dof_frictionloss`,
forces on bodies to `xfrc_applied`. Time is the log's: set `data.time` to it where effects depend on it.
"""

import dataclasses
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from jax_inertia.gap.effect import Effect
from jax_inertia.gap.families.force import push_window
from jax_inertia.model.mujoco_types import MjData, MjModel

_LATE = ("time_delay", "actuator_lag")
_FRICTION = ("stribeck_friction", "load_friction")
_FORCE = ("constant_force", "push", "drag")
_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
HANDLED = frozenset(
    {*_LATE, *_FRICTION, *_FORCE, "torque_gain", "torque_saturation", "friction_drift", "cogging"}
)
"""Families that a callback acts for; the others are attributes of the model, or belong to the sensors."""


class _Moment(NamedTuple):
    """What the law looks at: positions at each row (nv,), v, u (nv,), t, turns and centres' velocities of bodies."""

    q: Any
    v: Any
    u: Any
    t: Any
    turn: Any
    """(nb, 3, 3)."""
    velocity: Any


@dataclasses.dataclass(frozen=True)
class Law:
    """Effects bound to a model's rows and bodies; `xp` is numpy or jax.numpy in all methods."""

    effects: tuple[Effect, ...]
    index: tuple[int, ...]
    """Row of a joint, index of a body, −1 for all joints."""
    adr: np.ndarray
    """Position of each row in qpos; −1 where a row has none of its own."""
    friction: np.ndarray
    """frictionloss of corrected.xml: with the constant part of what was found."""
    centres: np.ndarray
    """Of mass, of each body in its own frame (nb, 3)."""
    period: float

    def memory(self, xp: ModuleType, u) -> tuple:
        """State of what is late, as if u had always been asked for: one array for each delay or lag."""
        out = []
        for effect in self.effects:
            if effect.family == "time_delay":
                out.append(xp.tile(u, (int(effect.values["delay"] / self.period) + 2, 1)))
            elif effect.family == "actuator_lag":
                out.append(xp.array(u))
        return tuple(out)

    def late(self, xp: ModuleType, memory: tuple, u) -> tuple[tuple, Any]:
        """(memory one period on, torque as it arrives)."""
        after, rest = [], list(memory)
        for effect, index in zip(self.effects, self.index, strict=True):
            if effect.family not in _LATE:
                continue
            state = rest.pop(0)
            mine = self.adr >= 0 if index < 0 else np.arange(len(self.adr)) == index
            if effect.family == "time_delay":
                state = xp.concatenate([u[None], state[:-1]])
                whole, part = divmod(effect.values["delay"] / self.period, 1.0)
                arrived = (1 - part) * state[int(whole)] + part * state[int(whole) + 1]
            else:
                reach = 1.0 - np.exp(-self.period / max(effect.values["time_constant"], 1e-9))
                arrived = state = state + reach * (u - state)
            u = xp.where(mine, arrived, u)
            after.append(state)
        return tuple(after), u

    def __call__(self, xp: ModuleType, now: _Moment) -> tuple[Any, Any, Any]:
        """(torque on the rows, dry friction of the rows, world force and moment on each body's centre (nb, 6))."""
        tau, friction = now.u, xp.asarray(self.friction)
        bodies = len(self.centres)
        wrench = xp.zeros((bodies, 6))
        for effect, index in zip(self.effects, self.index, strict=True):
            values = effect.values
            here = np.arange(bodies if effect.kind == "body" else len(self.adr)) == index
            match effect.family:
                case "torque_gain":
                    tau = xp.where(here, values["gain"] * tau, tau)
                case "torque_saturation":
                    tau = xp.where(here, xp.clip(tau, -values["limit"], values["limit"]), tau)
                case "friction_drift":
                    warm = values["damping"] - values["damping_final"]
                    damping = warm * xp.exp(-now.t / values["time_constant"])
                    tau = tau - here * damping * now.v
                case "cogging":
                    wave = xp.sin(values["frequency"] * now.q + values["phase"])
                    tau = tau + here * values["amplitude"] * wave
                case "stribeck_friction":
                    speed = xp.abs(now.v / values["stribeck_velocity"])
                    slow = xp.exp(-(speed ** values["exponent"]))
                    friction = friction + here * (values["stiction"] - values["coulomb"]) * slow
                case "load_friction":
                    mu = values["load_coefficient"]
                    # What the link gets is the motor's less the friction itself.
                    driven = 0.0 if values["of_motor"] else mu * xp.sign(now.u * now.v)
                    loaded = (friction + mu * xp.abs(now.u)) / (1.0 + driven)
                    friction = xp.where(here, loaded, friction)
                case "constant_force":
                    wrench = wrench + here[:, None] * self._applied(xp, now, effect, index)
                case "push":
                    shape = (values[name] for name in ("start", "end", "flank", "skew"))
                    window = push_window(xp, now.t, *shape)
                    applied = self._applied(xp, now, effect, index)
                    wrench = wrench + here[:, None] * applied * window
                case "drag":
                    speed = xp.sqrt(xp.sum(now.velocity**2, axis=1, keepdims=True) + 1e-12)
                    drag = values["coefficient"] * speed * now.velocity
                    wrench = wrench - xp.concatenate([here[:, None] * drag, 0 * drag], axis=1)
        return tau, xp.maximum(friction, 0.0), wrench

    def _applied(self, xp: ModuleType, now: _Moment, effect: Effect, body: int) -> Any:
        """World force and moment about a body's centre of mass of a force there, or at a point of the body."""
        force = xp.asarray(_vector(effect.values, "force"))
        if "point_x" not in effect.values:
            return xp.concatenate([force, xp.zeros(3)])
        lever = now.turn[body] @ (_vector(effect.values, "point") - self.centres[body])
        return xp.concatenate([force, xp.cross(lever, force)])


def law(model: MjModel, effects: Sequence[Effect]) -> Law:
    """Bind the effects that need a callback; raises ValueError for a name that the model does not have."""
    mine = tuple(e for e in effects if e.family in HANDLED)
    adr = np.full(model.nv, -1)
    for j in range(model.njnt):
        if model.jnt_type[j] in _SCALAR:
            adr[model.jnt_dofadr[j]] = model.jnt_qposadr[j]
    index = tuple(_index(model, e) for e in mine)
    return Law(
        mine, index, adr, model.dof_frictionloss.copy(), model.body_ipos.copy(), model.opt.timestep
    )


def callback(model: MjModel, effects: Sequence[Effect]) -> Callable[[MjModel, MjData], None]:
    """A `Callback` for MuJoCo C; raises ValueError for a name that the model does not have."""
    return Callback(law(model, effects))


class Callback:
    """Called once before each `mj_step`; remembers what is still on its way."""

    def __init__(self, law: Law):
        self.law = law
        self._memory: tuple | None = None
        self._drags = any(e.family == "drag" for e in law.effects)
        self._rubs = any(e.family in _FRICTION for e in law.effects)

    def arrives(self, u: np.ndarray) -> np.ndarray:
        """Torque that arrives when u is asked for one period more; fills the memory without a simulation."""
        if self._memory is None:
            self._memory = self.law.memory(np, u)
        self._memory, late = self.law.late(np, self._memory, np.array(u, float))
        return late

    def __call__(self, model: MjModel, data: MjData) -> None:
        law = self.law
        if not law.effects:
            return
        u = self.arrives(data.qfrc_applied)
        q = np.where(law.adr >= 0, data.qpos[law.adr], 0.0)
        velocity = None
        if self._drags:
            velocity = _centre_velocity(np, data, model.body_rootid)
        turn = data.xmat.reshape(-1, 3, 3)
        tau, friction, wrench = law(np, _Moment(q, data.qvel, u, data.time, turn, velocity))
        data.qfrc_applied[:] = tau
        if self._rubs:
            model.dof_frictionloss[:] = friction
        for effect, body in zip(law.effects, law.index, strict=True):
            if effect.family in _FORCE:
                data.xfrc_applied[body] = wrench[body]


def mjx_callback(
    model: MjModel, effects: Sequence[Effect]
) -> tuple[Callable[..., tuple], Callable[..., tuple]]:
    """(start, step) for MJX, pure and jittable.

    `memory = start(data)`, then before each `mjx.step`: `model, data, memory = step(model, data, memory)`, with the
    torque asked for in `data.qfrc_applied`. Raises ValueError for a name that the model does not have.
    """
    bound = law(model, effects)
    frictional = any(e.family in _FRICTION for e in bound.effects)
    pushed = sorted(
        {
            body
            for effect, body in zip(bound.effects, bound.index, strict=True)
            if effect.family in _FORCE
        }
    )
    roots = np.asarray(model.body_rootid)

    def start(data) -> tuple:
        return bound.memory(jnp, data.qfrc_applied)

    def step(mx, data, memory: tuple) -> tuple:
        memory, u = bound.late(jnp, memory, data.qfrc_applied)
        velocity = _centre_velocity(jnp, data, roots)
        q = jnp.where(bound.adr >= 0, data.qpos[bound.adr], 0.0)
        now = _Moment(q, data.qvel, u, data.time, data.xmat, velocity)
        tau, friction, wrench = bound(jnp, now)
        applied: jax.Array = data.xfrc_applied
        for body in pushed:
            applied = applied.at[body].set(wrench[body])
        if frictional:
            mx = mx.replace(dof_frictionloss=friction)
        return mx, data.replace(qfrc_applied=tau, xfrc_applied=applied), memory

    return start, step


def _centre_velocity(xp: ModuleType, data, roots):
    """World velocity of each body's centre of mass; `cvel` is about the centre of its whole tree."""
    return data.cvel[:, 3:] + xp.cross(data.cvel[:, :3], data.xipos - data.subtree_com[roots])


def _vector(values, name: str) -> np.ndarray:
    return np.array([values[f"{name}_{k}"] for k in "xyz"])


def _index(model: MjModel, effect: Effect) -> int:
    """Row of a joint, index of a body, −1 for all."""
    if effect.kind == "global":
        return -1
    kind = mujoco.mjtObj.mjOBJ_JOINT if effect.kind == "joint" else mujoco.mjtObj.mjOBJ_BODY
    found = mujoco.mj_name2id(model, kind, effect.name)
    if found < 0:
        raise ValueError(f"the model has no {effect.kind} {effect.name!r}")
    return int(model.jnt_dofadr[found]) if effect.kind == "joint" else found
