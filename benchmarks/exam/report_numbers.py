"""Numbers of a report, and the friction that they state, by the equations of docs/effects.md."""

from __future__ import annotations

import numpy as np

from benchmarks.exam.torque_error import SIGN


def number(effect: dict, *names: str, default: float | None = None) -> float:
    """The first of these parameters that the effect states."""
    for name in names:
        p = effect["parameters"].get(name)
        if p is not None and p.get("value") is not None:
            return float(p["value"])
    if default is None:
        raise KeyError(f"{effect['family']} states none of {names}")
    return default


def vector(effect: dict, name: str) -> np.ndarray:
    """A vector as one parameter, or as three with axes in their names."""
    whole = effect["parameters"].get(name)
    if whole is not None and np.ndim(whole["value"]) == 1:
        return np.array(whole["value"], float)
    return np.array([number(effect, f"{name}_{k}", default=0.0) for k in "xyz"])


def dahl(v: np.ndarray, dt: float, displacement: float, straight: bool = False) -> np.ndarray:
    """Dry friction over its level with a presliding displacement [rad]: dz/dt = v / displacement (1 − z sign v).

    `straight`: dz/dt = v / displacement until it slips at ±1. Exact for steps of a path.
    """
    z = np.full_like(v, np.sign(v[0]))
    # Central differences along the path: the step from one row to the next is the mean of both rows' speeds.
    for k, step in enumerate(0.5 * (v[1:] + v[:-1]) * dt / displacement):
        if straight:
            z[k + 1] = min(max(z[k] + step, -1.0), 1.0)
        else:
            z[k + 1] = np.sign(step) + (z[k] - np.sign(step)) * np.exp(-abs(step))
    return z


CREEP = 2.0 / (0.95 * 0.02)
"""Damping of MuJoCo's friction loss at its defaults [1/s]."""
LAWS = {
    *("stribeck_friction", "load_friction", "asymmetric_coulomb", "asymmetric_viscous"),
    *("quadratic_friction", "quadratic_viscous", "friction_drift"),
}
"""Families whose torque is in the friction law of a report that states one."""


def push_window(effect: dict, time: np.ndarray) -> np.ndarray:
    """w(t) of a push: Tukey's window, skewed."""
    start, end = number(effect, "start"), number(effect, "end")
    flank, skew = number(effect, "flank", default=0.1), number(effect, "skew", default=0.0)
    phase = np.clip((time - start) / (end - start), 0.0, 1.0)
    near = np.minimum(np.minimum(phase, 1.0 - phase) / flank, 1.0)
    return 0.5 * (1.0 - np.cos(np.pi * near)) * (1.0 + skew * np.sin(2.0 * np.pi * phase))


def law_torque(
    terms: list[dict], time: np.ndarray, bodies: np.ndarray, v: np.ndarray, a: np.ndarray, needed: np.ndarray
) -> tuple[np.ndarray, set[str]]:  # fmt: skip
    """Friction of one joint along its motion (T,) by a report's `friction`, and the forms that are not known.

    `bodies`: what the bodies need of this joint, `needed`: with rotor and offset [N m].
    """
    dt = float(time[1] - time[0])
    out, of_motor, unknown = np.zeros_like(v), 0.0, set()
    z, speed = direction(terms[0], v, a, dt), np.abs(v)
    for term in terms:
        x, form = term["value"], term["form"]
        if form in ("bristle", "creep"):
            out += x * direction(term, v, a, dt)
        elif form == "slow":
            out += x * z * np.exp(-((speed / term["speed"]) ** term["exponent"]))
        elif form == "load" and not term["of_motor"]:
            out += x * z * np.abs(bodies)
        elif form == "load":
            of_motor += x
        elif form == "constant":
            out += x
        elif form == "by_direction":
            out += x * np.abs(z)
        elif form == "viscous":
            out += x * v
        elif form == "quadratic":
            out += x * speed * v
        elif form == "slope_by_direction":
            out += 0.5 * x * speed
        elif form == "drift":
            out += x * np.exp(-time / term["time_constant"]) * v
        else:
            unknown.add(f"friction: {form}")
    if of_motor:
        # The motor's torque τ has this friction in it: τ (1 − μ z sign τ) is what it needs without.
        own = needed + out
        out += own * (1.0 / (1.0 - of_motor * z * np.sign(own)) - 1.0)
    return out, unknown


def direction(term: dict, v: np.ndarray, a: np.ndarray, dt: float) -> np.ndarray:
    """z of one bristle (T,)."""
    if term["form"] == "creep":
        return np.clip((v + a / CREEP) / term["speed"], -1.0, 1.0)
    if not term["displacement"]:
        return np.tanh(v / SIGN)
    return dahl(v, dt, term["displacement"], bool(term["straight"]))
