"""Open-loop rollouts in MuJoCo C: how far simulation and log part within a quarter of a second.

From states of the log, driven by the logged torque and nothing else, the nominal model (before), the corrected one
(after), and the corrected one against itself from states and torques with the sensors' noise once more, and with the
torque that the nominal model's own errors most likely have along the way (floor). In all of them dry friction turns
round as the log shows (`turning`): by bristles, or as sharply as the step allows, whatever `solreffriction` says.
"""

import dataclasses
import warnings
from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float

from jax_inertia._mujoco_types import MjModel, MjSpec
from jax_inertia.gap.callbacks import Callback, law
from jax_inertia.gap.chain import Prepared, prepare
from jax_inertia.gap.context import Context
from jax_inertia.gap.correct import DAMPING_RATIO, DEFLECTION, Correction
from jax_inertia.gap.effect import Effect
from jax_inertia.gap.motors import with_motors
from jax_inertia.gap.noise import perturbed
from jax_inertia.gap.trace import Trace
from jax_inertia.log import Log, TorqueKind
from jax_inertia.mjcf import ModelWarning, compile_spec
from jax_inertia.robot import Robot

_STEP = 5e-4
_MEMORY = 0.06  # of the torque before a window, which a delay or a lag still holds [s]
# ω² h² of a joint on its bristles, at most.
STIFFEST = 0.2
_STILL = 0.05  # no joint faster than this, and friction at rest decides what happens [rad/s]


@dataclasses.dataclass(frozen=True)
class Rollouts:
    """Errors of W windows and n joints, at S times from each window's start."""

    horizon: float
    joints: tuple[str, ...]
    starts: Float[np.ndarray, " W"]
    time: Float[np.ndarray, " S"]
    nominal: Float[np.ndarray, "W S n"]
    corrected: Float[np.ndarray, "W S n"]
    noise: Float[np.ndarray, "W S n"]
    notes: tuple[str, ...]

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
    trace: Trace,
    *,
    horizon: float = 0.25,
    windows: int = 24,
    seed: int = 0,
) -> Rollouts | None:
    """Roll both models out from evenly spaced moments of the log; None where nothing moves, or where contacts are
    not measured.

    `trace` is of a diagnosis of this log: what it excuses belongs to the floor.
    """
    if robot.has_free_base and log.contact_wrench is None:
        return None
    effects = (*correction.in_model, *correction.by_callback)
    clean = _Recording(robot, log, effects)
    noisy = _Recording(
        robot,
        perturbed(with_motors(log, robot, trace.motors), np.random.default_rng(seed)),
        effects,
    )
    prepared = clean.prepared
    passing = [e.values["start"] for e in effects if e.family == "push"]
    starts = _starts(prepared, horizon, windows, passing)
    if not len(starts):
        return None
    period = 1.0 / log.rate
    step = period / max(1, round(period / _STEP))
    samples = np.linspace(0.0, horizon, 26)
    before = _Plant(nominal, robot, (), step, trace.turning)
    after = _Plant(correction.spec, robot, effects, step, trace.turning)
    joints = [k for k, adr in enumerate(before.adr) if adr >= 0]
    paths: list[list[np.ndarray]] = [[], [], []]
    for k in starts.tolist():
        measured = _positions(prepared, before, k, samples)
        own = after.run(clean, k, samples)
        paths[0].append(before.run(clean, k, samples) - measured)
        paths[1].append(own - measured)
        drift = _positions(noisy.prepared, before, k, samples) - measured
        paths[2].append(after.run(noisy, k, samples, trace) - own - drift)
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
    edge = prepared.settings.margin
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


def _positions(prepared: Prepared, plant: "_Plant", k: int, samples: np.ndarray) -> np.ndarray:
    """Joint positions of the log on the plant's rows (S, nv); zero on rows without a position of their own."""
    at = prepared.time[k] + samples
    q = np.asarray(prepared.observation.motion.q)
    out = np.zeros((len(samples), len(plant.adr)))
    for row, adr in enumerate(plant.adr):
        if adr >= 0:
            out[:, row] = np.interp(at, prepared.time, q[:, adr])
    return out


