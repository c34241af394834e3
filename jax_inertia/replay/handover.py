"""What is handed over, replayed as whoever gets it would: a file, MuJoCo's own steps, and nothing else.

The model is the one of the written text, read back; time steps, integrator, delay buffers and filters are its own, and
`StepLaw` sets what the file says that no attribute can. No number of a fit is used here.
"""

import copy
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from jax_inertia.model.load import compile_spec, load_spec
from jax_inertia.model.mujoco_types import MjModel, MjSpec
from jax_inertia.model.spec import flatten
from jax_inertia.model.write import DIGITS, as_older_ones_read, loadable
from jax_inertia.replay.corrected import corrected
from jax_inertia.replay.loop import Loop
from jax_inertia.replay.record import Record, step_means
from jax_inertia.replay.result import Correction
from jax_inertia.replay.simulation.simulate import LOST, WINDINGS, between_steps, wound
from jax_inertia.replay.simulation.spec_edits import with_loop
from jax_inertia.replay.step_law import StepLaw

Writer = Callable[[MjSpec], tuple[str, MjModel]]
"""Makes the text of a spec's file, and the model that is read back from it."""


class Written(NamedTuple):
    """A corrected model as written, and as read back."""

    text: str
    model: MjModel
    remarks: tuple[str, ...]


def in_memory(spec: MjSpec) -> tuple[str, MjModel]:
    """The text of a spec that needs no other files, and its model."""
    # What moments are rounded to must not break A + B ≥ C of a flat body.
    flatten(spec, DIGITS)
    text = as_older_ones_read(spec.to_xml())
    return text, mujoco.MjModel.from_xml_string(text)


def in_folder(source: Path, home: Path) -> Writer:
    """What writes a spec of the model `source` as it is to lie in `home`, and reads it from there."""

    def write(spec: MjSpec) -> tuple[str, MjModel]:
        text = loadable(spec, source, home)
        return text, read_in(text, source, home)

    return write


def read_in(text: str, source: Path, home: Path) -> MjModel:
    """The model of a file with this text in the folder `home`; `source`: the model that it was made of."""
    with tempfile.NamedTemporaryFile(
        "w", dir=home, prefix=".part-", suffix=".xml", delete=False
    ) as file:
        file.write(text)
    try:
        return compile_spec(load_spec(file.name), source)
    finally:
        Path(file.name).unlink(missing_ok=True)


def written(found: Correction, spec: MjSpec, write: Writer) -> Written:
    """The correction in a spec of the nominal model, which is changed, as it is written and read back."""
    remarks = corrected(spec, found)
    return Written(*write(spec), remarks)


def nominal_model(spec: MjSpec, names: Sequence[str], loop: Loop) -> MjModel:
    """The model as given, with the loop that is known of the robot where it has none of its own; spec is changed."""
    if loop.source != "model":
        with_loop(spec, names, loop)
    return spec.compile()


def replayed(
    model: MjModel, names: Sequence[str], loop: Loop, record: Record
) -> Float[np.ndarray, "T n"]:
    """Positions of a record's joints at its stamps, its targets through the model in the model's own steps [rad].

    Each target acts from its stamp on: where that is within a step, as its mean over the step. `loop`: whose gains
    the model has, before any correction; a record of other gains is replayed with these in the same proportion.
    """
    law = StepLaw(model, names)
    model = _with_gains(model, law, loop, record.loop)
    law.model = model
    joints, torque = law.integrals, None
    if joints:
        torque, late = np.zeros(len(joints)), record.head
        for _ in range(WINDINGS):
            head = record.upto(late.stop)
            error = (head.q - _moved(model, names, law, head, torque))[late][:, joints]
            torque = wound(error, torque, law.stiffness, law.windup)
    return _moved(model, names, law, record, torque)


def _moved(
    model: MjModel,
    names: Sequence[str],
    law: StepLaw,
    record: Record,
    torque: Float[np.ndarray, " i"] | None,
) -> Float[np.ndarray, "T n"]:
    """`torque`: what integrals have reached at the record's start."""
    data = mujoco.MjData(model)
    joints = [model.joint(name).id for name in names]
    at, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    data.qpos[at], data.qvel[dofs] = record.q[0], record.start
    told = record.commanded
    targets, first = _targets(record), int(np.searchsorted(told.time, 0.0, side="right")) - 1
    law.start(data, targets[max(first - 1, 0)], torque)
    h = model.opt.timestep
    steps = int(np.ceil(record.time[-1] / h)) + 1
    none = np.zeros(len(names))
    sent, aims = (step_means(told.time, x, h, steps, none, none) for x in (targets, told.position))
    path = np.empty((steps + 1, len(names)))
    path[0] = data.qpos[at]
    for k in range(steps):
        law.set(data, sent[k], aims[k])
        mujoco.mj_step(model, data)
        path[k + 1] = data.qpos[at]
        if data.time < 0.5 * (k + 1) * h:
            # A MuJoCo that has diverged starts anew from its reference posture: the clock shows it.
            return record.q + LOST
    return np.nan_to_num(between_steps(path, record.time / h), nan=LOST)


def _targets(record: Record) -> Float[np.ndarray, "S n"]:
    """q* + (kd q̇* + τ_ff) / kp at the stamps of all that was commanded."""
    told, loop = record.commanded, record.loop
    out = told.position
    if told.velocity is not None and loop is not None:
        out = out + loop.kd / loop.kp * told.velocity
    if told.torque is not None and loop is not None:
        out = out + told.torque / loop.kp
    return out


def _with_gains(model: MjModel, law: StepLaw, loop: Loop, own: Loop | None) -> MjModel:
    """The model with a record's gains in place of those it was made for; itself where they are the same."""
    if own is None or (np.array_equal(own.kp, loop.kp) and np.array_equal(own.kd, loop.kd)):
        return model
    model = copy.copy(model)
    for a, k in law.actuators:
        gear = float(model.actuator_gear[a, 0])
        ratio = own.kp[k] / loop.kp[k]
        model.actuator_gainprm[a, 0] *= ratio
        model.actuator_biasprm[a, 1] *= ratio
        model.actuator_biasprm[a, 2] -= (own.kd[k] - loop.kd[k]) / gear**2
    return model
