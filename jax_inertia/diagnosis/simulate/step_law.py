"""What no attribute of a model can say, done before each step: in MuJoCo C, and the same law in jnp for MJX.

    correct = callback(model, effects)          # model: corrected.xml, effects: of the diagnosis or its report.json
    while ...:
        data.qfrc_applied[:] = torque            # as logged, or as commanded
        correct(model, data)                     # now as the real joints get it
        mujoco.mj_step(model, data)

For torques, `qfrc_applied` is read and replaced; dry friction that varies is written to the model's `dof_frictionloss`,
forces on bodies to `xfrc_applied`. Time is the log's: set `data.time` to it where effects depend on it. Effects of your
own (`diagnose(..., extra=...)`) are given here as `extra` too.
"""

import dataclasses
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from jax_inertia.diagnosis.effects.base import Applied, Bound, Effect, Moment, row_of
from jax_inertia.diagnosis.effects.identified import Identified
from jax_inertia.diagnosis.effects.registry import known
from jax_inertia.maths.batch_last import cross
from jax_inertia.model.mujoco_types import MjData, MjModel

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


@dataclasses.dataclass(frozen=True)
class Law:
    """Effects bound to a model's rows and bodies; `xp` is numpy or jax.numpy in all methods."""

    parts: tuple[tuple[Effect, Bound], ...]
    adr: np.ndarray
    """Position of each row in qpos; −1 where a row has none of its own."""
    friction: np.ndarray
    """frictionloss of the model: with the constant part of what was found."""
    bodies: int

    def memory(self, xp: ModuleType, u) -> tuple:
        """State of what is late, as if u had always been asked for: one for each effect, None of most."""
        return tuple(effect.memory(xp, at, u) for effect, at in self.parts)

    def late(self, xp: ModuleType, memory: tuple, u) -> tuple[tuple, Any]:
        """(memory one period on, torque as it arrives)."""
        after = []
        for (effect, at), state in zip(self.parts, memory, strict=True):
            if state is not None:
                state, u = effect.late(xp, at, state, u)
            after.append(state)
        return tuple(after), u

    def __call__(self, xp: ModuleType, now: Moment) -> Applied:
        """Torque on the rows, their dry friction, and what acts on the bodies."""
        applied = Applied(now.u, xp.asarray(self.friction), xp.zeros((self.bodies, 6)))
        for effect, at in self.parts:
            if effect.acts:
                applied = effect.step(xp, now, at, applied)
        return applied._replace(friction=xp.maximum(applied.friction, 0.0))

    @property
    def pushed(self) -> list[int]:
        """Bodies that effects act on."""
        return sorted({at.index for effect, at in self.parts if effect.kind == "body"})


def law(
    model: MjModel,
    effects: Sequence[Identified],
    extra: Sequence[Effect] = (),
    *,
    mjx: bool = False,
) -> Law:
    """Bind the effects that a model's attributes cannot hold; ValueError for a name that the model does not have."""
    adr = np.full(model.nv, -1)
    for j in range(model.njnt):
        if model.jnt_type[j] in _SCALAR:
            adr[model.jnt_dofadr[j]] = model.jnt_qposadr[j]
    parts = []
    for found in effects:
        effect = known(found.family, extra)
        if effect is not None and effect.by_step and (mjx or not effect.unread_by_mjx):
            at = Bound(
                values=found.values,
                index=row_of(model, found.kind, found.name),
                other=row_of(model, "joint", found.other) if found.other else -1,
                driven=adr >= 0,
                centres=model.body_ipos.copy(),
                period=model.opt.timestep,
            )
            parts.append((effect, at))
    return Law(tuple(parts), adr, model.dof_frictionloss.copy(), model.nbody)


def callback(
    model: MjModel, effects: Sequence[Identified], extra: Sequence[Effect] = ()
) -> Callable[[MjModel, MjData], None]:
    """A `Callback` for MuJoCo C; raises ValueError for a name that the model does not have.

    >>> import mujoco
    >>> from jax_inertia.diagnosis.effects.identified import Identified
    >>> from jax_inertia.diagnosis.simulate.step_law import callback
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> model = double_pendulum()
    >>> correct = callback(model, [Identified("torque_gain", "joint", "elbow", {"gain": 0.8})])
    >>> data = mujoco.MjData(model)
    >>> data.qfrc_applied[:] = 1.0, 2.0
    >>> correct(model, data)
    >>> data.qfrc_applied.tolist()
    [1.0, 1.6]
    """
    return Callback(law(model, effects, extra))


