"""The torque error of a diagnosis' files as written: report.json and corrected.xml, read back and run along a log.

    e = F[needed − g reached] / g,   needed = ID(corrected.xml; q, q̇, q̈) + friction law − forces on bodies

ID is MuJoCo's inverse dynamics without constraints and without the damping of joints, which the friction law of
report.json holds; `reached` is the logged torque after delay, lag and limits, g the motor's gain; F is the chain's last
low-pass.
What a soft joint bends by is taken from the motion, never from the torque that is to be predicted.
What the two files do not hold is not counted, whatever the fit knew.
"""

import copy
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.checks import PASSING
from jax_inertia.diagnosis.effects.actuator import Late
from jax_inertia.diagnosis.effects.base import Effect, Moment
from jax_inertia.diagnosis.effects.couplings import DEFLECTION
from jax_inertia.diagnosis.effects.encoder import off_path
from jax_inertia.diagnosis.effects.identified import GAIN, Identified, effects_in
from jax_inertia.diagnosis.effects.registry import known
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.diagnosis.friction_curve import FrictionCurve, LinkApart, Moving
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.simulate.plant import coupling_of, rows_and_places, twists
from jax_inertia.diagnosis.simulate.step_law import Law, centre_velocity, law
from jax_inertia.maths.finite_difference import derivative
from jax_inertia.model.mujoco_types import MjData, MjModel


