"""What a model's attributes cannot say of a position-controlled robot, set before each step of MuJoCo C.

corrected.xml carries it in itself (`<custom><text name="step_law">`, JSON), report.json as `step_law`:

- friction that goes with torque, position and speed, by joint,

      F = coulomb + slope (q − middle) + load |τ| + stiction exp(−(q̇ / stribeck_velocity)²), never less than 0,

  τ the motor's torque [N m] and q as in the file;
- a low-pass of the targets as they arrive, once a `period` [s], y ← y + gain (x − y).

And what every model with late targets needs: MuJoCo keeps targets that are on their way in a buffer that starts at 0,
whatever a keyframe says, and activations of filters as well: for as long as the delay lasts, a robot is pulled to its
zero posture. `start` fills both.

law = StepLaw(model)                 # model: corrected.xml
mujoco.mj_resetData(model, data)
law.start(data, targets)             # after each reset
while ...:
    law.set(data, targets)           # in place of data.ctrl[:] = targets
    mujoco.mj_step(model, data)
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from jax_inertia.model.mujoco_types import MjData, MjModel, MjSpec
from jax_inertia.replay.joint_numbers import Numbers
from jax_inertia.replay.loop import actuators_on
from jax_inertia.replay.simulation.spec_edits import DEAD, INTEGRAL

TEXT = "step_law"
_KEYS = "coulomb", "slope", "middle", "load", "stiction", "stribeck_velocity"
_FILTERS = int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT)


def law(names: Sequence[str], x: Numbers) -> dict[str, Any]:
    """The law of some joints' numbers; empty where a model's attributes say it all."""
    friction = {
        name: {
            "coulomb": float(x.dry[j]),
            "slope": float(x.slant[j]),
            "middle": float(x.middle[j] + x.offset[j]),
            "load": float(x.load[j]),
            "stiction": float(x.stiction[j]),
            "stribeck_velocity": float(x.slow[j]),
        }
        for j, name in enumerate(names)
        if x.varies_at[j]
    }
    out: dict[str, Any] = {"friction": friction} if friction else {}
    if x.low_pass.any():
        period = float(x.low_pass_period[0])
        gain = 1.0 - np.exp(-period / np.maximum(x.low_pass, 1e-12))
        out["low_pass"] = {
            "period": period,
            "gain": {n: float(g) for n, g, there in zip(names, gain, x.low_pass, strict=True) if there},
        }  # fmt: skip
    return out


def write(spec: MjSpec, names: Sequence[str], x: Numbers) -> None:
    """Put the law of some joints' numbers into a spec, in place of one that is there."""
    for text in [t for t in spec.texts if t.name == TEXT]:
        spec.delete(text)
    if said := law(names, x):
        spec.add_text(name=TEXT, data=json.dumps(said))


def read(model: MjModel) -> dict[str, Any]:
    """The law that a model carries; empty where it has none."""
    k = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, TEXT)
    if k < 0:
        return {}
    first = model.text_adr[k]
    data = model.text_data[first : first + model.text_size[k]]
    return json.loads(bytes(data).split(b"\0")[0].decode())


def _is_added(model: MjModel, actuator: int) -> bool:
    return model.actuator(actuator).name.endswith((DEAD, INTEGRAL))


