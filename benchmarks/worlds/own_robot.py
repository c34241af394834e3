"""Any robot on a fixed base as a nominal robot of the generator: its mechanics, and what motions and sizes suit it.

Bodies, joints and gravity are kept; meshes, actuators, sensors, contacts and the joints' stops are left out. Motions
stay inside the joints' ranges, the rated torque is what such motions ask for, loads and forces go by the robot's mass.
"""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.worlds.dynamics import inverse_dynamics
from benchmarks.worlds.motions import Fourier
from benchmarks.worlds.robots import Robot

TURN, SPEED = 1.6, 2.5  # rad either way of home where a hinge has no range, rad/s
TRAVEL, RATE = 0.25, 0.5  # m, m/s of slides
WIDEST = 1.9  # rad either way: a motion is no full turn
MARGIN = 0.06  # of the range, left free at both ends
TRACES = 4  # motions that the rated torque is taken from


class Unsuitable(ValueError):
    """The model is none that logs can be made of; one line says why."""


def own_robot(path: Path, fix_base: bool = False) -> Robot:
    """The robot in an MJCF or URDF file. `fix_base` holds its floating base where the model has it.

    Raises `Unsuitable` for floating bases otherwise, ball joints, closed loops and models without a moving body.
    """
    model = _read(path)
    _check(model, path, fix_base)
    return robot_of(model, path.stem)


def robot_of(model: mujoco.MjModel, name: str) -> Robot:
    """The same of a compiled model on a fixed base."""
    spec, joints = _bare_bones(model, name)
    plain = spec.compile()
    moves = (plain.body_weldid != 0) & (plain.body_mass > 0)
    bodies = tuple(plain.body(int(b)).name for b in np.flatnonzero(moves))
    lower, upper, speed = _room(plain)
    mass = float(plain.body_mass[1:].sum())
    weight = mass * float(np.linalg.norm(plain.opt.gravity) or 9.81)
    robot = Robot(
        name=name,
        xml=spec.to_xml(),
        joints=joints,
        bodies=bodies,
        peak=np.ones(plain.nv),
        lower=lower,
        upper=upper,
        max_speed=speed,
        payload=(0.01 * mass, 0.2 * mass),
        force=(0.05 * weight, 0.4 * weight),
    )
    return dataclasses.replace(robot, peak=rated_torque(robot))


def _read(path: Path) -> mujoco.MjModel:
    try:
        text = path.read_text()
        if path.suffix == ".urdf" or "<robot" in text[:2000]:
            return mujoco.MjModel.from_xml_string(_without_shapes(text))
        return mujoco.MjModel.from_xml_path(str(path))
    except (OSError, ValueError, ET.ParseError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise Unsuitable(f"{path}: {reason}; expected an MJCF or URDF file") from None


def _without_shapes(urdf: str) -> str:
    """A URDF without the shapes that only a renderer needs."""
    root = ET.fromstring(urdf)
    for link in root.iter("link"):
        for tag in ("visual", "collision"):
            for shape in link.findall(tag):
                link.remove(shape)
    return ET.tostring(root, encoding="unicode")


def _check(model: mujoco.MjModel, path: Path, fix_base: bool) -> None:
    kinds = set(model.jnt_type.tolist())
    if mujoco.mjtJoint.mjJNT_BALL in kinds:
        raise Unsuitable(f"{path}: ball joints; expected hinges and slides")
    free = int((model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).sum())
    if free and not fix_base:
        raise Unsuitable(f"{path}: a floating base; --fix-base holds it, as a robot that hangs")
    if model.neq and np.any(model.eq_active0):
        raise Unsuitable(f"{path}: equality constraints (closed loops); expected an open chain")
    if model.njnt == free:
        raise Unsuitable(f"{path}: no joint moves")


def _bare_bones(model: mujoco.MjModel, name: str):
    """Bodies, inertials, joints and gravity; names of joints."""
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.compiler.degree = False
    spec.compiler.autolimits = False
    spec.option.gravity = model.opt.gravity
    spec.option.timestep = 0.001
    made = {0: spec.worldbody}
    joints: list[str] = []
    for b in range(1, model.nbody):
        one = made[int(model.body_parentid[b])].add_body(
            name=model.body(b).name or f"body{b}", pos=model.body_pos[b], quat=model.body_quat[b]
        )
        made[b] = one
        if model.body_mass[b] > 0:
            one.explicitinertial = True
            one.mass, one.ipos, one.iquat = (
                model.body_mass[b], model.body_ipos[b], model.body_iquat[b]
            )  # fmt: skip
            one.inertia = model.body_inertia[b]
        first = int(model.body_jntadr[b])
        for j in range(first, first + int(model.body_jntnum[b])):
            if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE:
                continue
            joints.append(model.joint(j).name or f"joint{j}")
            _add_joint(one, model, j, joints[-1])
    return spec, tuple(joints)


def _add_joint(body, model: mujoco.MjModel, j: int, name: str) -> None:
    dof, adr = int(model.jnt_dofadr[j]), int(model.jnt_qposadr[j])
    joint = body.add_joint(
        name=name,
        type=mujoco.mjtJoint(int(model.jnt_type[j])),
        pos=model.jnt_pos[j],
        axis=model.jnt_axis[j],
        range=model.jnt_range[j],
        limited=mujoco.mjtLimited.mjLIMITED_FALSE,
        ref=model.qpos0[adr],
        springref=model.qpos_spring[adr],
        armature=model.dof_armature[dof],
        frictionloss=model.dof_frictionloss[dof],
    )
    set_linear(joint, "stiffness", float(model.jnt_stiffness[j]))
    set_linear(joint, "damping", float(model.dof_damping[dof]))


def set_linear(joint, name: str, value: float) -> None:
    """Sets a joint's damping or stiffness; from MuJoCo 3.4 on they are polynomials, of which this is the first."""
    if np.ndim(getattr(joint, name)):
        getattr(joint, name)[0] = value
    else:
        setattr(joint, name, value)


def _room(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bounds of the motion and its speeds, joint by joint."""
    low, high, speed = np.empty(model.nv), np.empty(model.nv), np.empty(model.nv)
    for j in range(model.njnt):
        hinge = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE
        way, speed[j] = (TURN, SPEED) if hinge else (TRAVEL, RATE)
        home = float(model.qpos0[j])
        first, last = map(float, model.jnt_range[j])
        if last > first:
            spare = MARGIN * (last - first)
            first, last = first + spare, last - spare
            home = home if first < home < last else 0.5 * (first + last)
            most = WIDEST if hinge else np.inf
            low[j], high[j] = max(first, home - most), min(last, home + most)
        else:
            low[j], high[j] = home - way, home + way
        # A range of a few centimetres is crossed in a second, not at full speed.
        speed[j] = min(speed[j], 2.0 * (high[j] - low[j]))
    return low, high, speed


def rated_torque(robot: Robot) -> np.ndarray:
    """1.3 times the largest torque of a few motions; no joint below a hundredth of the strongest one's."""
    model, most = robot.model(), []
    for k in range(TRACES):
        motion = Fourier(robot, np.random.default_rng(k))
        q, v, a = (np.array(x) for x in zip(*map(motion, np.arange(0.0, 10.0, 0.04)), strict=True))
        most.append(np.abs(inverse_dynamics(model, q, v, a)).max(0))
    peak = 1.3 * np.max(most, axis=0)
    return np.maximum(peak, 0.01 * peak.max())