class _Torque:
    """Torque of the log on the model's rows, and measured wrenches, at any time."""

    def __init__(self, log: Log, robot: Robot):
        self.time = np.asarray(log.time, float)
        rows = dict(zip(robot.joint_names, robot.joint_dofadr, strict=True))
        tau = np.nan_to_num(np.asarray(log.tau, float))
        self.tau = np.zeros((len(tau), robot.nv))
        self.tau[:, [rows[name] for name in log.joint_names]] = tau
        self.held = log.tau_kind is not TorqueKind.SENSOR
        self.wrench = None if log.contact_wrench is None else np.asarray(log.contact_wrench, float)
        self.bodies = log.contact_bodies

    def index(self, t: np.ndarray) -> np.ndarray:
        return np.clip(np.searchsorted(self.time, t + 1e-9) - 1, 0, len(self.time) - 2)

    def __call__(self, t: np.ndarray) -> np.ndarray:
        k = self.index(t)
        if self.held:
            return self.tau[k]
        share = ((t - self.time[k]) / (self.time[k + 1] - self.time[k]))[:, None]
        return (1 - share) * self.tau[k] + share * self.tau[k + 1]


class _Recording:
    """A log as the plants need it."""

    def __init__(self, robot: Robot, log: Log, effects: Sequence[Effect]):
        self.prepared = prepare(robot, log)
        self.torque = _Torque(log, robot)
        self._context = Context(self.prepared)
        self.twists: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        """Position and velocity of the hinge between motor and link, by joint."""
        rows = dict(zip(robot.joint_names, robot.joint_dofadr, strict=True))
        for e in effects:
            if e.family in ("joint_elasticity", "backlash"):
                coupling = e.values["stiffness"], DAMPING_RATIO, e.values.get("dead_zone", 0.0)
                ahead = self._context.separation(rows[e.name], coupling)
                self.twists[e.name] = -ahead, -np.gradient(ahead, self.prepared.time)

    def bent(self, k: int, turning: Float[np.ndarray, " nv"]) -> Float[np.ndarray, " r"]:
        """How far bristles are bent at a sample, −1 to 1, of the rows that have any."""
        bends = np.flatnonzero(turning).tolist()
        paths = [self._context.bristle(row, float(turning[row])) for row in bends]
        return np.array([z[k] for z in paths])


