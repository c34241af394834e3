"""The robots as the controller meets them: a fleet in MuJoCo C at 1 kHz, seen through noisy sensors.

Nothing of the package's dynamics is used here. A tick is three steps of 1 ms under constant torques; the robot reads
its state at the end, and over the last window the means of everything that the estimator needs: accelerations are
differences of measured velocities, and torques and contact forces are averaged over the same interval.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout

from jax_inertia.robots import CORNERS, HumanoidOptions, Terrain, humanoid_mjcf

STEP = 0.001  # s
PER_TICK = 3
TICK = STEP * PER_TICK  # 333 Hz
NQ, NV, NU = 30, 29, 23
THREADS = int(os.environ.get("PAPER_THREADS", "1"))  # of one fleet's plant


@dataclass(frozen=True)
class Sensors:
    """Standard deviations of white noise on every 1 kHz sample; figures of our own, usual for such robots."""

    joint_position: float = 1e-4  # rad
    joint_velocity: float = 5e-3  # rad/s
    base_position: float = 5e-4  # m
    base_orientation: float = 1e-3  # rad
    base_velocity: float = 2e-3  # m/s
    base_rate: float = 2e-3  # rad/s
    torque: float = 0.3  # N m
    corner_force: float = 3.0  # N, each axis of each corner
    window: int = 9  # steps over which accelerations are differences
    fitted: bool = False  # accelerations are slopes of lines fitted to the window, not of its ends
    sampled_forces: bool = False  # contact forces of the last step only, not the window's mean

    def velocity(self) -> np.ndarray:
        """Of v (29,)."""
        return np.array(
            [self.base_velocity] * 3 + [self.base_rate] * 3 + [self.joint_velocity] * NU
        )

    def weights(self) -> np.ndarray:
        """How much each step of the window counts (window,), sum one: in accelerations, torques, forces alike.

        All steps alike give the difference of the ends. A parabola gives the slope of the line fitted to v, which of
        all weights lets the least of its white noise through: w/6 times less variance than the ends.
        """
        k = np.arange(1.0, self.window + 1)
        weight = k * (self.window + 1 - k) if self.fitted else np.ones(self.window)
        return weight / weight.sum()

    def acceleration(self) -> np.ndarray:
        """Of v̇ (29,)."""
        change = np.diff(self.weights(), prepend=0.0, append=0.0)
        return self.velocity() * np.linalg.norm(change) / STEP

    def averaged(self) -> float:
        """Of a window's mean, in parts of one sample's."""
        return float(np.linalg.norm(self.weights()))

    def foot_force(self) -> float:
        """Of one foot's vertical force, four corners together, as `Sensed` gives it [N]."""
        return 2.0 * self.corner_force * (1.0 if self.sampled_forces else self.averaged())


@dataclass
class Sensed:
    """What a tick begins with, one row a robot."""

    q: np.ndarray
    v: np.ndarray
    mean_q: np.ndarray
    mean_v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    force: np.ndarray  # (robots, 8, 3), world axes


def mjcf(*, terrain: Terrain = Terrain.FLAT, solref: tuple[float, float] = (0.006, 1.0)) -> str:
    """The humanoid for the plant: Newton to convergence, corner sensors, nothing to draw."""
    options = HumanoidOptions(
        terrain=terrain,
        timestep=STEP,
        solver_iterations=30,
        line_search_iterations=30,
        solref=solref,
        corner_forces=True,
        corner_positions=True,
        visual=False,
    )
    return humanoid_mjcf(options)


def model(
    *, terrain: Terrain = Terrain.FLAT, solref: tuple[float, float] = (0.006, 1.0)
) -> mujoco.MjModel:
    """The plant's humanoid without anything that its model lacks."""
    return mujoco.MjModel.from_xml_string(mjcf(terrain=terrain, solref=solref))


