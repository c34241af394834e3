"""Real robots that are diagnosed: model and logs as the command takes them, and the published fit (ROBOTS.md)."""

import dataclasses
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.real_logs import ur10e
from benchmarks.real_logs.logs import SHARED
from benchmarks.real_logs.ur10e_model import LINKS, makers_model
from jax_inertia.logs.log import Log, TorqueKind, TorqueUnit
from jax_inertia.logs.log_files import read_log, write_log
from jax_inertia.model.load import ModelWarning, compile_spec, load_spec, set_inertials
from jax_inertia.model.robot import Robot


@dataclass(frozen=True)
class Files:
    """What the command is given."""

    model: Path
    log: Path
    test: Path | None


@dataclass(frozen=True)
class Terms:
    """Joint terms of a published fit, torque = model + viscous v + coulomb sign v + offset + armature a."""

    viscous: np.ndarray
    coulomb: np.ndarray
    offset: np.ndarray
    armature: np.ndarray

    def torque(self, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """What the robot needs beyond the rigid bodies [N m]."""
        return self.viscous * v + self.coulomb * np.sign(v) + self.offset + self.armature * a


Law = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Case:
    """One real robot."""

    name: str
    folder: str
    prepare: Callable[[Path], Files]
    law: Law | None = None
    """The published fit as a torque beside the nominal bodies, where it can be evaluated."""
    gains: np.ndarray | None = None
    """Published drive gains that belong to `law`, where the log is no torque."""


def _save(log: Log, path: Path, **changes) -> Path:
    write_log(dataclasses.replace(log, **changes), path)
    return path


def _copy(folder: str, name: str, out: Path, **changes) -> Path:
    return _save(read_log(SHARED / folder / f"{name}.npz"), out / f"{name}.npz", **changes)


def _write(spec: mujoco.MjSpec, path: Path) -> Path:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)  # what MuJoCo balances is said in the page
        compile_spec(spec)
    path.write_text(spec.to_xml())
    return path


def _first(vector, value: float) -> np.ndarray:
    out = np.array(vector, float)
    out[0] = value
    return out


def with_joint_terms(
    spec: mujoco.MjSpec, damping: np.ndarray, friction: np.ndarray, armature: np.ndarray
) -> mujoco.MjSpec:
    """A spec whose joints have these numbers, in the spec's order, in place of their own."""
    for joint, d, f, a in zip(spec.joints, damping, friction, armature, strict=True):
        joint.damping = _first(joint.damping, float(d))
        joint.frictionloss, joint.armature = float(f), float(a)
    return spec


# --- Franka Panda ----------------------------------------------------------------------------------------------

_PHI1 = np.array([0.54615, 0.87224, 0.64068, 1.2794, 0.83904, 0.30301, 0.56489])
_PHI2 = np.array([5.1181, 9.0657, 10.136, 5.5903, 8.3469, 17.133, 10.336])
_PHI3 = np.array([0.039533, 0.025882, -0.04607, 0.036194, 0.026226, -0.021047, 0.0035526])


