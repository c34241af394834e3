"""A load as the drivers of robots take it: mass, centre and inertia in the frame of the flange, as a line to run.

| driver | line | centre | inertia |
|---|---|---|---|
| ur | `set_target_payload` of URScript | m | about the centre, along the flange's axes: Ixx, Iyy, Izz, Ixy, Ixz, Iyz |
| franka | `setLoad` of libfranka, `SetLoad` of franka_msgs | m | the same as a matrix, column by column |
| kuka | `LOAD_DATA` of KRL | mm | principal moments; A, B, C turn z, y', x'' onto their axes [deg] |
| xarm | `set_tcp_load` of its SDK | mm | none |
"""

from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jax_inertia.estimation.log_estimate import LogEstimate
from jax_inertia.maths.inertial_parameters import is_physical, rotational_inertia
from jax_inertia.model.spec import compile_spec, load_spec
from jax_inertia.text.closest_names import suggestion

DRIVERS = ("ur", "franka", "kuka", "xarm")


class Frame(NamedTuple):
    """A frame that is fixed to a body."""

    rotation: Float[np.ndarray, "3 3"]
    """Its axes in those of the body, column by column."""
    origin: Float[np.ndarray, "3"]
    """In the body's frame [m]."""


class Payload(NamedTuple):
    """A load in the frame of a flange."""

    mass: float
    """[kg]"""
    centre: Float[np.ndarray, "3"]
    """[m]"""
    inertia: Float[np.ndarray, "3 3"]
    """About the centre, along the frame's axes [kg m²]; zero where the log's is that of no body."""
    physical: bool
    """Whether it is that of a body."""

    @classmethod
    def of(cls, pi: Float[np.ndarray, "10"], frame: Frame | None = None) -> "Payload":
        """Of a load's π about its body's frame; `frame`: of the flange, the body's own without it.

            c' = Rᵀ (h / m − p),   I' = Rᵀ (I − m (c·c 1 − c cᵀ)) R

        Raises ValueError where the mass is not above zero.

        >>> import numpy as np
        >>> from jax_inertia.control.payload import Payload
        >>> pi = np.array([2.0, 0.2, 0.0, 0.0, 0.01, 0.0, 0.0, 0.03, 0.0, 0.03])
        >>> load = Payload.of(pi)
        >>> load.mass, load.centre.tolist(), load.inertia.diagonal().round(6).tolist()
        (2.0, [0.1, 0.0, 0.0], [0.01, 0.01, 0.01])
        """
        mass = float(pi[0])
        if not mass > 0:
            raise ValueError(f"a load of {mass:.3g} kg is none: no line for a driver")
        r, p = (np.eye(3), np.zeros(3)) if frame is None else frame
        c, physical = np.asarray(pi[1:4]) / mass, bool(is_physical(jnp.asarray(pi)))
        about = np.asarray(rotational_inertia(jnp.asarray(pi)))
        about = about - mass * (c @ c * np.eye(3) - np.outer(c, c))
        inertia = r.T @ about @ r if physical else np.zeros((3, 3))
        return cls(mass, r.T @ (c - p), inertia, physical)

    def line(self, driver: str) -> str:
        """The line that a driver runs; ValueError for one that is unknown.

        >>> import numpy as np
        >>> from jax_inertia.control.payload import Payload
        >>> load = Payload(2.0, np.array([0.1, 0.0, 0.0]), np.diag([0.01, 0.02, 0.03]), True)
        >>> print(load.line("ur"))
        set_target_payload(2, [0.1, 0, 0], [0.01, 0.02, 0.03, 0, 0, 0])
        >>> print(load.line("xarm"))
        arm.set_tcp_load(2, [100, 0, 0])
        """
        m, c, i = f"{self.mass:.4g}", self.centre, self.inertia
        if driver == "ur":
            six = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
            return f"set_target_payload({m}, [{_row(c)}], [{_row(six)}])"
        if driver == "franka":
            return f"robot.setLoad({m}, {{{{{_row(c)}}}}}, {{{{{_row(i.T.ravel())}}}}})"
        if driver == "kuka":
            moments, axes = np.linalg.eigh(i)
            axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
            turns = Rotation.from_matrix(axes).as_euler("ZYX", degrees=True)
            if not self.physical:
                turns = np.zeros(3)
            cm = _named("X Y Z A B C", [*(1e3 * c), *turns])
            return f"LOAD_DATA[1] = {{M {m}, CM {{{cm}}}, J {{{_named('X Y Z', moments)}}}}}"
        if driver == "xarm":
            return f"arm.set_tcp_load({m}, [{_row(1e3 * c)}])"
        raise ValueError(f"no driver {driver!r} is known; {suggestion(driver, DRIVERS)}")