class StepLaw:
    """The law of one model, and the actuators that its targets are for."""

    def __init__(
        self,
        model: MjModel,
        joints: Sequence[str] | None = None,
        said: Mapping[str, Any] | None = None,
    ):
        """`joints`: whose targets will be given, in that order; all with an actuator on them, in the model's order.

        `said`: the law, where the model does not carry it. Raises ValueError for a joint that the model does not have,
        or that no actuator is on.
        """
        known = {model.joint(j).name: j for j in range(model.njnt)}
        if joints is None:
            joints = [name for name, j in known.items() if actuators_on(model, j)]
        self.model, self.joints = model, tuple(joints)
        said = read(model) if said is None else said
        friction, filtered = said.get("friction", {}), said.get("low_pass", {})
        for name in (*joints, *friction):
            if name not in known:
                raise ValueError(f"the model has no joint {name!r}, which its law is about")
        on = [actuators_on(model, known[name]) for name in joints]
        if bare := [n for n, acts in zip(joints, on, strict=True) if not acts]:
            raise ValueError(f"no actuator of the model is on joint {bare[0]!r}")
        # The last one, as the loop is read; what was added for it has the targets of the joint's own.
        more = [[a for a in acts if _is_added(model, a)] for acts in on]
        main = [[a for a in acts if a not in x][-1:] for acts, x in zip(on, more, strict=True)]
        self._main = [acts[-1] for acts in main]
        pairs = [
            (a, k)
            for k, each in enumerate(zip(main, more, strict=True))
            for acts in each
            for a in acts
        ]
        self._acts, self._of = np.reshape(pairs, (-1, 2)).astype(int).T
        self._gear = model.actuator_gear[self._acts, 0]
        pid = model.actuator_dyntype[self._acts] == int(mujoco.mjtDyn.mjDYN_PID)
        self._integrals = pid & (model.actuator_gainprm[self._acts, 0] > 0)
        varies = [known[name] for name in friction]
        self._dofs, self._at = model.jnt_dofadr[varies], model.jnt_qposadr[varies]
        numbers = [[x[k] for k in _KEYS] for x in friction.values()]
        self._friction = np.reshape(numbers, (-1, len(_KEYS))).T
        self._period = float(filtered.get("period", 0.0))
        self._gain = np.array([filtered.get("gain", {}).get(name, 1.0) for name in joints])
        self._filtered, self._due = np.zeros(len(joints)), 0.0

    @property
    def actuators(self) -> list[tuple[int, int]]:
        """Each actuator that is given a target, and which of the joints it is on."""
        return list(zip(self._acts.tolist(), self._of.tolist(), strict=True))

    @property
    def integrals(self) -> list[int]:
        """Which of the joints have a drive with an integral."""
        return self._of[self._integrals].tolist()

    @property
    def stiffness(self) -> Float[np.ndarray, " i"]:
        """kp of each joint of `integrals` [N m/rad]."""
        acts = [self._main[k] for k in self.integrals]
        return -(self.model.actuator_gear[acts, 0] ** 2) * self.model.actuator_biasprm[acts, 1]

    @property
    def windup(self) -> Float[np.ndarray, " i"]:
        """Largest torque of each of `integrals` [N m]; infinite where there is no clamp."""
        acts = self._acts[self._integrals]
        force = self.model.actuator_actrange[acts, 1] * self.model.actuator_gainprm[acts, 0]
        torque = force * np.abs(self._gear[self._integrals])
        return np.where(self.model.actuator_actlimited[acts], torque, np.inf)

    def start(
        self,
        data: MjData,
        targets: Float[np.ndarray, " n"],
        wound: Float[np.ndarray, " i"] | None = None,
    ) -> None:
        """Let every target that is on its way be its first one, as if it had been held.

        `wound`: the torque that each of `integrals` has reached [N m]; 0 as of a drive that was just switched on.
        """
        model = self.model
        self._filtered, self._due = np.array(targets, float), float(data.time)
        data.ctrl[self._acts] = self._filtered[self._of] * self._gear
        for a in self._acts.tolist():
            if model.actuator_delay[a] > 0:
                past = np.full(model.actuator_history[a, 0], data.ctrl[a])
                mujoco.mj_initCtrlHistory(model, data, a, None, past)
            if model.actuator_dyntype[a] in _FILTERS:
                data.act[model.actuator_actadr[a]] = data.ctrl[a]
        if wound is not None:
            acts = self._acts[self._integrals]
            force = wound / model.actuator_gear[acts, 0]
            data.act[model.actuator_actadr[acts]] = force / model.actuator_gainprm[acts, 0]

    def set(
        self,
        data: MjData,
        targets: Float[np.ndarray, " n"],
        aims: Float[np.ndarray, " n"] | None = None,
    ) -> None:
        """Controls and friction of the next step.

        `aims`: targets of position alone, which integrals act on, where `targets` hold velocities or torques as well.
        """
        now = np.asarray(targets, float)
        fed = np.zeros(len(now)) if aims is None else now - aims
        if self._period:
            while data.time > self._due - 1e-9:
                self._filtered = self._filtered + self._gain * (now - self._filtered)
                self._due += self._period
            now = np.where(self._gain < 1.0, self._filtered, now)
        aim = now[self._of] - self._integrals * fed[self._of]
        data.ctrl[self._acts] = aim * self._gear
        if len(self._dofs):
            dry, slope, middle, load, stiction, slow = self._friction
            rest = np.exp(-((data.qvel[self._dofs] / slow) ** 2))
            torque = np.abs(data.qfrc_actuator[self._dofs])
            there = dry + slope * (data.qpos[self._at] - middle)
            size = np.maximum(there + load * torque + stiction * rest, 0.0)
            self.model.dof_frictionloss[self._dofs] = size