class HandedOver:
    """What a diagnosis hands over, read back from its files."""

    def __init__(
        self,
        report: Mapping[str, Any],
        model: MjModel,
        nominal: MjModel,
        extra: Sequence[Effect] = (),
    ):
        self.effects = effects_in(report)
        self.curves = {
            name: FrictionCurve.read(own) for name, own in report.get("friction", {}).items()
        }
        self.extra = tuple(extra)
        self.model, self.nominal = (_unconstrained(m) for m in (model, nominal))
        for damping in ("dof_damping", "dof_dampingpoly", "tendon_damping", "tendon_dampingpoly"):
            getattr(self.model, damping)[:] = 0.0

    @classmethod
    def read(cls, folder: Path, nominal: MjModel, extra: Sequence[Effect] = ()) -> "HandedOver":
        """From report.json and corrected.xml of a folder; ValueError where they are none."""
        report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        model = mujoco.MjModel.from_xml_path(str(folder / "corrected.xml"))
        return cls(report, model, nominal, extra)

    def on_another_run(self) -> "HandedOver":
        """The same without what happened once in the log that was diagnosed."""
        out = copy.copy(self)
        out.effects = tuple(e for e in self.effects if e.family not in PASSING)
        return out

    def residual(self, residual: Residual) -> Float[np.ndarray, "R n"]:
        """Torque residual of a log with what is handed over, in units of the logged torque [N m]."""
        context = residual.context
        gain, reached = self._gains(context), self._reached(context)
        needed = self._needed(context, gain, reached)
        # What the nominal model needs holds the contacts, measured or taken from the legs: they are in both.
        change = needed - self._nominal(context) - context.prepared.dry
        # In units of the joints' torque first: what legs carry on forces of the ground that are not measured is of it.
        return residual.prepared.finish_torque(context.inverse + change - gain * reached) / gain

    def ringing(
        self, residual: Residual, left: Float[np.ndarray, "R n"]
    ) -> Float[np.ndarray, "R n"]:
        """Of a residual `left`, what links on springs ring by from how a log found them [N m].

        Two numbers of each soft joint and each log, by least squares in units of the sensors' noise: no encoder sees
        where a link is when a log begins.
        """
        context, columns = residual.context, []
        for e in self.effects:
            if e.family == "joint_elasticity":
                row = context.joint_dofs[e.name]
                rings = context.driven_link(row).ringing(coupling_of(e))
                rotor = float(context.armature[row]), float(context.damping[row])
                columns.append(off_path(context, row, rings, rotor).values)
        if not columns:
            return np.zeros_like(left)
        every = residual.prepared.finish_torque(np.concatenate(columns, axis=-1))
        every /= self._gains(context)[:, None]
        root = np.sqrt(residual.weight) / np.maximum(residual.sensors, 1e-12)
        flat = (every * root[..., None]).reshape(-1, every.shape[-1])
        return every @ np.linalg.lstsq(flat, (root * left).ravel(), rcond=1e-9)[0]

    # --- what reaches the joints

    def _rows(self, e: Identified, context: Context) -> list[int]:
        joints = context.joint_dofs
        return list(joints.values()) if e.kind == "global" else [joints[e.name]]

    def _gains(self, context: Context) -> Float[np.ndarray, " nv"]:
        out = np.ones(context.v.shape[1])
        for e in self.effects:
            if e.family == GAIN:
                out[self._rows(e, context)] *= e.values["gain"]
        return out

    def _reached(self, context: Context) -> Float[np.ndarray, "T nv"]:
        """Logged torque as late as it acts, and as far as a drive's limits let it."""
        tau, step = context.tau.copy(), float(context.time[1] - context.time[0])
        for e in self.effects:
            effect = known(e.family, self.extra)
            if isinstance(effect, Late):
                rows = self._rows(e, context)
                (by,) = e.values.values()
                tau[:, rows] = effect.later(tau[:, rows], step, by)
        limits = law(self.model, tuple(e for e in self.effects if self._limits(e)), self.extra)
        if limits.parts:
            rows = _Path(self.model, (), context).rows
            whole, v = np.zeros((2, len(tau), self.model.nv))
            whole[:, rows], v[:, rows] = tau, context.v
            applied = [
                limits(np, Moment(v[k], v[k], whole[k], context.time[k], None, None)).torque
                for k in range(len(tau))
            ]
            tau = np.array(applied)[:, rows]
        return tau

    def _limits(self, e: Identified) -> bool:
        """Whether an effect is of the logged torque, before the motor's gain."""
        effect = known(e.family, self.extra)
        late = isinstance(effect, Late) or e.family == GAIN
        return effect is not None and effect.before_gain and effect.acts and not late

    def _adds(self, e: Identified) -> bool:
        """Whether a step law adds an effect to what acts: neither friction, which its law holds, nor of the drive."""
        effect = known(e.family, self.extra)
        if effect is None or e.family == GAIN or isinstance(effect, Late) or effect.is_friction:
            return False
        return effect.acts and not effect.before_gain

    # --- what the joints need

    def _nominal(self, context: Context) -> Float[np.ndarray, "T nv"]:
        """Of the model as given, damping in it and dry friction not."""
        path, data = _Path(self.nominal, (), context), mujoco.MjData(self.nominal)
        return np.array([path.inverse(self.nominal, data, k) for k in range(len(context.v))])

    def _needed(self, context: Context, gain, reached) -> Float[np.ndarray, "T nv"]:
        """Torque at the joints that the corrected model needs, friction in it and less what else acts."""
        model, path = self.model, _Path(self.model, self.effects, context)
        adds = law(model, tuple(e for e in self.effects if self._adds(e)), self.extra)
        data, needed, added = (
            mujoco.MjData(model),
            np.zeros_like(context.v),
            np.zeros_like(context.v),
        )
        for k in range(len(context.v)):
            needed[k] = path.inverse(model, data, k)
            if adds.parts:
                whole = np.zeros(model.nv)
                whole[path.rows] = gain * reached[k]
                added[k] = self._added(adds, data, whole, context.time[k])[path.rows]
        for e in self.effects:
            if e.family == "contact_force_scale":
                torque = context.contact_rows[:, context.contacts.index(e.name)]
                added += (1.0 / e.values["scale"] - 1.0) * torque
        return needed + self._rubbed(context, path, needed) - added

    def _added(self, adds: Law, data: MjData, u, time: float) -> Float[np.ndarray, " nv"]:
        """Torque that a step law adds to the commanded torque `u`, by its forces on bodies too [N m; slide: N]."""
        model = self.model
        q = np.where(adds.adr >= 0, data.qpos[adds.adr], 0.0)
        velocity = centre_velocity(data, model.body_rootid) if adds.pushed else None
        turn = data.xmat.reshape(-1, 3, 3)
        applied = adds(np, Moment(q, data.qvel, u, time, turn, velocity))
        out = np.asarray(applied.torque) - u
        for body in adds.pushed:
            force, moment = applied.wrench[body, :3], applied.wrench[body, 3:]
            mujoco.mj_applyFT(model, data, force, moment, data.xipos[body], body, out)
        return out

    def _rubbed(self, context: Context, path: "_Path", needed) -> Float[np.ndarray, "T nv"]:
        """Friction of every joint by the law of the report; of a coupled motor at its own speed."""
        rotor = self.model.dof_armature[path.rows] * path.a
        out = np.zeros_like(context.v)
        coupled = {e.name: e for e in self.effects if e.family == "joint_coupling"}
        for name, row in context.joint_dofs.items():
            curve = self.curves[name]
            loads = needed[:, row] - rotor[:, row], needed[:, row]
            link = path.links.get(name)
            own = Moving(context, row, *loads, scale=path.scale.get(name, 1.0), link_apart=link)
            out[:, row] += curve.torque(own)
            if name in coupled:
                e = coupled[name]
                other, c = context.joint_dofs[e.other], e.values["coefficient"]
                cross = e.values["friction_of_other_speed"]
                turned = curve.dry(own.turned_with(other, c))
                out[:, row] += cross * context.v[:, other] + turned - curve.dry(own)
                out[:, other] += cross * context.v[:, row] + c * turned
        return out


