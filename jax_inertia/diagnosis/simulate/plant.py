"""A model in MuJoCo C, run from a log's states by its torques, and the log as that needs it."""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, Int

from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.diagnosis.effects.couplings import DAMPING_RATIO, DEFLECTION
from jax_inertia.diagnosis.effects.identified import Identified
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.diagnosis.features.two_mass import Coupling
from jax_inertia.diagnosis.simulate.step_law import Callback, law
from jax_inertia.logs.log import Log, TorqueKind
from jax_inertia.maths.finite_difference import derivative
from jax_inertia.model.load import ModelWarning, compile_spec
from jax_inertia.model.mujoco_types import MjModel, MjSpec
from jax_inertia.model.mujoco_warnings import mujoco_warnings
from jax_inertia.model.robot import Robot
from jax_inertia.signals.torque_residual import prepare

_MEMORY = 0.06  # of the torque before a window, which a delay or a lag still holds [s]
# ω² h² of a joint on its bristles, at most.
STIFFEST = 0.2


CREEPS = -1.0
"""In place of a displacement over which friction turns round: as MuJoCo's soft constraint at its defaults."""


_UNSTABLE = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)


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


class Twist(NamedTuple):
    """A hinge between a motor and its link along a log, the link's turn less the motor's."""

    position: Float[np.ndarray, " T"]
    """[rad]."""
    velocity: Float[np.ndarray, " T"]
    """[rad/s]."""
    held: Float[np.ndarray, " T"] | None
    """Dry friction of the link over its level, in [−1, 1], where the joint's friction is the link's."""


def coupling_of(e: Identified) -> Coupling:
    """Of an elastic or loose joint, as corrected.xml holds it."""
    play, on_link = (e.values.get(n, 0.0) for n in ("dead_zone", "friction_on_link"))
    return e.values["stiffness"], DAMPING_RATIO, play, 0.0, on_link


def twists(
    context: Context, effects: Sequence[Identified], *, predicted: bool = False
) -> dict[str, Twist]:
    """How the hinge between each soft joint's motor and its link turns along a log.

    `predicted`: by the motion alone, and not by the logged torque too.
    """
    out, link = {}, context.predicted_link if predicted else context.driven_link
    for e in effects:
        if e.family in ("joint_elasticity", "backlash"):
            coupling, on_link = coupling_of(e), e.values.get("friction_on_link", 0.0)
            row = context.joint_dofs[e.name]
            between, level = link(row), float(context.frictionloss[row])
            ahead = between.separation(coupling)
            held = between.rubbing(coupling) / level if on_link and level > 0 else None
            out[e.name] = Twist(-ahead, -derivative(context.time, ahead), held)
    return out


def rows_and_places(
    model: MjModel, joints: Sequence[int]
) -> tuple[Int[np.ndarray, " nv"], Int[np.ndarray, " nq"]]:
    """Where the speeds and positions of some joints stand in a model, which may have other joints between."""
    rows = [model.jnt_dofadr[j] + np.arange(_dofs(model, j)) for j in joints]
    places = [model.jnt_qposadr[j] + np.arange(_size(model, j)) for j in joints]
    return np.concatenate(rows), np.concatenate(places)


class Recording:
    """A log as the plants need it."""

    def __init__(self, robot: Robot, log: Log, effects: Sequence[Identified]):
        self.prepared = prepare(robot, log)
        self.torque = _Torque(log, robot)
        self._context = Context(self.prepared)
        self.twists = twists(self._context, effects)
        """Position and velocity of the hinge between motor and link, by joint."""

    def bent(self, k: int, turning: Float[np.ndarray, " nv"]) -> Float[np.ndarray, " r"]:
        """How far bristles are bent at a sample, −1 to 1, of the rows that have any."""
        bends = np.flatnonzero(turning > 0).tolist()
        paths = [self._context.bristle(row, float(turning[row])) for row in bends]
        return np.array([z[k] for z in paths])


class Plant:
    """One model, ready to be run from a state of the log."""

    def __init__(
        self,
        spec: MjSpec,
        robot: Robot,
        effects: Sequence[Identified],
        step: float,
        turning: Float[np.ndarray, " nv"],
        extra: Sequence[Effect] = (),
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
        self.law = law(model, self.effects, extra)
        self.data = mujoco.MjData(model)
        joints = [_joint_id(model, name, k) for k, name in enumerate(robot.joint_names)]
        model.jnt_limited[joints] = False
        # Rows and positions of the nominal model in this one, which may have hinges between.
        self.rows, self.places = rows_and_places(model, joints)
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
        sharp = np.ones(model.nv, bool)
        sharp[self.rows[turning == CREEPS]] = False
        model.dof_solref[sharp], model.dof_solimp[sharp, :2] = (2.0 * step, 1.0), 0.999
        # Likewise of a link behind its coupling.
        model.tendon_solref_fri, model.tendon_solimp_fri[:, :2] = (2.0 * step, 1.0), 0.999
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

    @mujoco_warnings()
    def run(self, recording: Recording, k: int, samples: np.ndarray) -> Float[np.ndarray, "S nv"]:
        """Positions at the samples, as the log's encoders would show them; zero on other rows."""
        model, data, torque = self.model, self.data, recording.torque
        time, step = recording.prepared.time, model.opt.timestep
        start, origin = float(time[k]), float(time[0])
        self._begin(recording, k)
        act = Callback(self.law)
        bent = recording.bent(k, self.turning)
        turns = self.turning > 0
        mine, reach = self.rows[turns], self.turning[turns]
        for u in self._on_rows(torque(start - np.arange(round(_MEMORY / step), 0, -1) * step)):
            act.arrives(u)
        out = np.zeros((len(samples), len(self.adr)))
        own = self.adr >= 0
        marks = {round(t / step): s for s, t in enumerate(samples.tolist())}
        steps = max(marks)
        # The torque of the middle of each step.
        middle = start + (np.arange(steps) + 0.5) * step
        applied, held = self._on_rows(torque(middle)), torque.index(middle)
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
                bent = side + (bent - side) * np.exp(-np.abs(moved) / reach)
                data.qfrc_applied[mine] -= model.dof_frictionloss[mine] * bent
                model.dof_frictionloss[mine] = 0.0
            if torque.wrench is not None:
                self._push(torque.bodies, torque.wrench[held[n]])
            mujoco.mj_step(model, data)
            if any(data.warning[kind].number for kind in _UNSTABLE):
                # MuJoCo starts anew from its home pose, which is no prediction of anything.
                out[[s for at, s in marks.items() if at > n]] = np.nan
                break
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

    def _begin(self, recording: Recording, k: int) -> None:
        """The log's state, and what lies between motor and link."""
        model, data = self.model, self.data
        motion = recording.prepared.observation.motion
        mujoco.mj_resetData(model, data)
        q, v = np.array(np.asarray(motion.q)[k]), np.array(np.asarray(motion.v)[k])
        own = self.adr >= 0
        q[self.adr[own]] /= self.scale[own]
        v[own] /= self.scale[own]
        data.qpos[self.places], data.qvel[self.rows] = q, v
        for name, (twist, rate, _) in recording.twists.items():
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
