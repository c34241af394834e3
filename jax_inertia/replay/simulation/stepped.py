"""Replays whose joints change along the motion, by friction that varies or at a limit: set anew between rollouts."""

import os
from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from mujoco import rollout

from jax_inertia.model.mujoco_types import MjModel
from jax_inertia.replay.joint_numbers import NOT_OF_JOINTS, Numbers
from jax_inertia.replay.simulation.model_edits import maxwell
from jax_inertia.replay.simulation.plant import Compiled, Plant

_EVERY = 2e-3
"""Friction that varies is set anew this often [s], and no more than once a step."""
_SHORT = 9e-4
"""Steps that are short enough for a limit as MuJoCo has it [s]."""
PARTS = 4
"""Of a step, in which it is asked whether a limit cuts off what is asked for."""
_A_THREAD = 8


def stepped_at(plant: Plant, x: Numbers) -> Bool[np.ndarray, " n"]:
    """Joints that change along the motion."""
    return x.varies_at | limited_at(plant, x) | (x.behind > 0)


def limited_at(plant: Plant, x: Numbers) -> Bool[np.ndarray, " n"]:
    """Joints with a limit that the model does not have, where steps are so long that it matters how it is reached.

    In the model's own steps it is reached as MuJoCo has it.
    """
    own = np.isfinite(x.limit) & (x.limit != plant.loop.limit) & ~x.shares_limit
    return own & (plant.step > max(_SHORT, plant.own.step))


def stepwise(
    m: Compiled,
    joints: Int[np.ndarray, " j"],
    limited: Bool[np.ndarray, "B j"],
    models: Sequence[MjModel],
    some: Sequence[Numbers],
    state: Float[np.ndarray, "B s"],
    control: Float[np.ndarray, "B K u"],
    commanded: Float[np.ndarray, "B K p j"],
    h: float,
    lacking: float,
) -> Float[np.ndarray, "B K s"]:
    """States after each step h; `commanded`: what `joints` are, in parts of a step, without the encoders' offset.

    `lacking`: of kd, what inertia a plant lacks for its steps [s].
    """
    lagging = any(np.any(x.behind > 0) for x in some)
    every = 1 if limited.any() or lagging else max(round(_EVERY / h), 1)
    steps, nq = control.shape[1], m.model.nq
    path = np.empty((len(models), steps, state.shape[1]))
    fields = [k for k in Numbers._fields if k not in NOT_OF_JOINTS]
    of_joints = {k: np.stack([getattr(x, k)[joints] for x in some]) for k in fields}
    stacked = Numbers(
        **of_joints, mass={}, centres={}, shifts={}, heavier={}, forces={}, tilt=np.zeros(2)
    )
    q_of, v_of = 1 + m.qadr[joints], 1 + nq + m.dof[joints]
    losses, dofs = [model.dof_frictionloss for model in models], m.dof[joints]
    varies = any(x.varies for x in some)
    lag = _Lag(m, joints, stacked, h) if lagging else None
    limits = _Limits(m, joints, limited, models, stacked, lacking) if limited.any() else None
    # A thread is worth its wake-up for several models, each of a step or two; one alone only waits for another.
    threads = min(cores() // 2, len(models) // _A_THREAD)
    threads = threads if threads > 1 else 0
    data, now = [mujoco.MjData(m.model) for _ in range(max(threads, 1))], state
    mean = np.ascontiguousarray(commanded.mean(axis=2).swapaxes(0, 1))
    part = np.empty((len(models), every, state.shape[1]))
    seen = np.empty((len(models), every, m.model.nsensordata))
    with rollout.Rollout(nthread=threads) as roll:
        for k in range(0, steps, every):
            q, v = now[:, q_of], now[:, v_of]
            if varies:
                dry = stacked.friction(stacked.torque(mean[k], q, v), q, v)
                for loss, own in zip(losses, dry, strict=True):
                    loss[dofs] = own
            if limits is not None:
                limits.set(commanded[:, k], q, v)
            if lag is not None:
                lag.add(control[:, k], v)
            some_control = np.ascontiguousarray(control[:, k : k + every])
            if (n := some_control.shape[1]) < every:
                part, seen = (np.ascontiguousarray(x[:, :n]) for x in (part, seen))
            roll.rollout(
                models, data, now, some_control, skip_checks=True, nstep=n, state=part, sensordata=seen
            )  # fmt: skip
            path[:, k : k + every] = part
            now = np.ascontiguousarray(part[:, -1])
    return path


def cores() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2


class _Lag:
    """What a motor's lag adds to the control of each step, of the speeds that were (`model_edits.maxwell`)."""

    def __init__(self, m: Compiled, joints: Int[np.ndarray, " j"], x: Numbers, h: float):
        felt = x.at_joint
        _, past, self._decay = maxwell(felt, h)
        self._of_past = past / felt.kp * m.gear[joints]
        self._acts, self._w = m.act[joints], None

    def add(self, control: Float[np.ndarray, "B u"], v: Float[np.ndarray, "B j"]) -> None:
        """To the next step's, `v` being the last one's speed."""
        self._w = v if self._w is None else self._decay * self._w + (1.0 - self._decay) * v
        control[:, self._acts] -= self._of_past * self._w


class _Limits:
    """Actuators that are at their limit or not, to the second order in the step h.

    MuJoCo cuts off what is asked on a step's average, at the speed half a step before, and adds h kd to the inertia
    of an actuator that is not at its limit; `Plant` takes `lacking` kd from all, h/2 or less. A limit of 2.2 N m came
    out as 2.1 N m so, at 4 ms. Here each part of a step is cut off by itself, at v + h/2 · (the last step's
    acceleration), and an actuator that is at its limit has its inertia.
    """

    def __init__(self, m: Compiled, joints, limited, models, x: Numbers, lacking: float):
        # In each part of a step alike.
        of_parts = {k: getattr(x, k)[:, None] for k in Numbers._fields if k not in NOT_OF_JOINTS}
        self._x = x._replace(**of_parts)
        self._before: np.ndarray | None = None
        self._was: np.ndarray = limited
        self._dofs, self._acts = m.dof[joints], m.act[joints]
        self._limit = np.where(limited, x.limit, np.inf)[:, None]
        self._to_actuator = x.gain / m.gear[joints]
        self._models, self._rotors = models, np.stack([o.dof_armature[self._dofs] for o in models])
        self._lacking = lacking * np.maximum(x.gain * (x.kd - x.back), 0.0)

    def set(
        self,
        commanded: Float[np.ndarray, "B p j"],
        q: Float[np.ndarray, "B j"],
        v: Float[np.ndarray, "B j"],
    ) -> None:
        """What acts on the next step."""
        now = v if self._before is None else 1.5 * v - 0.5 * self._before
        self._before = v
        asked = self._x.asked(commanded, q[:, None], now[:, None])
        at = np.any(np.abs(asked) > self._limit, axis=1)
        changed = np.nonzero(at | self._was)
        for b, j in zip(*changed, strict=True):
            model, act, top = self._models[b], self._acts[j], self._limit[b, 0, j]
            within = np.minimum(np.maximum(asked[b, :, j], -top), top)
            model.dof_armature[self._dofs[j]] = self._rotors[b, j] + self._lacking[b, j] * at[b, j]
            model.actuator_forcelimited[act] = at[b, j]
            model.actuator_forcerange[act] = self._to_actuator[b, j] * within.mean()
        self._was = at
