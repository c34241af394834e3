"""What robots of any shape may have that no model of them has, for `any_robots.py`: one of 17 kinds, drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from any_tree import STEP, Joint, motion_span, unit
from effects import add_mass


@dataclass
class Odd:
    """An effect that no model of the robot has: changes of the model, and what acts at each step."""

    family: str
    place: str
    numbers: dict[str, float]
    edit: Callable[[mujoco.MjModel], None] = lambda model: None
    motor: Callable[[np.ndarray, mujoco.MjData], np.ndarray] = lambda tau, data: tau
    """Torque at the joints of what is commanded."""
    delay: float = 0.0  # s, of the torque behind the sensors
    zero: np.ndarray | None = None  # of the encoders
    force: Callable[[float, mujoco.MjData], None] = lambda time, data: None


def scaled(model: mujoco.MjModel, body: int, factor: float) -> None:
    model.body_mass[body] *= factor
    model.body_inertia[body] *= factor


def draw_odd(rng: np.random.Generator, robot: list[Joint], size: np.ndarray, top: float) -> Odd:
    """One of the families; `size`: rms torque of each joint without it, `top`: fastest frequency of the motion."""
    n = len(robot)
    j = int(rng.integers(n))
    name, body = robot[j].name, f"link_{robot[j].name[-1]}"
    u = lambda low, high: float(rng.uniform(low, high))  # noqa: E731
    sign = float(rng.choice([-1, 1]))
    one = np.eye(n)[j]

    def motor(change: Callable[[float, mujoco.MjData], float]):
        return lambda tau, d: tau + one * change(tau[j], d)

    def edit(attribute: str, index: int, value: float):
        def change(model):
            getattr(model, attribute)[index] = value

        return change

    def payload() -> Odd:
        mass, at = robot[j].mass * u(0.1, 0.5), robot[j].centre * 2 + 0.03 * rng.normal(size=3)
        return Odd(
            "payload",
            body,
            {"mass": mass},
            lambda m: add_mass(m, j + 1, mass, at, np.zeros((3, 3))),
        )

    def com_shift() -> Odd:
        off = unit(rng) * np.linalg.norm(robot[j].centre) * u(0.15, 0.5)

        def change(m):
            m.body_ipos[j + 1] += off

        return Odd("com_shift", body, {"shift": float(np.linalg.norm(off))}, change)

    def lighter() -> Odd:
        factor = 1.0 + sign * u(0.12, 0.3)
        return Odd("mass_scale", body, {"scale": factor}, lambda m: scaled(m, j + 1, factor))

    def gain() -> Odd:
        k = u(0.7, 0.92) if sign < 0 else u(1.08, 1.25)
        return Odd("torque_gain", name, {"gain": k}, motor=motor(lambda t, d: (k - 1) * t))

    def spring() -> Odd:
        k = size[j] * u(0.15, 0.5) / motion_span(robot)[j]
        return Odd("joint_spring", name, {"stiffness": k}, edit("jnt_stiffness", j, k))

    def stribeck() -> Odd:
        extra, vs = size[j] * u(0.1, 0.4), u(0.03, 0.2)
        law = lambda t, d: -extra * np.exp(-abs(d.qvel[j]) / vs) * np.tanh(d.qvel[j] / 0.004)  # noqa: E731
        return Odd("stribeck_friction", name, {"excess": extra, "velocity": vs}, motor=motor(law))

    def uneven() -> Odd:
        half = sign * size[j] * u(0.08, 0.25)
        law = lambda t, d: -half * np.tanh(abs(d.qvel[j]) / 0.004)  # noqa: E731
        return Odd("asymmetric_coulomb", name, {"half_difference": half}, motor=motor(law))

    def by_load() -> Odd:
        mu = u(0.06, 0.2)
        law = lambda t, d: -mu * abs(t) * np.tanh(d.qvel[j] / 0.01)  # noqa: E731
        return Odd("load_friction", name, {"mu": mu}, motor=motor(law))

    def drag() -> Odd:
        k = size[j] * u(0.1, 0.4) / (motion_span(robot)[j] * 2 * top) ** 2
        law = lambda t, d: -k * d.qvel[j] * abs(d.qvel[j])  # noqa: E731
        return Odd("quadratic_viscous", name, {"k": k}, motor=motor(law))

    def cogging() -> Odd:
        a, count, phase = size[j] * u(0.08, 0.25), int(rng.integers(4, 30)), u(0, 6.28)
        law = lambda t, d: a * np.sin(count * d.qpos[j] + phase)  # noqa: E731
        return Odd("cogging", name, {"amplitude": a, "periods": count}, motor=motor(law))

    def limit() -> Odd:
        most = size[j] * u(1.1, 1.6)
        law = lambda t, d: np.clip(t, -most, most) - t  # noqa: E731
        return Odd("torque_limit", name, {"limit": most}, motor=motor(law))

    def lag() -> Odd:
        time, state = u(0.004, 0.025), {}

        def law(t, d):
            last = state.get("x", t) if d.time > 0 else t
            state["x"] = last + (t - last) * min(1.0, STEP / time)
            return state["x"] - t

        return Odd("actuator_lag", name, {"time_constant": time}, motor=motor(law))

    def delay() -> Odd:
        late = u(0.004, 0.02)
        return Odd("time_delay", "global", {"delay": late}, delay=late)

    def encoder() -> Odd:
        off = sign * u(0.01, 0.06)
        return Odd("encoder_offset", name, {"offset": off}, zero=off * one)

    def tilt() -> Odd:
        turn, axis = u(0.02, 0.1), unit(rng) * [1, 1, 0]
        axis = axis / np.linalg.norm(axis)

        def change(m):
            down = m.opt.gravity.copy()
            m.opt.gravity[:] = np.cos(turn) * down + np.sin(turn) * np.cross(axis, down)

        return Odd("gravity_tilt", "global", {"angle": turn}, change)

    def pull() -> Odd:
        k = n - 1
        f = unit(rng) * size[k] / max(0.1, float(np.linalg.norm(robot[k].centre))) * u(0.2, 0.6)

        def act(t, d):
            d.xfrc_applied[k + 1, :3] += f

        return Odd(
            "external_force",
            f"link_{robot[k].name[-1]}",
            {"force": float(np.linalg.norm(f))},
            force=act,
        )

    def push() -> Odd:
        begin, last, k = u(3, 14), u(0.15, 0.6), n - 1
        f = unit(rng) * size[k] / max(0.1, float(np.linalg.norm(robot[k].centre))) * u(0.8, 2.5)

        def act(t, d):
            if begin <= t < begin + last:
                d.xfrc_applied[k + 1, :3] += f * np.sin(np.pi * (t - begin) / last)

        numbers = {"force": float(np.linalg.norm(f)), "start": begin, "duration": last}
        return Odd("push", f"link_{robot[k].name[-1]}", numbers, force=act)

    makers = (
        payload, com_shift, lighter, gain, spring, stribeck, uneven, by_load, drag, cogging, limit, lag, delay,
        encoder, tilt, pull, push,
    )  # fmt: skip
    return makers[rng.integers(len(makers))]()