def carried(found: LogEstimate) -> Float[np.ndarray, "10"]:
    """π of what the one body of an estimate has beyond the model, or beyond its calibration [kg, kg m, kg m²].

    Of the whole log, or where the body changed of its end. Raises ValueError for several bodies.
    """
    if len(found.bodies) != 1:
        raise ValueError("a driver takes one load: give one body")
    (body,) = found.bodies
    if found.calibration is None and not found.changed:
        return np.asarray(found.fit.added.pi)[0]
    robot = found.robot if found.calibration is None else found.calibration.robot
    return found.pi[body] - np.asarray(robot.pi)[robot.body_index(body)]


def payload_report(
    found: LogEstimate, driver: str, frame: Frame | None, flange: str | None
) -> dict[str, Any]:
    """The load for a driver in the form of report.json, with the lines that are printed of it."""
    (body,) = found.bodies
    pi = carried(found)
    where = body if flange is None else flange
    if not pi[0] > 0:
        return {
            "driver": driver,
            "frame": where,
            "line": None,
            "said": [f"{body} carries no load: no line for {driver}"],
        }
    load = Payload.of(pi, frame)
    line = load.line(driver)
    said = [f"Carried beyond the model, in the frame of {where}, for {driver}:", f"  {line}"]
    if not load.physical:
        said.append("Its inertia is left out: the log's is that of no body.")
    return {
        "driver": driver,
        "frame": where,
        "mass_kg": load.mass,
        "com_m": load.centre.tolist(),
        "inertia_kg_m2": load.inertia.tolist() if load.physical else None,
        "line": line,
        "said": said,
    }


def frame_of(model: Path, name: str, body: str) -> Frame:
    """A site or a link of a model's file in the frame of a body that it is fixed to; ValueError where it is not."""
    compiled = compile_spec(load_spec(model), model)
    data = mujoco.MjData(compiled)
    mujoco.mj_kinematics(compiled, data)
    own = compiled.body(body).id
    sites = {compiled.site(k).name: k for k in range(compiled.nsite)}
    bodies = {compiled.body(k).name: k for k in range(compiled.nbody)}
    if name in sites:
        k = sites[name]
        at, turn, to = data.site_xpos[k], data.site_xmat[k], int(compiled.site_bodyid[k])
    elif name in bodies:
        k = to = bodies[name]
        at, turn = data.xpos[k], data.xmat[k]
    else:
        raise ValueError(
            f"{model} has no site or link {name!r}; {suggestion(name, [*sites, *bodies])}"
        )
    if compiled.body_weldid[to] != compiled.body_weldid[own]:
        raise ValueError(f"{name} is not fixed to {body}: a joint lies between them")
    axes = data.xmat[own].reshape(3, 3)
    return Frame(axes.T @ turn.reshape(3, 3), axes.T @ (at - data.xpos[own]))


def _row(values) -> str:
    return ", ".join(f"{x + 0.0:.4g}" for x in np.where(np.abs(values) < 1e-12, 0.0, values))


def _named(names: str, values) -> str:
    return ", ".join(
        f"{n} {x}" for n, x in zip(names.split(), _row(values).split(", "), strict=True)
    )