def _sigmoid(v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Gaz et al. 2019, the friction they recommend beside the bodies of Tables VIII and IX."""
    return _PHI1 / (1 + np.exp(-_PHI2 * (v + _PHI3))) - _PHI1 / (1 + np.exp(-_PHI2 * _PHI3))


def _panda(out: Path) -> Files:
    folder = "panda_gaz2019"
    sensor = {"tau_kind": TorqueKind.SENSOR}
    return Files(
        SHARED / folder / "reference_model_identified.xml",
        _copy(folder, "train", out, **sensor),
        _copy(folder, "test", out, **sensor),
    )


# --- KUKA LWR4+ ------------------------------------------------------------------------------------------------


def _lwr(out: Path) -> Files:
    folder = "kuka_lwr4_flobaroid"
    # The file's own damping and friction are not the published ones: rigid bodies alone.
    spec = load_spec(SHARED / folder / "reference_kuka_lwr4_identified.urdf")
    none = np.zeros(len(spec.joints))
    sensor = {"tau_kind": TorqueKind.SENSOR}
    return Files(
        _write(with_joint_terms(spec, none, none, none), out / "model.xml"),
        _copy(folder, "train_1", out, **sensor),
        _copy(folder, "test_3", out, **sensor),
    )


# --- UR10e -----------------------------------------------------------------------------------------------------

_UR10E = "ur10e_dynamic_calibration"
_UR10E_TERMS = Terms(
    viscous=np.array([21.256, 20.221, 10.378, 3.575, 2.491, 3.026]),
    coulomb=np.array([12.548, 13.266, 4.994, 1.998, 2.690, 2.298]),
    offset=np.array([0.196, -0.754, 0.198, 0.055, -0.010, 0.043]),
    armature=np.array([0, 3.7434, 0, 0.0708, 0.2342, 0.4365]),
)


def _ur10e_spec(robot: Robot) -> mujoco.MjSpec:
    """The data set's URDF with the links of `robot`."""
    spec = load_spec(SHARED / _UR10E / "model_ur10e.urdf")
    set_inertials(spec, {n: np.asarray(robot.pi[robot.body_index(n)]) for n in LINKS})
    return spec


def _ur10e_free(out: Path) -> Files:
    urdf = ur10e.UR10E.model("model_ur10e.urdf")
    current = {"tau_kind": TorqueKind.CURRENT}
    return Files(
        _write(_ur10e_spec(makers_model(urdf)), out / "model.xml"),
        _copy(_UR10E, "dev_free_1", out, **current),
        _copy(_UR10E, "dev_free_2", out, **current),
    )


# --- DFKI double pendulum --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Design:
    """m [kg], l [m], r [m], I about the joint [kg m²], of both links; the published rotor and friction."""

    m: tuple[float, float]
    l: tuple[float, float]  # noqa: E741 (the source's own letter)
    r: tuple[float, float]
    inertia: tuple[float, float]
    rotor: float
    damping: tuple[float, float]
    coulomb: tuple[float, float]

    @property
    def terms(self) -> Terms:
        return Terms(
            np.array(self.damping), np.array(self.coulomb), np.zeros(2), np.full(2, 36 * self.rotor)
        )


_C1 = _Design(
    (0.5235, 0.6256),
    (0.2, 0.3),
    (0.2, 0.2557),
    (0.0319, 0.0509),
    6.287e-5,
    (0.001, 0.001),
    (0.16, 0.12),
)


def _dfki(out: Path) -> Files:
    folder, d = "dfki_double_pendulum", _C1
    spec = load_spec(SHARED / folder / "model_two_link_template.xml")
    pi = {}
    for k, name in enumerate(("link1", "link2")):
        # A rod-like link: its published moment is about the joint's axis, y; the one along the link is small.
        i = d.inertia[k]
        pi[name] = np.array([d.m[k], 0, 0, -d.m[k] * d.r[k], i, 0, 0, i, 0, 1e-3])
    set_inertials(spec, pi)
    spec.body("link2").pos = [0, 0, -d.l[0]]
    current = {"tau_kind": TorqueKind.CURRENT}
    return Files(
        _write(spec, out / "model.xml"),
        _copy(folder, "C1_train_00", out, **current),
        _copy(folder, "C1_test_08", out, **current),
    )


# --- Dynamixel XL330 -------------------------------------------------------------------------------------------

_FULL_DUTY = 885
_KT, _R = 0.3866957639281311, 4.017129222290597
_XL330_TERMS = Terms(
    viscous=np.array([0.003661672 + _KT**2 / _R]),
    coulomb=np.array([0.012832720]),
    offset=np.zeros(1),
    armature=np.array([0.0018141672]),
)


def _xl330(run: str, test: str) -> Callable[[Path], Files]:
    def prepare(out: Path) -> Files:
        folder = "bam_xl330"
        paths = []
        for name in (run, test):
            path = SHARED / folder / f"{name}.npz"
            log = read_log(path)
            with np.load(path) as raw:
                volts = raw["input_volts"][:, None]
            # Duty times supply: the voltage at the motor, one gain k/R away from a torque.
            paths.append(
                _save(
                    log,
                    out / f"{name}.npz",
                    tau=log.tau / _FULL_DUTY * volts,
                    tau_unit=TorqueUnit.UNKNOWN,
                    tau_unit_text="V",
                    tau_kind=TorqueKind.COMMANDED,
                )
            )
        return Files(SHARED / folder / "model_nominal.xml", *paths)

    return prepare


CASES = (
    Case("panda", "panda_gaz2019", _panda, _sigmoid),
    Case("lwr4", "kuka_lwr4_flobaroid", _lwr),
    Case("ur10e", _UR10E, _ur10e_free, _UR10E_TERMS.torque, ur10e.REPOSITORY),
    Case("double_pendulum", "dfki_double_pendulum", _dfki, _C1.terms.torque),
    Case(
        "xl330",
        "bam_xl330",
        _xl330("train_07_sin_time_square_kp200", "test_08_sin_sin_kp400"),
        _XL330_TERMS.torque,
        np.array([_KT / _R]),
    ),
)
