"""Torque regressors of three libraries against MuJoCo C, on the robots of the tests.

Each entry is |Y π + armature · a − (M a + c)| over |M a + c|, both as root mean squares over joints and 20 random
states (velocities of 2, accelerations of 5 in SI units); M and c are MuJoCo C's. Prints a Markdown table. Run it from
the project's folder:

    pip install -e ".[test]"                                    # brings Pinocchio (pin)
    pip install --no-deps --target scratch mujoco-sysid==0.2.1  # a peer, not a dependency
    PYTHONPATH=scratch python benchmarks/regressor_peers.py

mujoco-sysid is used as its own tests use it: its regressor has ten columns for each *joint*, to be multiplied with
the parameters of that joint's body. Its MJX variant is not looked at here.
"""

import importlib.metadata
import sys
from collections.abc import Callable
from pathlib import Path

import jax
import mujoco
import numpy as np

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from models import MODELS  # noqa: E402
from pinocchio_oracle import PinocchioRobot  # noqa: E402

import jax_inertia as ji  # noqa: E402
from jax_inertia.robots import humanoid_mjcf  # noqa: E402

try:
    from mujoco_sysid import parameters, regressors
except ImportError:
    parameters = regressors = None

STATES = 20
HARD = {
    "planar_2r": "two hinges, one link each",
    "universal": "two joints on one body",
    "three_joints": "three joints on one body, slides",
    "welded": "welded children",
    "ball": "a ball joint",
    "slides": "slides, gravity not along z",
    "free_body": "a free body in motion",
    "floating_tree": "a branched floating base",
    "arm7": "a seven-joint arm with a welded flange",
    "two_trees": "a free body and an arm",
    "humanoid": "the paper's humanoid",
}
Torque = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Y π + armature · a of one state."""


def ours(model: mujoco.MjModel, dtype) -> Torque:
    robot = ji.load_model(model).astype(dtype)

    @jax.jit
    def torque(q, v, a):
        y = ji.torque_regressor(robot, q, v, a)
        return jax.numpy.einsum("vbk,bk->v", y, robot.pi) + robot.armature * a

    return lambda q, v, a: np.asarray(torque(*(x.astype(dtype) for x in (q, v, a))), float)


def pinocchio(model: mujoco.MjModel) -> Torque:
    oracle, pi = PinocchioRobot(model), np.asarray(ji.load_model(model).pi)

    def torque(q, v, a):
        y = oracle.regressor(q, v, a)
        return np.einsum("vbk,bk->v", y, pi) + model.dof_armature * a

    return torque


def mujoco_sysid(model: mujoco.MjModel) -> Torque:
    data = mujoco.MjData(model)
    pi = np.concatenate([parameters.get_dynamic_parameters(model, b) for b in model.jnt_bodyid])

    def torque(q, v, a):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        mujoco.mj_rnePostConstraint(model, data)
        return regressors.joint_torque_regressor(model, data) @ pi + model.dof_armature * a

    return torque


def relative_error(model: mujoco.MjModel, torque: Torque) -> float:
    """Root mean square of the error over that of the torque, over all states."""
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    errors, references = [], []
    for _ in range(STATES):
        q = rng.normal(size=model.nq)
        mujoco.mj_normalizeQuat(model, q)
        v, a = 2.0 * rng.normal(size=model.nv), 5.0 * rng.normal(size=model.nv)
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        references.append(mass @ a + data.qfrc_bias)
        errors.append(torque(q, v, a) - references[-1])
    return float(np.linalg.norm(errors) / np.linalg.norm(references))


def cell(error: float) -> str:
    return f"{error:.0e}" if error < 1e-3 else f"**{error:.0%}**"


def main() -> None:
    versions = [importlib.metadata.version(name) for name in ("pin", "mujoco")]
    print(f"Against MuJoCo C {versions[1]}; Pinocchio {versions[0]}; mujoco-sysid 0.2.1.\n")
    print("| robot | what is hard | ours, float64 | ours, float32 | Pinocchio | mujoco-sysid |")
    print("|---|---|---|---|---|---|")
    for name, hard in HARD.items():
        text = humanoid_mjcf() if name == "humanoid" else MODELS[name]
        model = mujoco.MjModel.from_xml_string(text)
        # Contacts do not belong in M a + c; mujoco-sysid reads them from the accelerations.
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        peers = [ours(model, np.float64), ours(model, np.float32), pinocchio(model)]
        errors = [cell(relative_error(model, peer)) for peer in peers]
        errors.append(
            cell(relative_error(model, mujoco_sysid(model))) if regressors else "not installed"
        )
        print(f"| {name} | {hard} | {' | '.join(errors)} |")


if __name__ == "__main__":
    main()