class _Path:
    """A log's motion on the rows of a corrected model, which may have hinges between."""

    def __init__(self, model: MjModel, effects: Sequence[Identified], context: Context):
        robot = context.robot
        joints = [model.joint(name).id for name in robot.joint_names]
        self.rows, self.places = rows_and_places(model, joints)
        self.q, self.v, self.a = context.q.copy(), context.v.copy(), context.a.copy()
        places = dict(zip(robot.joint_names, robot.joint_qposadr, strict=True))
        self.twists = []
        self.scale: dict[str, float] = {}
        """Of each joint's logged positions over the real ones, where that is not one."""
        for e in effects:
            if e.family == "encoder_scale":
                row, share = context.joint_dofs[e.name], 1.0 + e.values["scale"]
                self.scale[e.name] = share
                self.q[:, places[e.name]] /= share
                self.v[:, row] /= share
                self.a[:, row] /= share
        self.links: dict[str, LinkApart] = {}
        """Of each joint whose friction is its link's, how that moves and is held."""
        for name, (twist, rate, held) in twists(context, effects, predicted=True).items():
            if held is not None:
                self.links[name] = LinkApart(rate, held)
            hinge = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name + DEFLECTION)
            if hinge >= 0:
                own = model.jnt_qposadr[hinge], model.jnt_dofadr[hinge]
                self.twists.append((*own, twist, rate, derivative(context.time, rate)))

    def inverse(self, model: MjModel, data: MjData, k: int) -> Float[np.ndarray, " nv"]:
        """Inverse dynamics of a sample, on the log's rows."""
        data.qpos[self.places], data.qvel[self.rows] = self.q[k], self.v[k]
        data.qacc[self.rows] = self.a[k]
        for adr, dof, twist, rate, twice in self.twists:
            data.qpos[adr], data.qvel[dof], data.qacc[dof] = twist[k], rate[k], twice[k]
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse[self.rows]


def _unconstrained(model: MjModel) -> MjModel:
    out = copy.copy(model)
    out.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    return out