class Callback:
    """Called once before each `mj_step`; remembers what is still on its way."""

    def __init__(self, law: Law):
        self.law = law
        self._memory: tuple | None = None

    def arrives(self, u: np.ndarray) -> np.ndarray:
        """Torque that arrives when u is asked for one period more; fills the memory without a simulation."""
        if self._memory is None:
            self._memory = self.law.memory(np, u)
        self._memory, late = self.law.late(np, self._memory, np.array(u, float))
        return late

    def __call__(self, model: MjModel, data: MjData) -> None:
        law = self.law
        if not law.parts:
            return
        u = self.arrives(data.qfrc_applied)
        q = np.where(law.adr >= 0, data.qpos[law.adr], 0.0)
        velocity = None
        if law.pushed:
            velocity = centre_velocity(data, model.body_rootid)
        turn = data.xmat.reshape(-1, 3, 3)
        applied = law(np, Moment(q, data.qvel, u, data.time, turn, velocity))
        data.qfrc_applied[:] = applied.torque
        if any(effect.rubs for effect, _ in law.parts):
            model.dof_frictionloss[:] = applied.friction
        for body in law.pushed:
            data.xfrc_applied[body] = applied.wrench[body]


def mjx_callback(
    model: MjModel, effects: Sequence[Identified], extra: Sequence[Effect] = ()
) -> tuple[Callable[..., tuple], Callable[..., tuple]]:
    """(start, step) for MJX, pure and jittable.

    `memory = start(data)`, then before each `mjx.step`: `model, data, memory = step(model, data, memory)`, with the
    torque asked for in `data.qfrc_applied`. Raises ValueError for a name that the model does not have.

    >>> import contextlib, io
    >>> import jax.numpy as jnp
    >>> with contextlib.redirect_stdout(io.StringIO()):
    ...     from mujoco import mjx
    >>> from jax_inertia.diagnosis.effects.identified import Identified
    >>> from jax_inertia.diagnosis.simulate.step_law import mjx_callback
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> model = double_pendulum()
    >>> gain = Identified("torque_gain", "joint", "elbow", {"gain": 0.8})
    >>> start, step = mjx_callback(model, [gain])
    >>> data = mjx.make_data(model).replace(qfrc_applied=jnp.array([1.0, 2.0]))
    >>> _, data, _ = step(mjx.put_model(model), data, start(data))
    >>> [round(float(x), 3) for x in data.qfrc_applied]
    [1.0, 1.6]
    """
    bound = law(model, effects, extra, mjx=True)
    frictional = any(effect.rubs for effect, _ in bound.parts)
    pushed, roots = bound.pushed, np.asarray(model.body_rootid)

    def start(data) -> tuple:
        return bound.memory(jnp, data.qfrc_applied)

    def step(mx, data, memory: tuple) -> tuple:
        memory, u = bound.late(jnp, memory, data.qfrc_applied)
        velocity = centre_velocity(data, roots)
        q = jnp.where(bound.adr >= 0, data.qpos[bound.adr], 0.0)
        now = Moment(q, data.qvel, u, data.time, data.xmat, velocity)
        torque, friction, wrench = bound(jnp, now)
        applied: jax.Array = data.xfrc_applied
        for body in pushed:
            applied = applied.at[body].set(wrench[body])
        if frictional:
            mx = mx.replace(dof_frictionloss=friction)
        return mx, data.replace(qfrc_applied=torque, xfrc_applied=applied), memory

    return start, step


def centre_velocity(data, roots):
    """World velocity of each body's centre of mass; `cvel` is about the centre of its whole tree."""
    turning, arm = data.cvel[:, :3], data.xipos - data.subtree_com[roots]
    return data.cvel[:, 3:] + cross(turning, arm)
