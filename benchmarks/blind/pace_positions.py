"""The PACE-like fit (`../exam/pace_like.py`) as a tool of the protocol, for logs of positions without torque."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from benchmarks.exam.pace_like import PaceLike

CARRIES = 0.01
"""Listed is what returns so much of the error that the fit took away, where it alone goes back to the model's."""
FAMILIES = (
    ("armature", "armature", "kg m^2"),
    ("viscous_friction", "damping", "N m s/rad"),
    ("coulomb_friction", "coulomb", "N m"),
    ("encoder_offset", "offset", "rad"),
    ("kp_scale", "scale", "1"),
)


def answer(folder: Path, log: dict[str, np.ndarray]) -> tuple[dict, str]:
    """Report without verdict, and the model as fitted (MJCF)."""
    names = [str(x) for x in log["joint_names"]]
    model = str(folder / "nominal.xml")
    fit = PaceLike(mujoco.MjSpec.from_file(model), names, log["kp"], log["kd"])
    run = log["time"] - log["time"][0], log["qpos"], log["qpos_target"]
    x = fit.fit([run], [1.0])
    return {"effects": _listed(fit, x, run, names)}, _model(model, log, names, x).to_xml()


def _listed(fit: PaceLike, x: np.ndarray, run, names: list[str]) -> list[dict]:
    def square(numbers: np.ndarray) -> float:
        return float(np.mean((fit.replay(numbers, run) - run[1]) ** 2))

    least = square(x)
    taken = square(fit.nominal) - least
    found, n = [], len(names)
    for k, (value, nominal) in enumerate(zip(x, fit.nominal, strict=True)):
        back = x.copy()
        back[k] = nominal
        share = (square(back) - least) / max(taken, 1e-300)
        if share <= CARRIES:
            continue
        if k == 5 * n:
            family, parameter, unit = "target_delay", "delay", "s"
            place = {"kind": "global", "name": "global"}
        else:
            family, parameter, unit = FAMILIES[k // n]
            place = {"kind": "joint", "name": names[k % n]}
        size = np.exp(value) if family == "kp_scale" else value - nominal
        found.append((share, {"family": family, "location": place,
                              "parameters": {parameter: {"value": float(size), "unit": unit}}}))  # fmt: skip
    return [effect for _, effect in sorted(found, key=lambda f: -f[0])]


def _model(file: str, log: dict, names: list[str], x: np.ndarray) -> mujoco.MjSpec:
    spec, n = mujoco.MjSpec.from_file(file), len(names)
    rotor, damping, dry, offset, stiffer = x[: 5 * n].reshape(5, n)
    for j, name in enumerate(names):
        joint = spec.joint(name)
        joint.armature, joint.frictionloss = rotor[j], dry[j]
        if np.ndim(joint.damping):
            joint.damping[0] = damping[j]
        else:
            joint.damping = damping[j]
        joint.ref += offset[j]
        servo = spec.add_actuator(name=f"{name}_servo", target=name)
        servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
        servo.set_to_position(kp=float(log["kp"][j] * np.exp(stiffer[j])), kv=float(log["kd"][j]))
        if x[-1] > 1e-6:
            servo.delay, servo.interp = x[-1], 1
            servo.nsample = int(np.ceil(x[-1] / spec.option.timestep)) + 2
    spec.compile()
    return spec
