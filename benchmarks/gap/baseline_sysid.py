"""An oracle: MuJoCo's own `mujoco.sysid`, told which parameter of which place to fit, on fixed-base logs.

It rolls the model out from states of the log over short windows, driven by the logged torque, and fits the parameter
to the joint positions. A diagnosis has to find the parameter first; this is what it is measured against in the
parameter's error and in time. Needs the extra `mujoco[sysid]`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
from baseline_chain import as_effect, smooth
from mujoco import sysid

# Without the extra the module is empty.
AVAILABLE = hasattr(sysid, "optimize")
WINDOWS, HORIZON = 24, 0.25  # s

Write = Callable[[mujoco.MjSpec, np.ndarray], None]


class Knob:
    """One parameter in a spec: where it starts, its bounds, how it is written, and what of it is reported."""

    def __init__(
        self,
        start: list[float],
        bounds: tuple[list[float], list[float]],
        write: Write,
        report: Callable[[np.ndarray], dict[str, float]],
    ):
        self.start, self.bounds, self.write, self.report = start, bounds, write, report


def knob(spec: mujoco.MjSpec, model: mujoco.MjModel, family: str, name: str) -> Knob | None:
    """The parameter that a true effect changes, as far as a spec has one; None where it has none."""
    if family == "gravity_tilt":
        return _tilt(model)
    if name in {j.name for j in spec.joints}:
        return _joint(spec, model, family, name)
    if name in {b.name for b in spec.bodies}:
        return _body(model, family, name)
    return None


def _joint(spec, model, family: str, name: str) -> Knob | None:
    dof = int(model.joint(name).dofadr[0])
    (motor,) = [a.name for a in spec.actuators if a.target == name]

    def damping(s, x):
        value = np.array(s.joint(name).damping, float)
        value[0] = x[0]
        s.joint(name).damping = value

    def spring(s, x):
        value = np.array(s.joint(name).stiffness, float)
        value[0] = x[0]
        s.joint(name).stiffness, s.joint(name).springref = value, x[1]

    def gain(s, x):
        value = np.array(s.actuator(motor).gainprm, float)
        value[0] = x[0]
        s.actuator(motor).gainprm = value

    def bias(s, x):
        s.actuator(motor).biastype = mujoco.mjtBias.mjBIAS_AFFINE
        value = np.array(s.actuator(motor).biasprm, float)
        value[0] = x[0]
        s.actuator(motor).biasprm = value

    def limit(s, x):
        s.actuator(motor).forcelimited = True
        s.actuator(motor).forcerange = [-x[0], x[0]]

    def friction(s, x):
        s.joint(name).frictionloss = x[0]

    def armature(s, x):
        s.joint(name).armature = x[0]

    own = {
        "damping": float(model.dof_damping[dof]),
        "coulomb": float(model.dof_frictionloss[dof]),
        "armature": float(model.dof_armature[dof]),
    }

    def more(key: str) -> Callable[[np.ndarray], dict[str, float]]:
        return lambda x: {key: x[0] - own[key]}

    table = {
        "viscous_friction": (own["damping"], 0.0, 50.0, damping, more("damping")),
        "coulomb_friction": (own["coulomb"], 0.0, 50.0, friction, more("coulomb")),
        "armature": (own["armature"], 1e-4, 10.0, armature, more("armature")),
        "torque_gain": (1.0, 0.2, 3.0, gain, lambda x: {"gain": x[0]}),
        "torque_bias": (0.0, -50.0, 50.0, bias, lambda x: {"bias": x[0]}),
        "torque_saturation": (100.0, 0.01, 200.0, limit, lambda x: {"limit": x[0]}),
    }
    if family == "joint_spring":
        return Knob(
            [0.1, 0.0],
            ([0.0, -4.0], [200.0, 4.0]),
            spring,
            lambda x: {"stiffness": x[0], "rest_angle": x[1]},
        )
    if family not in table:
        return None
    start, low, high, write, report = table[family]
    return Knob([start], ([low], [high]), write, report)


def _body(model, family: str, name: str) -> Knob | None:
    body = model.body(name).id
    mass, com = float(model.body_mass[body]), model.body_ipos[body].copy()

    def payload(s, x):
        # A welded sphere of its own, removed before the next is put in its place.
        if (old := s.body("payload_")) is not None:
            s.delete(old)
        s.body(name).add_body(
            name="payload_", pos=x[1:4], mass=x[0], inertia=[1e-5] * 3, explicitinertial=True
        )

    def shift(s, x):
        s.body(name).ipos = com + x

    def inertia(s, x):
        # Written through the principal moments: the nominal models have no other form after compiling.
        b = s.body(name)
        b.fullinertia = np.full(6, np.nan)
        b.inertia, b.iquat = x[0] * model.body_inertia[body], model.body_iquat[body]

    if family == "payload":
        far = [0.6] * 3
        return Knob(
            [0.1 * mass, 0.0, 0.0, 0.0],
            ([1e-3, *(-x for x in far)], [20.0, *far]),
            payload,
            lambda x: {"mass": x[0]},
        )
    if family == "com_shift":
        names = [f"com_shift_{k}" for k in "xyz"]
        return Knob(
            [0.0] * 3,
            ([-0.1] * 3, [0.1] * 3),
            shift,
            lambda x: dict(zip(names, x.tolist(), strict=True)),
        )
    if family == "link_inertia":
        return Knob([1.0], ([0.05], [10.0]), inertia, lambda x: {"inertia_scale": x[0]})
    return None


def _tilt(model) -> Knob:
    gravity = model.opt.gravity.copy()

    def write(s, x):
        s.option.gravity = gravity + np.cross([x[0], x[1], 0.0], gravity)

    return Knob(
        [0.0, 0.0],
        ([-0.3] * 2, [0.3] * 2),
        write,
        lambda x: {"tilt_x": x[0], "tilt_y": x[1]},
    )


def fit(folder: Path, family: str, kind: str, name: str) -> tuple[dict, float] | None:
    """(the effect as fitted, seconds); None where a spec has no such parameter, the base floats or sysid is absent."""
    spec = mujoco.MjSpec.from_file(str(folder / "nominal.xml"))
    with np.load(folder / "log.npz") as file:
        log = {n: file[n] for n in file.files}
    if not AVAILABLE or "base_pos" in log:
        return None
    wanted = knob(spec, spec.compile(), family, name)
    if wanted is None:
        return None
    start = time.perf_counter()
    parameters = sysid.ParameterDict()
    parameters.add(
        sysid.Parameter(
            family,
            np.array(wanted.start),
            *map(np.array, wanted.bounds),
            modifier=lambda s, p: wanted.write(s, p.value),
        )
    )
    found, _ = sysid.optimize(
        initial_params=parameters,
        residual_fn=sysid.build_residual_fn(models_sequences=[windows(spec, log)], n_threads=1),
        optimizer="mujoco",
        verbose=False,
    )
    seconds = time.perf_counter() - start
    return as_effect(family, kind, name, wanted.report(found[family].value)), seconds


def windows(
    spec: mujoco.MjSpec, log: dict[str, np.ndarray], told: str = "tau"
) -> sysid.ModelSequences:
    """The log in short windows, each from a state of its own, `told` as controls and joint positions as sensors."""
    rate = 1.0 / float(np.median(np.diff(log["time"])))
    joints = [str(n) for n in log["joint_names"]]
    for name in joints:
        spec.add_sensor(
            name=f"{name}_at",
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=name,
        )
    model = spec.compile()
    order = [joints.index(model.joint(model.actuator_trnid[k, 0]).name) for k in range(model.nu)]
    clean = smooth(log["qpos"], rate)
    speed = np.gradient(clean, 1.0 / rate, axis=0)
    length = round(HORIZON * rate)
    starts = np.linspace(0.3 * rate, len(clean) - length - 0.3 * rate, WINDOWS).astype(int)
    data = mujoco.MjData(model)
    states, controls, sensors = [], [], []
    for k in starts:
        span = slice(k, k + length)
        when = np.arange(length) / rate
        for j, name in enumerate(joints):
            data.joint(name).qpos, data.joint(name).qvel = clean[k, j], speed[k, j]
        states.append(sysid.create_initial_state(model, data.qpos, data.qvel, data.act))
        controls.append(sysid.TimeSeries(when, log[told][span][:, order]))
        sensors.append(sysid.TimeSeries.from_names(when, log["qpos"][span], model))
    names = [f"from {k}" for k in starts]
    return sysid.ModelSequences("robot", spec, names, states, controls, sensors)
