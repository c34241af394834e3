"""Numbers put into a compiled model, which no spec is asked for: springs, bodies, what a motor's lag leaves of kd."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from jax_inertia.diagnosis.effects.spec_joint import SOFT
from jax_inertia.model.joint_inertia import lighten, put_load, shift_centre
from jax_inertia.model.mujoco_types import MjModel
from jax_inertia.replay.joint_numbers import Numbers


class Maxwell(NamedTuple):
    """What a damper whose speed lags takes of a step; 0 where nothing lags."""

    implicit: np.ndarray
    """Damping of v' [N m s/rad]."""
    past: np.ndarray
    """Damping of w."""
    decay: np.ndarray
    """b, of w over the step."""


def maxwell(x: Numbers, h: float) -> Maxwell:
    """What the damping of a torque that lags by T takes of a step's speeds: implicitly of v', and of the past's w.

    (kp + kd s) / (T s + 1) = kp + d s / (T s + 1) with d = kd − kp T: a spring, and in parallel a damper d that feels a
    speed w which lags, T ẇ + w = v. Over a step h, w' = b w + (1 − b) v' with b = exp(−h / T), and d acts on the mean
    of w and w'. Without lag this is the midpoint rule.
    """
    lagging = x.behind > 0
    b = np.where(lagging, np.exp(-h / np.where(lagging, x.behind, 1.0)), 0.0)
    d = np.where(lagging, x.kd - x.kp * x.behind, 0.0)
    return Maxwell(0.5 * d * (1.0 - b), 0.5 * d * (1.0 + b), b)


def wind(nominal: MjModel, model: MjModel, dof: np.ndarray, qadr: np.ndarray, x: Numbers) -> None:
    """Springs of a model: its own and another one, κ and κ q₀ added up; a torque alone is that of a soft one.

    `dof`, `qadr`: of the log's joints.
    """
    joints = model.dof_jntid[dof]
    own, reference = nominal.jnt_stiffness[joints], nominal.qpos_spring[qadr]
    moment = own * reference + x.wound
    total = np.maximum(own + x.spring, SOFT * np.abs(moment))
    rest = moment / np.where(total > 0, total, 1.0)
    model.jnt_stiffness[joints] = total
    model.qpos_spring[qadr] = np.where(total > 0, rest, reference)


def sprung(stiffness: float, torque: float) -> tuple[float, float]:
    """Stiffness and rest of a spring that gives a torque at its zero; a torque alone is that of a soft one."""
    total = max(float(stiffness), SOFT * abs(float(torque)))
    return total, float(torque) / total if total > 0 else 0.0


def wind_across(model: MjModel, tendons: np.ndarray, joints: Sequence[int], x: Numbers) -> None:
    """Springs across joints and those before them, of a model with a tendon for each."""
    for t, j in zip(tendons, joints, strict=True):
        stiffness, rest = sprung(x.across[j], x.across_torque[j])
        model.tendon_stiffness[t], model.tendon_lengthspring[t] = stiffness, rest
        model.tendon_damping[t] = x.across_damping[j]
        model.wrap_prm[model.tendon_adr[t] + 1] = x.ratio[j]


def changed_bodies(x: Numbers) -> list[str]:
    """Names of bodies whose inertials are not the nominal ones."""
    return list(dict.fromkeys((*x.heavier, *x.mass, *x.shifts)))


def lightened(model: MjModel, dof: Int[np.ndarray, " n"], x: Numbers) -> list[str]:
    """Take from bodies what a loop's hold takes from the inertia of joints that have no rotor to take it from.

    `dof`: of the log's joints. Returned are the bodies. Behind play there is nothing but the rotor, and files have
    inertials of bodies by their names.
    """
    out = []
    for k in np.flatnonzero((x.armature < 0) & (x.play <= 0)).tolist():
        joint = int(model.dof_jntid[dof[k]])
        if name := model.body(int(model.jnt_bodyid[joint])).name:
            lighten(model, joint, -float(x.armature[k]))
            out.append(name)
    return out


def change_body(model: MjModel, name: str, x: Numbers) -> None:
    """Give a body of a model its inertial."""
    body = model.body(name).id
    if name in x.heavier:
        mass, inertia = x.heavier[name]
        put_load(model, body, mass * float(model.body_mass[body]), None)
        model.body_inertia[body] *= 1.0 + inertia
    if name in x.mass:
        put_load(model, body, x.mass[name], x.centres.get(name))
    if name in x.shifts:
        shift_centre(model, body, x.shifts[name])