class LinkMass:
    """Sets a link's mass, its inertia in proportion and its centre of mass unmoved."""

    def __init__(self, model: mujoco.MjModel, body: str) -> None:
        self.model, self.id = model, model.body(body).id
        self.nominal = float(model.body_mass[self.id])
        self.inertia = model.body_inertia[self.id].copy()
        self.mass = self.nominal

    def set(self, mass: float) -> None:
        change, self.mass = mass - self.mass, mass
        self.model.body_mass[self.id] = mass
        self.model.body_inertia[self.id] = self.inertia * (mass / self.nominal)
        body = self.id
        while body:  # MuJoCo refers its inertias to the subtree's centre of mass
            self.model.body_subtreemass[body] += change
            body = self.model.body_parentid[body]
        self.model.body_subtreemass[0] += change


class Fleet:
    """So many robots of one model, each with its own noise and, on corner planes, its own ground."""

    def __init__(
        self,
        model: mujoco.MjModel,
        seeds: np.ndarray,
        sensors: Sensors,
        *,
        height: Callable[[np.ndarray], np.ndarray] | None = None,
        disturb: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
    ) -> None:
        """`height(xy)` (robots, 8, 2) → (robots, 8) is the ground's; `disturb(q, v)` a torque (robots, 29) beside the
        motors', which no sensor sees.
        """
        self.model, self.sensors, self.size = model, sensors, len(seeds)
        self.rng = [np.random.default_rng([int(s), 7]) for s in seeds]
        self.pool = rollout.Rollout(nthread=THREADS)
        self.data = [mujoco.MjData(model) for _ in range(THREADS)]
        mujoco.mj_resetDataKeyframe(model, self.data[0], 0)
        self.spec = mujoco.mjtState.mjSTATE_FULLPHYSICS
        start = np.empty(mujoco.mj_stateSize(model, self.spec))
        mujoco.mj_getState(model, self.data[0], start, self.spec)
        self.state = np.tile(start, (self.size, 1))
        mujoco.mj_forward(model, self.data[0])
        at = [model.sensor(f"{c.name}_force").adr[0] for c in CORNERS]
        self.force_at = np.array(at)[:, None] + np.arange(3)
        at = [model.sensor(f"{c.name}_position").adr[0] for c in CORNERS]
        self.position_at = np.array(at)[:, None] + np.arange(3)
        self.corners = np.tile(self.data[0].sensordata[self.position_at], (self.size, 1, 1))
        self.height, self.disturb = height, disturb
        control = mujoco.mjtState.mjSTATE_CTRL
        self.control_spec = int(control)
        if height is not None:
            self.control_spec |= int(mujoco.mjtState.mjSTATE_MOCAP_POS)
        if disturb is not None:
            self.control_spec |= int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)
        self.warm = np.zeros((self.size, NV))
        self.time = 0.0
        window = sensors.window
        noisy_q, noisy_v = self._measure(self.q, self.v, self._draw(1)[:, 0, 24 + NU :])
        self.q_window = np.repeat(noisy_q[:, None], window + 1, axis=1)
        self.v_window = np.repeat(noisy_v[:, None], window + 1, axis=1)
        self.tau_window = np.zeros((self.size, window, NV))
        self.force_window = np.zeros((self.size, window, 8, 3))

    @property
    def q(self) -> np.ndarray:
        """True positions."""
        return self.state[:, 1 : 1 + NQ]

    @property
    def v(self) -> np.ndarray:
        """True velocities."""
        return self.state[:, 1 + NQ : 1 + NQ + NV]

    @property
    def seen(self) -> bool:
        """Whether the window is full; before, the forces of its first steps are missing."""
        return round(self.time / STEP) >= self.sensors.window

    def sense(self) -> Sensed:
        """The latest sample and the window's means."""
        steps = self.sensors.weights()
        # Of samples: each step has one at either end, and its acceleration is their difference.
        samples = 0.5 * (np.append(steps, 0.0) + np.append(0.0, steps))
        slope = -np.diff(steps, prepend=0.0, append=0.0) / STEP
        mean_q = np.einsum("bwn,w->bn", self.q_window, samples)
        mean_q[:, 3:7] /= np.linalg.norm(mean_q[:, 3:7], axis=1, keepdims=True)
        force = self.force_window
        return Sensed(
            q=self.q_window[:, -1].copy(),
            v=self.v_window[:, -1].copy(),
            mean_q=mean_q,
            mean_v=np.einsum("bwn,w->bn", self.v_window, samples),
            a=np.einsum("bwn,w->bn", self.v_window, slope),
            tau=np.einsum("bwn,w->bn", self.tau_window, steps),
            force=force[:, -1].copy()
            if self.sensors.sampled_forces
            else np.einsum("bwpn,w->bpn", force, steps),
        )

    def step(self, torque: np.ndarray) -> None:
        """One tick under these torques (robots, 23)."""
        limit = self.model.actuator_ctrlrange[:, 1]
        torque = np.clip(np.nan_to_num(torque), -limit, limit)
        control = self._control(torque)
        before = self.state
        states, sensed = self.pool.rollout(
            self.model,
            self.data,
            before,
            np.repeat(control[:, None], PER_TICK, axis=1),
            control_spec=self.control_spec,
            initial_warmstart=self.warm,
        )
        noise = self._draw(PER_TICK)
        for k in range(PER_TICK):
            self.state = states[:, k]
            self._record(torque, sensed[:, k], noise[:, k])
        self.state = states[:, -1].copy()
        self.warm = (self.v - before[:, 1 + NQ : 1 + NQ + NV]) / TICK
        self.corners = sensed[:, -1][:, self.position_at]
        self.time += TICK

    def _control(self, torque: np.ndarray) -> np.ndarray:
        """Controls in MuJoCo's order of state elements: ctrl, qfrc_applied, mocap_pos."""
        parts = [torque]
        if self.disturb is not None:
            parts.append(self.disturb(self.q, self.v))
        if self.height is not None:
            ground = self.corners.copy()
            ground[..., 2] = self.height(self.corners[..., :2])
            parts.append(ground.reshape(self.size, -1))
        return np.concatenate(parts, axis=1)

    def _record(self, torque: np.ndarray, sensordata: np.ndarray, noise: np.ndarray) -> None:
        # The sensor gives the contact's axes: z, y, −x of the world.
        f = sensordata[:, self.force_at]
        force = np.stack([-f[..., 2], f[..., 1], f[..., 0]], axis=-1)
        force = force + self.sensors.corner_force * noise[:, :24].reshape(-1, 8, 3)
        tau = np.zeros((self.size, NV))
        tau[:, 6:] = torque + self.sensors.torque * noise[:, 24 : 24 + NU]
        q, v = self._measure(self.q, self.v, noise[:, 24 + NU :])
        for window, new in (
            (self.q_window, q),
            (self.v_window, v),
            (self.tau_window, tau),
            (self.force_window, force),
        ):
            window[:, :-1] = window[:, 1:]
            window[:, -1] = new

    def _measure(
        self, q: np.ndarray, v: np.ndarray, noise: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        s = self.sensors
        out = q.copy()
        out[:, :3] += s.base_position * noise[:, :3]
        out[:, 7:] += s.joint_position * noise[:, 6:NV]
        # A small rotation δ in the body's frame: q ∘ (1, δ/2).
        w, u = q[:, 3:4], q[:, 4:7]
        half = 0.5 * s.base_orientation * noise[:, 3:6]
        out[:, 3:4] = w - np.sum(u * half, axis=1, keepdims=True)
        out[:, 4:7] = u + w * half + np.cross(u, half)
        out[:, 3:7] /= np.linalg.norm(out[:, 3:7], axis=1, keepdims=True)
        return out, v + s.velocity() * noise[:, NV:]

    def _draw(self, samples: int) -> np.ndarray:
        """Of each robot's own noise: forces, torques, positions and velocities of so many samples."""
        return np.stack([r.standard_normal((samples, 24 + NU + 2 * NV)) for r in self.rng])