class _Plant:
    """One model, ready to be run from a state of the log."""

    def __init__(
        self,
        spec: MjSpec,
        robot: Robot,
        effects: Sequence[Effect],
        step: float,
        turning: Float[np.ndarray, " nv"],
    ):
        spec = spec.copy()
        spec.option.timestep = step
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        off = mujoco.mjtDisableBit
        spec.option.disableflags |= int(off.mjDSBL_CONTACT) | int(off.mjDSBL_ACTUATION)
        for key in list(spec.keys):
            spec.delete(key)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ModelWarning)  # said when the model was loaded
            self.model = model = compile_spec(spec)
        self.effects = tuple(effects)
        self.law = law(model, self.effects)
        self.data = mujoco.MjData(model)
        joints = [_joint_id(model, name, k) for k, name in enumerate(robot.joint_names)]
        model.jnt_limited[joints] = False
        # Rows and positions of the nominal model in this one, which may have hinges between.
        self.rows = np.concatenate(
            [model.jnt_dofadr[j] + np.arange(_dofs(model, j)) for j in joints]
        )
        self.places = np.concatenate(
            [model.jnt_qposadr[j] + np.arange(_size(model, j)) for j in joints]
        )
        self.adr = np.full(robot.nv, -1)
        self.names = [""] * robot.nv
        for name, j, dof, adr in zip(
            robot.joint_names, joints, robot.joint_dofadr, robot.joint_qposadr, strict=True
        ):
            if _dofs(model, j) == 1:
                self.adr[dof], self.names[dof] = adr, name
        self.scale = np.ones(robot.nv)
        self.contact_scale = {
            e.name: e.values["scale"] for e in self.effects if e.family == "contact_force_scale"
        }
        for e in self.effects:
            if e.family == "encoder_scale":
                self.scale[self.names.index(e.name)] = 1.0 + e.values["scale"]
        # Dry friction as MuJoCo has it by default holds some hundredths of a radian a second back: real friction turns
        # within a fraction of a milliradian, and each reversal would cost a milliradian at the horizon.
        model.dof_solref[:], model.dof_solimp[:, :2] = (2.0 * step, 1.0), 0.999
        self.friction = model.dof_frictionloss.copy()
        # Bristles too stiff for the step to follow are as good as sharp.
        stiff = self.friction[self.rows] * step**2 > STIFFEST * turning * self._inertia()
        self.turning = np.where((turning > 0) & ~stiff, turning, 0.0)

    def _inertia(self) -> Float[np.ndarray, " nv"]:
        """What each row's own torque accelerates, as the model stands at first [kg m²]."""
        mujoco.mj_forward(self.model, self.data)
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, full)
        return np.diagonal(full)[self.rows]

    def run(
        self, recording: "_Recording", k: int, samples: np.ndarray, erring: Trace | None = None
    ) -> Float[np.ndarray, "S nv"]:
        """Positions at the samples, as the log's encoders would show them; zero on other rows.

        `erring`: a trace whose errors of the model act as well.
        """
        model, data, torque = self.model, self.data, recording.torque
        time, step = recording.prepared.time, model.opt.timestep
        start, origin = float(time[k]), float(time[0])
        self._begin(recording, k)
        act = Callback(self.law)
        bent = recording.bent(k, self.turning)
        mine = self.rows[self.turning > 0]
        for u in self._on_rows(torque(start - np.arange(round(_MEMORY / step), 0, -1) * step)):
            act.arrives(u)
        out = np.zeros((len(samples), len(self.adr)))
        own = self.adr >= 0
        marks = {round(t / step): s for s, t in enumerate(samples.tolist())}
        steps = max(marks)
        # The torque of the middle of each step.
        middle = start + (np.arange(steps) + 0.5) * step
        applied, held = self._on_rows(torque(middle)), torque.index(middle)
        errors = np.zeros_like(applied)
        if erring is not None:
            rows = [np.interp(middle - origin, erring.time, x) for x in erring.erring.T]
            errors = self._on_rows(np.stack(rows, axis=1))
        seen, scale = self.places[self.adr[own]], self.scale[own]
        for n in range(steps + 1):
            if n in marks:
                out[marks[n], own] = data.qpos[seen] * scale
            if n == steps:
                break
            data.time = start - origin + n * step
            data.qfrc_applied[:] = applied[n]
            model.dof_frictionloss[:] = self.friction
            act(model, data)
            if len(mine):
                # Dahl's bristles (1968) over this step, in the solver's place.
                moved = data.qvel[mine] * step
                side = np.sign(moved)
                bent = side + (bent - side) * np.exp(
                    -np.abs(moved) / self.turning[self.turning > 0]
                )
                data.qfrc_applied[mine] -= model.dof_frictionloss[mine] * bent
                model.dof_frictionloss[mine] = 0.0
            # Behind what the drive passes on: a gain or a limit is none of it.
            data.qfrc_applied += errors[n]
            if torque.wrench is not None:
                self._push(torque.bodies, torque.wrench[held[n]])
            mujoco.mj_step(model, data)
        return out

    def _on_rows(self, tau: np.ndarray) -> np.ndarray:
        out = np.zeros((len(tau), self.model.nv))
        out[:, self.rows] = tau
        return out

    def _push(self, bodies: Sequence[str], wrenches: np.ndarray) -> None:
        """Measured wrenches, about each body's frame origin."""
        model, data = self.model, self.data
        for name, w in zip(bodies, wrenches, strict=True):
            body = model.body(name).id
            w = w / self.contact_scale.get(name, 1.0)
            mujoco.mj_applyFT(model, data, w[:3], w[3:], data.xpos[body], body, data.qfrc_applied)

    def _begin(self, recording: "_Recording", k: int) -> None:
        """The log's state, and what lies between motor and link."""
        model, data = self.model, self.data
        motion = recording.prepared.observation.motion
        mujoco.mj_resetData(model, data)
        q, v = np.array(np.asarray(motion.q)[k]), np.array(np.asarray(motion.v)[k])
        own = self.adr >= 0
        q[self.adr[own]] /= self.scale[own]
        v[own] /= self.scale[own]
        data.qpos[self.places], data.qvel[self.rows] = q, v
        for name, (twist, rate) in recording.twists.items():
            hinge = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name + DEFLECTION)
            if hinge >= 0:
                data.qpos[model.jnt_qposadr[hinge]] = twist[k]
                data.qvel[model.jnt_dofadr[hinge]] = rate[k]
        mujoco.mj_forward(model, data)


def _joint_id(model: MjModel, name: str, k: int) -> int:
    """By name; joints without one keep their number, since hinges are only added behind named ones."""
    found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
    return found if found >= 0 else k


def _dofs(model: MjModel, j: int) -> int:
    return {0: 6, 1: 3}.get(int(model.jnt_type[j]), 1)


def _size(model: MjModel, j: int) -> int:
    return {0: 7, 1: 4}.get(int(model.jnt_type[j]), 1)
