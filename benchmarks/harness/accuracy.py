"""Torque regressors of three libraries against MuJoCo C, on the robots of the tests.

Each entry is |Y π + armature · a − (M a + c)| over |M a + c|, both as root mean squares over joints and 20 random
states (velocities of 2, accelerations of 5 in SI units); M and c are MuJoCo C's.
"""

import jax
import mujoco
import numpy as np

from benchmarks.harness.peers import Torque, pinocchio_torque, sysid_torque, without_contacts
from benchmarks.harness.results import table
from jax_inertia import load_model, torque_regressor
from jax_inertia.robots import humanoid_mjcf

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
COLUMNS = ("ours, float64", "ours, float32", "Pinocchio", "mujoco-sysid")


def ours(model: mujoco.MjModel, dtype: type) -> Torque:
    """Through our regressor and our π."""
    robot = load_model(model).astype(dtype)

    @jax.jit
    def torque(q, v, a):
        y = torque_regressor(robot, q, v, a)
        return jax.numpy.einsum("vbk,bk->v", y, robot.pi) + robot.armature * a

    return lambda q, v, a: np.asarray(torque(*(x.astype(dtype) for x in (q, v, a))), float)


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


def errors() -> dict[str, dict[str, float | None]]:
    """Relative error of every library on every robot; None where the library is not installed. Needs x64."""
    from models import MODELS  # beside the tests; `peers` has put them on the path

    out: dict[str, dict[str, float | None]] = {}
    for name in HARD:
        text = humanoid_mjcf() if name == "humanoid" else MODELS[name]
        model = without_contacts(mujoco.MjModel.from_xml_string(text))
        pi = np.asarray(load_model(model).pi)
        made = (
            ours(model, np.float64),
            ours(model, np.float32),
            pinocchio_torque(model, pi),
            sysid_torque(model),
        )
        out[name] = {
            column: relative_error(model, torque) if torque else None
            for column, torque in zip(COLUMNS, made, strict=True)
        }
    return out


def page(found: dict[str, dict[str, float | None]]) -> str:
    """The errors as a Markdown table."""

    def cell(error: float | None) -> str:
        if error is None:
            return "not run"
        return f"{error:.0e}" if error < 1e-3 else f"**{error:.0%}**"

    rows = [[name, HARD[name], *(cell(by[c]) for c in COLUMNS)] for name, by in found.items()]
    return table(["robot", "what is hard", *COLUMNS], rows)
