"""Open-loop rollouts in MuJoCo C: how far simulation and log part within a quarter of a second.

From states of the log, driven by the logged torque and nothing else, the nominal model (before), the corrected one
(after), and the corrected one against itself from states and torques with the sensors' noise once more, and with the
torque that the nominal model's own errors most likely have along the way (floor). In all of them dry friction turns
round as the log shows (`turning`): by bristles, as sharply as the step allows, or by the model's own soft constraint.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.simulate.corrected import Correction
from jax_inertia.diagnosis.simulate.plant import Plant, Recording
from jax_inertia.logs.log import Log
from jax_inertia.model.mujoco_types import MjSpec
from jax_inertia.model.robot import Robot
from jax_inertia.signals.sensor_noise import perturbed
from jax_inertia.signals.torque_residual import Prepared

_STEP = 5e-4
# Windows with the sensors' noise once more: by fewer a floor errs by a tenth or two.
_NOISY = 36
_STILL = 0.05  # no joint faster than this, and friction at rest decides what happens [rad/s]


@dataclasses.dataclass(frozen=True)
class Rollouts:
    """Errors of W windows and n joints, at S times from each window's start; of the noise, D: every window, as many
    times as its floor needs."""

    horizon: float
    joints: tuple[str, ...]
    starts: Float[np.ndarray, " W"]
    time: Float[np.ndarray, " S"]
    nominal: Float[np.ndarray, "W S n"]
    corrected: Float[np.ndarray, "W S n"]
    noise: Float[np.ndarray, "D S n"]
    notes: tuple[str, ...]
    rotates: tuple[bool, ...]
    """Which of the joints are no slides."""

    @property
    def unit(self) -> str:
        """Of the errors over all joints."""
        if all(self.rotates):
            return "rad"
        return "rad and m" if any(self.rotates) else "m"

    @property
    def shown(self) -> float:
        """What errors are multiplied by for people: degrees where all joints rotate."""
        return 180.0 / np.pi if all(self.rotates) else 1.0

    @property
    def shown_in(self) -> str:
        """Their unit then."""
        return "deg" if all(self.rotates) else self.unit

    @property
    def before(self) -> float:
        """Root mean square over windows and joints at the horizon [rad; m on slides]."""
        return _last(self.nominal)

    @property
    def after(self) -> float:
        """As `before`, with the effects added."""
        return _last(self.corrected)

    @property
    def floor(self) -> float:
        """What the noise of the sensors and the nominal model's own errors leave."""
        return _last(self.noise)


def rollouts(
    nominal: MjSpec,
    correction: Correction,
    robot: Robot,
    log: Log,
    turning: Float[np.ndarray, " nv"],
    *,
    horizon: float = 0.25,
    windows: int = 36,
    seed: int = 0,
) -> Rollouts | None:
    """Roll both models out from evenly spaced moments of the log; None where nothing moves, or where contacts are
    not measured. `turning`: displacement over which each row's dry friction turns round [rad], or `plant.CREEPS`.
    """
    if robot.has_free_base and log.contact_wrench is None:
        return None
    effects = correction.effects
    clean, rng = Recording(robot, log, effects), np.random.default_rng(seed)
    prepared = clean.prepared
    passing = [e.values["start"] for e in effects if e.family == "push"]
    starts = _starts(prepared, horizon, windows, passing)
    if not len(starts):
        return None
    draws = math.ceil(_NOISY / len(starts))
    noisy = [Recording(robot, perturbed(log, rng), effects) for _ in range(draws)]
    period = 1.0 / log.rate
    step = period / max(1, round(period / _STEP))
    samples = np.linspace(0.0, horizon, 26)
    before = Plant(nominal, robot, (), step, turning)
    after = Plant(correction.spec, robot, effects, step, turning, correction.extra)
    joints = [k for k, adr in enumerate(before.adr) if adr >= 0]
    paths: list[list[np.ndarray]] = [[], [], []]
    for k in starts.tolist():
        measured = _positions(prepared, before, k, samples)
        own = after.run(clean, k, samples)
        paths[0].append(before.run(clean, k, samples) - measured)
        paths[1].append(own - measured)
        for again in noisy:
            drift = _positions(again.prepared, before, k, samples) - measured
            paths[2].append(after.run(again, k, samples) - own - drift)
    rotates = {
        name: robot.topology.dof_rotates[row]
        for name, row in zip(robot.joint_names, robot.joint_dofadr, strict=True)
    }
    nominal_, corrected_, noise = (np.nan_to_num(np.array(p), nan=np.pi) for p in paths)
    return Rollouts(
        horizon,
        tuple(before.names[k] for k in joints),
        prepared.time[starts] - prepared.time[0],
        samples,
        nominal_[:, :, joints],
        corrected_[:, :, joints],
        noise[:, :, joints],
        correction.notes,
        tuple(bool(rotates[before.names[k]]) for k in joints),
    )


def _last(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error[:, -1] ** 2)))


def _starts(
    prepared: Prepared, horizon: float, windows: int, passing: Sequence[float]
) -> np.ndarray:
    """Indices on the fast grid whose windows are measured throughout and in motion.

    Where something happens in passing, windows are to see it: half of them lie about it.
    """
    time = prepared.time
    edge = prepared.bands.margin
    first, last = time[0] + edge, time[-1] - edge - horizon
    wanted = [np.linspace(first, last, windows // (2 if passing else 1))]
    for start in passing:
        near = np.linspace(start - horizon, start, windows // (2 * len(passing)))
        wanted.append(np.clip(time[0] + near, first, last))
    starts = np.searchsorted(time, np.sort(np.concatenate(wanted)))
    length = round(horizon * prepared.rate)
    valid = np.asarray(prepared.observation.motion.valid)
    moving = np.abs(np.asarray(prepared.observation.motion.v)).max(axis=1)
    good = [k for k in starts if valid[k : k + length].all() and moving[k] > _STILL]
    return np.array(good, int)


def _positions(prepared: Prepared, plant: Plant, k: int, samples: np.ndarray) -> np.ndarray:
    """Joint positions of the log on the plant's rows (S, nv); zero on rows without a position of their own."""
    at = prepared.time[k] + samples
    q = np.asarray(prepared.observation.motion.q)
    out = np.zeros((len(samples), len(plant.adr)))
    for row, adr in enumerate(plant.adr):
        if adr >= 0:
            out[:, row] = np.interp(at, prepared.time, q[:, adr])
    return out
