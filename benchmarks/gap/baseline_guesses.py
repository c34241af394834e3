"""Columns of every linear family at every place, for the greedy baseline."""

from __future__ import annotations

import numpy as np
from baseline_chain import SIGN, Guess, Residual, body_pi


def guesses(r: Residual) -> list[Guess]:
    """All of them; an effect adds e = columns θ to the joint's torque, and so to the missing torque."""
    return [*_joints(r), *_encoders(r), *_global(r), *_bodies(r), *_contacts(r)]


def _joints(r: Residual) -> list[Guess]:
    out, m = [], r.model
    for name, (dof, adr) in r.joints.items():
        v, one = r.v[:, dof], np.ones(len(r.v))
        s = np.tanh(v / SIGN)
        dry, load = -float(m.dof_frictionloss[dof]), np.abs(r.inverse[:, dof])
        # family: columns, their least θ, the numbers that are reported
        table = {
            "viscous_friction": ([-v], [-m.dof_damping[dof]], lambda t: {"damping": t[0]}),
            "coulomb_friction": ([-s], [dry], lambda t: {"coulomb": t[0]}),
            "asymmetric_coulomb": (
                [-np.maximum(s, 0), -np.minimum(s, 0)],
                [dry, dry],
                lambda t: {"positive": t[0], "negative": t[1]},
            ),
            "load_friction": (
                [-s, -s * load],
                [dry, 0.0],
                lambda t: {"coulomb": t[0], "load_coefficient": t[1]},
            ),
            "armature": ([-r.a[:, dof]], [-m.dof_armature[dof]], lambda t: {"armature": t[0]}),
            "joint_spring": (
                [-r.q[:, adr], one],
                [0.0, -np.inf],
                lambda t: {"stiffness": t[0], "rest_angle": t[1] / t[0] if t[0] else 0.0},
            ),
            "torque_gain": ([r.tau[:, dof]], [-1.0], lambda t: {"gain": 1.0 + t[0]}),
            "torque_bias": ([one], [-np.inf], lambda t: {"bias": t[0]}),
        }
        for family, (columns, least, parameters) in table.items():
            full = np.zeros((*r.v.shape, len(columns)))
            full[:, dof] = np.stack(columns, axis=1)
            out.append(
                Guess(family, "joint", name, r.finish(full), parameters, tuple(map(float, least)))
            )
    return out


def _encoders(r: Residual, h: float = 1e-4) -> list[Guess]:
    """What a wrong path of one joint makes of the needed torque, by finite differences."""
    out = []
    for name, (dof, adr) in r.joints.items():
        shifted = r.q.copy()
        shifted[:, adr] += h
        offset = (r.needed(shifted, r.v, r.a) - r.inverse) / h
        stretched = [x.copy() for x in (r.q, r.v, r.a)]
        for x, at in zip(stretched, (adr, dof, dof), strict=True):
            x[:, at] *= 1 + h
        scale = (r.needed(*stretched) - r.inverse) / h
        for family, column, parameter in (
            ("encoder_offset", offset, "offset"),
            ("encoder_scale", scale, "scale"),
        ):
            out.append(
                Guess(
                    family,
                    "joint",
                    name,
                    r.finish(column[:, :, None]),
                    lambda t, parameter=parameter: {parameter: t[0]},
                )
            )
    return out


def _global(r: Residual, h: float = 1e-4) -> list[Guess]:
    """A late torque to first order; gravity turned about world x and y."""
    late = -np.gradient(r.tau, 1.0 / r.rate, axis=0)
    gravity, turned = r.model.opt.gravity.copy(), []
    for axis in np.eye(3)[:2]:
        r.model.opt.gravity[:] = gravity + h * np.cross(axis, gravity)
        turned.append((r.inverse - r.needed(r.q, r.v, r.a)) / h)
    r.model.opt.gravity[:] = gravity
    return [
        Guess(
            "time_delay",
            "global",
            "global",
            r.finish(late[:, :, None]),
            lambda t: {"delay": t[0]},
            (0.0,),
        ),
        Guess(
            "gravity_tilt",
            "global",
            "global",
            r.finish(np.stack(turned, axis=2)),
            lambda t: {"tilt_x": t[0], "tilt_y": t[1]},
        ),
    ]


def _bodies(r: Residual) -> list[Guess]:
    out = []
    bodies = r.bodies()
    regressor, rows, speed = r.body_columns(list(bodies.values()))
    for i, (name, body) in enumerate(bodies.items()):
        pi = body_pi(r.model, body)
        m, c = pi[0], pi[1:4] / pi[0]
        central = pi[4:] - (m * (c @ c * np.eye(3) - np.outer(c, c)))[np.triu_indices(3)]
        y, f, v = regressor[:, :, i], rows[:, :, i], speed[:, i]
        drag = np.einsum("tjc,tc->tj", f, -np.linalg.norm(v, axis=1)[:, None] * v)
        free, least = (-np.inf,) * 3, (0.0,)
        table = {
            "payload": (-y[:, :, :4], (*least, *free), lambda t: {"mass": t[0]}),
            "com_shift": (-y @ _shifts(m, c).T, free, lambda t: _along("com_shift", t)),
            "link_inertia": (
                -(y[:, :, 4:] @ central)[:, :, None],
                (-1.0,),
                lambda t: {"inertia_scale": 1.0 + t[0]},
            ),
            "constant_force": (f, free, lambda t: _along("force", t)),
            "drag": (drag[:, :, None], least, lambda t: {"coefficient": t[0]}),
        }
        for family, (columns, bounds, parameters) in table.items():
            out.append(Guess(family, "body", name, r.finish(columns), parameters, bounds))
    return out


def _shifts(m: float, c: np.ndarray) -> np.ndarray:
    """∂π of a centre of mass moved along x, y, z, its rotational part included (3, 10)."""
    out = []
    for axis in np.eye(3):
        turn = m * (2 * c @ axis * np.eye(3) - np.outer(c, axis) - np.outer(axis, c))
        out.append([0.0, *(m * axis), *turn[np.triu_indices(3)]])
    return np.array(out)


def _contacts(r: Residual) -> list[Guess]:
    return [
        Guess(
            "contact_force_scale",
            "contact",
            name,
            r.finish(r.contact[:, k, :, None]),
            lambda t: {"scale": 1.0 / (1.0 + t[0])},
        )
        for k, name in enumerate(r.contacts)
    ]


def _along(name: str, vector: np.ndarray) -> dict[str, float]:
    return {f"{name}_{k}": float(x) for k, x in zip("xyz", vector, strict=True)}
