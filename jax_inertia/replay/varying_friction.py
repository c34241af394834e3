"""Dry friction that goes with torque, position and speed, set before each step of MuJoCo C.

correct = callback(model, report)        # model: corrected.xml; report: report.json
while ...:
    data.ctrl[:] = targets
    correct(model, data)
    mujoco.mj_step(model, data)
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from jax_inertia.model.mujoco_types import MjData, MjModel
from jax_inertia.replay.result import Diagnosis


def law(found: Diagnosis) -> dict[str, dict[str, float]]:
    """What `callback` needs, by joint; nothing where friction does not vary.

    friction = coulomb + slope (q − middle) + load |τ| + stiction exp(−(q̇ / stribeck_velocity)²), never less than 0,

    τ the motor's torque [N m] and q as in corrected.xml.
    """
    x = found.numbers
    return {
        name: {
            "coulomb": float(x.dry[j]),
            "slope": float(x.slant[j]),
            "middle": float(x.middle[j] + x.offset[j]),
            "load": float(x.load[j]),
            "stiction": float(x.stiction[j]),
            "stribeck_velocity": float(x.slow[j]),
        }
        for j, name in enumerate(found.names)
        if x.varies_at[j]
    }


def callback(model: MjModel, report: Mapping[str, Any]) -> Callable[[MjModel, MjData], None]:
    """What sets `dof_frictionloss` as the report's friction_law says; ValueError for a joint that is not there."""
    commanded = report["friction_law"]
    known = {model.joint(j).name: j for j in range(model.njnt)}
    if lacking := [name for name in commanded if name not in known]:
        raise ValueError(f"the model has no joint {lacking[0]!r}, whose friction the report tells")
    joints = [known[name] for name in commanded]
    dofs, at = model.jnt_dofadr[joints], model.jnt_qposadr[joints]
    keys = "coulomb", "slope", "middle", "load", "stiction", "stribeck_velocity"
    numbers = [[x[k] for k in keys] for x in commanded.values()]
    dry, slope, middle, load, stiction, slow = np.reshape(numbers, (-1, len(keys))).T

    def correct(model: MjModel, data: MjData) -> None:
        rest = np.exp(-((data.qvel[dofs] / slow) ** 2))
        torque = np.abs(data.qfrc_actuator[dofs])
        there = dry + slope * (data.qpos[at] - middle)
        model.dof_frictionloss[dofs] = np.maximum(there + load * torque + stiction * rest, 0.0)

    return correct
