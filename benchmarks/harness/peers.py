"""Other libraries on the same robot: Pinocchio, MuJoCo C, mujoco-sysid; each absent one is None.

Pinocchio's model is the one that the tests check ours against (tests/pinocchio_oracle.py). Its q, v and a are made
ready beforehand, so that only its own work is timed; its results stay in its own memory and are overwritten.
"""

import copy
import sys
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

try:
    import pinocchio as pin
    from pinocchio_oracle import PinocchioRobot
except ImportError:
    pin = None
try:
    from mujoco_sysid import parameters, regressors
except ImportError:
    parameters = regressors = None

Samples = tuple[np.ndarray, np.ndarray, np.ndarray]
Torque = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Y π + armature · a of one state."""


def pinocchio_runs(model: mujoco.MjModel, samples: Samples) -> dict[str, Callable[[], None]]:
    """One pass over all samples, for each of Pinocchio's two functions."""
    if pin is None:
        return {}
    robot = PinocchioRobot(model)
    border = [robot.border(*x) for x in zip(*samples, strict=True)]
    ready = [
        (robot.configuration(q), v, a) for q, (v, a, _) in zip(samples[0], border, strict=True)
    ]

    def run(function: Callable) -> Callable[[], None]:
        def over_all() -> None:
            for q, v, a in ready:
                function(robot.model, robot.data, q, v, a)

        return over_all

    return {
        "Pinocchio regressor": run(pin.computeJointTorqueRegressor),
        "Pinocchio RNEA": run(pin.rnea),
    }


def mujoco_run(model: mujoco.MjModel, samples: Samples) -> Callable[[], None]:
    """mj_inverse over all samples, contacts switched off."""
    data = mujoco.MjData(model)

    def over_all() -> None:
        for q, v, a in zip(*samples, strict=True):
            data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
            mujoco.mj_inverse(model, data)

    return over_all


def sysid_run(model: mujoco.MjModel, samples: Samples) -> Callable[[], None] | None:
    """mujoco-sysid's regressor over all samples, the kinematics that it reads included."""
    if regressors is None:
        return None
    data = mujoco.MjData(model)

    def over_all() -> None:
        for q, v, a in zip(*samples, strict=True):
            data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
            mujoco.mj_inverse(model, data)
            mujoco.mj_rnePostConstraint(model, data)
            regressors.joint_torque_regressor(model, data)

    return over_all


def pinocchio_torque(model: mujoco.MjModel, pi: np.ndarray) -> Torque | None:
    """Through Pinocchio's regressor and our π."""
    if pin is None:
        return None
    robot = PinocchioRobot(model)
    return lambda q, v, a: (
        np.einsum("vbk,bk->v", robot.regressor(q, v, a), pi) + model.dof_armature * a
    )


def sysid_torque(model: mujoco.MjModel) -> Torque | None:
    """Through mujoco-sysid's, as its own tests use it: ten columns for each *joint*, times its body's parameters."""
    if regressors is None:
        return None
    data = mujoco.MjData(model)
    pi = np.concatenate([parameters.get_dynamic_parameters(model, b) for b in model.jnt_bodyid])

    def torque(q, v, a):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        mujoco.mj_rnePostConstraint(model, data)
        return regressors.joint_torque_regressor(model, data) @ pi + model.dof_armature * a

    return torque


def without_contacts(model: mujoco.MjModel) -> mujoco.MjModel:
    """The model with its constraints switched off: contacts do not belong in M a + c."""
    out = copy.copy(model)
    out.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    return out
