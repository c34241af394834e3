"""A model with position loops at a log's joints, compiled, and set to any numbers of a fit."""

import copy
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, Int

from jax_inertia.diagnosis.effects.environment import turned
from jax_inertia.model.joint_inertia import (
    mass_matrix,
    middles,
    without_contacts,
)
from jax_inertia.model.mujoco_types import MjModel, MjSpec
from jax_inertia.replay.joint_numbers import Numbers, decoded, nominal_numbers
from jax_inertia.replay.loop import ALL, Loop, Parameter, actuators_on
from jax_inertia.replay.simulation.model_edits import (
    change_body,
    changed_bodies,
    lightened,
    maxwell,
    wind,
    wind_across,
)
from jax_inertia.replay.simulation.spec_edits import (
    DEAD,
    INTEGRAL,
    PLAY,
    PULL,
    actuator_of,
    add_across,
    add_dead_band,
    add_force,
    add_integral,
    add_play,
    with_loop,
    without_integral,
)

STEP = 1e-3
"""A model's own steps are taken where they are no shorter [s]; one with shorter steps is replayed in these, or in
shorter ones where a stiff loop moves a light joint.

One for all structures of a model: what another step does to a replay is not to count for or against play.
"""
QUICK = 4e-3
"""The same where it is differences of replays that count: where dry friction turns or holds a joint, steps are of first
order. Two links with 0.05 N m of it were replayed by 0.62 mrad at 4 ms, with 0.045 N m, and by 0.15 mrad at 1 ms.
"""
CREEPING = 2e-3
"""`QUICK` where friction creeps, which it does by a rate of 100 / s: where a joint all but stops it errs by 0.9 mrad
at 4 ms, 0.3 mrad at 2 ms."""
_STEPS_PER_RADIAN = 4.0
"""At least: steps in 1/ω of the stiffest loop, whose frequency then comes out right to (ω h)²/24 = 0.3 %."""
_SHORTEST = 5e-4
_TAKEN = 0.75
"""Of the inertia that is there, what `Plant._lighter` takes away at most."""
_ROTOR = 1e-4
"""Of a motor behind play, at least [kg m²]."""
HOLD = np.array([0.9999, 0.9999, 0.001, 0.5, 2.0])
"""solimp of dry friction that holds a joint at rest.

With MuJoCo's own (0.9) friction creeps under load f at R f / b, R = (1 − 0.9)/0.9 / M and b ≈ 100 / s: 0.3 N m on
0.03 kg m² at 10 mrad/s. On a real arm replays of slow motions erred by 41 mrad so, and by 16 mrad with this figure.
"""
_INERTIAL = "body_mass", "body_inertia", "body_ipos", "body_iquat", "body_sameframe"
_FILTERS = mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT


class Structure(NamedTuple):
    """What a compiled model has beyond joints and loops: dead bands (everywhere or nowhere), play, forces."""

    dead: bool = False
    play: tuple[int, ...] = ()
    """Joints that have it."""
    pulled: tuple[str, ...] = ()
    """Bodies on which a constant force acts."""
    integral: tuple[int, ...] = ()
    """Joints whose drive has an integral term."""
    across: bool = False
    """Whether there are springs across joints and those before them."""


class Compiled(NamedTuple):
    """A model of one structure, and where a log's joints are in it."""

    model: MjModel
    qadr: Int[np.ndarray, " n"]
    dof: Int[np.ndarray, " n"]
    act: Int[np.ndarray, " n"]
    gear: Float[np.ndarray, " n"]
    dead: Int[np.ndarray, " n"] | None
    """Actuators of dead bands."""
    play: Int[np.ndarray, " p"]
    """Joints of play, in the structure's order."""
    pull: Int[np.ndarray, "f 3"]
    """Actuators of forces, in the structure's order."""
    integral: Int[np.ndarray, " i"]
    """Actuators of integral terms, in the structure's order."""
    across: Int[np.ndarray, " t"]
    """Tendons of springs across joints, in the order of `Plant.pairs`."""
    copies: list[MjModel]
    """To be set to one variant each."""


class Own(NamedTuple):
    """What a model's own steps H do to its motion, to the second order (`Plant`)."""

    step: float
    """H [s]."""
    early: float
    """How much earlier a control acts than without steps [s]."""
    of_damping: float
    """Of each joint's damping, what its inertia has more [s]."""
    of_kd: float
    """The same of kd."""
    integrator: int


def neighbours(model: MjModel, dofs: Int[np.ndarray, " n"]) -> list[tuple[int, int]]:
    """Pairs of joints, by their places in `dofs`, of which the second is the next of a chain after the first."""
    place = {int(d): j for j, d in enumerate(dofs)}
    before = [int(model.dof_parentid[d]) for d in dofs]
    return [(place[b], j) for j, b in enumerate(before) if b in place]


def own_step(spec: MjSpec) -> Own:
    """Of a spec as it is.

    Positions of MuJoCo's implicit steps are those of the leapfrog, velocities half a step before them: a control that
    is set at a position acts from H/2 before it to H/2 after it. (M + H D) (v' − v)/H = f − D v is the midpoint rule
    with D H/2 too much inertia; kd taken explicitly, by Euler's integrator, is at the speed half a step before, with
    kd H/2 too little. A Runge–Kutta step does neither.
    """
    h, of = float(spec.option.timestep), mujoco.mjtIntegrator
    if spec.option.integrator == of.mjINT_RK4:
        return Own(h, 0.0, 0.0, 0.0, int(spec.option.integrator))
    sign = -1.0 if spec.option.integrator == of.mjINT_EULER else 1.0
    return Own(h, 0.5 * h, 0.5 * h, sign * 0.5 * h, int(spec.option.integrator))


def _converging(spec: MjSpec) -> None:
    """Let the solver of friction go on until it converges, by MuJoCo's own figures at least; the spec is changed.

    A model for MJX stops it early (4 iterations), and replays are then a rough function of their numbers: by 34 µrad of
    an arm, where numbers one deviation apart differ by 50. Sums of columns that cancel do not then, and what several
    numbers do together (gains, frictions and masses by one factor) was known to 0.03 %.
    """
    own = mujoco.MjSpec().option
    o = spec.option
    o.iterations, o.ls_iterations = (
        max(o.iterations, own.iterations),
        max(o.ls_iterations, own.ls_iterations),
    )
    o.tolerance = min(o.tolerance, own.tolerance)
    o.ls_tolerance = min(o.ls_tolerance, own.ls_tolerance)


class Plant:
    """A model with position actuators at a log's joints, to be replayed with other numbers than its own.

    The spec is changed. `holds`: dry friction holds a joint at rest, which MuJoCo's own figures let creep.

    The numbers are those of the model in its own steps H (`own_step`): a file that holds them replays in MuJoCo as the
    plant does. Other steps h are of second order: to a model's armature is added what steps H do and taken what steps h
    do (`_lighter`), and controls are as early as in steps H. Of a leg with friction in 4 s, against steps of 0.1 ms:

        h = 1 ms: 0.59 mrad with D h, 0.04 mrad with D h/2; h = 4 ms: 2.4 and 0.21 mrad
    """

    def __init__(self, spec: MjSpec, names: Sequence[str], loop: Loop, *, holds: bool = False):
        if loop.source != "model":
            with_loop(spec, names, loop)
        self.own = own_step(spec)
        # Delay and lag of the model are of the targets, which get them before they get there.
        delay, lag = np.zeros((2, len(names)))
        integral = np.array([without_integral(spec, name) for name in names])
        for j, name in enumerate(names):
            a = actuator_of(spec, name)
            delay[j] = a.delay
            a.delay, a.nsample = 0.0, 0
            if a.dyntype in _FILTERS:
                lag[j] = a.dynprm[0]
                # What is filtered acts a step later, or at once.
                delay[j] += 0.0 if a.actearly else self.own.step
                a.dyntype = mujoco.mjtDyn.mjDYN_NONE
        self.names, self.loop, self.holds = tuple(names), loop, holds
        self.step, self._room = 0.0, np.zeros(len(names))
        self._spec, self._compiled = spec, {}
        model = spec.compile()
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        _converging(spec)
        self.pairs: list[tuple[int, int]] = []
        m = self.compiled(Structure())
        self.model, self.qadr, self.dof = m.model, m.qadr, m.dof
        self.pairs = neighbours(m.model, m.dof)
        """Joints of the log that follow each other in a chain, the one nearer to the base first."""
        self.nominal = nominal_numbers(
            loop,
            model.dof_armature[m.dof],
            model.dof_damping[m.dof],
            model.dof_frictionloss[m.dof],
            m.gear * model.actuator_biasprm[m.act, 0],
            delay,
            lag,
            middles(model, self.names),
        )
        self.nominal = self.nominal._replace(integral=integral[:, 0], windup=integral[:, 1])
        if self.own.of_kd < 0:
            self.nominal = self.nominal._replace(step_of_kd=-np.ones(len(names)))
        coupled = model.neq > 0 or not without_contacts(model)
        trees = model.dof_treeid[m.dof]
        self.trees = np.zeros_like(trees) if coupled else trees
        """Joints of separate trees on a fixed base do not feel each other."""
        self.quick = self.in_steps(0.0)
        """The same in long steps."""
        self.retime(loop.kp)

    def retime(self, kp: Float[np.ndarray, " n"]) -> None:
        """Take steps as long as loops of these gains allow."""
        whole = self._inertia(np.zeros(len(kp)))
        inertia = np.diagonal(whole)
        stiff = 1.0 / (_STEPS_PER_RADIAN * np.sqrt(np.max(kp / inertia)))
        damping = np.maximum(self.nominal.damping + self.loop.kd, np.sqrt(kp * inertia))
        # The longest time for which M − time · D is no less than none, in any direction of the joints' space.
        scale = 1.0 / np.sqrt(damping)
        longest = max(float(np.linalg.eigvalsh(whole * np.outer(scale, scale))[0]), 0.0)
        stable = min(stiff, max(2.0 * _TAKEN * longest, _SHORTEST))
        own = self.own.step if self.own.early and self.own.step >= STEP else min(STEP, stable)
        longest_quick = QUICK if self.holds else CREEPING
        for plant, h in ((self, own), (self.quick, max(min(longest_quick, stable), own))):
            plant._room = longest * damping
            plant._take(float(h))

    def told_each(self, period: float) -> None:
        """Say how often targets change [s], which is how often a low-pass of theirs is asked."""
        for plant in (self, self.quick):
            each = np.full(len(self.names), period)
            plant.nominal = plant.nominal._replace(low_pass_period=each)

    def _take(self, h: float) -> None:
        self.step = h
        for m in self._compiled.values():
            for one in (m.model, *m.copies):
                self._set_step(one)

    @property
    def _as_the_model(self) -> bool:
        """Whether steps are the model's own, which then do to its motion what they do."""
        return self.step == self.own.step and self.own.early > 0

    def _set_step(self, model: MjModel) -> None:
        model.opt.timestep = self.step
        implicit = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
        model.opt.integrator = self.own.integrator if self._as_the_model else implicit

    def halve(self) -> bool:
        """Take steps half as long; False where they are as short as they may be."""
        if self.step <= _SHORTEST:
            return False
        self._take(0.5 * self.step)
        return True

    def in_steps(self, h: float) -> "Plant":
        """The same plant in other steps [s]; its own quick one is itself."""
        other = copy.copy(self)
        other._compiled, other.quick, other.step = {}, other, h
        return other

    def compiled(self, structure: Structure) -> Compiled:
        """The model of a structure, made once."""
        if structure not in self._compiled:
            self._compiled[structure] = self._compile(structure)
        return self._compiled[structure]

    def _compile(self, structure: Structure) -> Compiled:
        spec = self._spec.copy()
        for j in structure.play:
            add_play(spec, self.names[j])
        if structure.dead:
            for name in self.names:
                add_dead_band(spec, name)
        for j in structure.integral:
            add_integral(spec, self.names[j])
        across = [len(spec.tendons) + k for k in range(len(self.pairs) * structure.across)]
        for before, j in self.pairs if structure.across else ():
            add_across(spec, self.names[before], self.names[j])
        for body in structure.pulled:
            add_force(spec, body, self.model.body_ipos[self.model.body(body).id], np.zeros(3))
        model = spec.compile()
        if self.step:
            self._set_step(model)
        joints = [model.joint(name).id for name in self.names]
        dead = None
        if structure.dead:
            dead = np.array([model.actuator(f"{name}{DEAD}").id for name in self.names])
        integral = [model.actuator(f"{self.names[j]}{INTEGRAL}").id for j in structure.integral]
        added = {*integral, *(() if dead is None else dead.tolist())}
        on = [[a for a in actuators_on(model, j) if a not in added] for j in joints]
        act = np.array([a[-1] for a in on])
        dof = model.jnt_dofadr[joints]
        if self.holds:
            model.dof_solimp[dof] = HOLD
        play = np.array([model.joint(f"{self.names[j]}{PLAY}").id for j in structure.play], int)
        pull = [[model.actuator(f"{b}{PULL}_{k}").id for k in "xyz"] for b in structure.pulled]
        return Compiled(
            model, model.jnt_qposadr[joints], dof, act, model.actuator_gear[act, 0].copy(), dead, play,
            np.array(pull, int).reshape(-1, 3), np.array(integral, int), np.array(across, int), [],
        )  # fmt: skip

    def tree_of(self, p: Parameter) -> int | None:
        """The tree of joints that a parameter acts on; None for all of them."""
        if p.body:
            body = self.model.body(p.body).id
            while self.model.body_dofnum[body] == 0 and body > 0:
                body = self.model.body_parentid[body]
            dof = self.model.body_dofadr[body]
            same = np.flatnonzero(self.model.dof_treeid[self.dof] == self.model.dof_treeid[dof])
            return int(self.trees[same[0]]) if len(same) else None
        return None if p.joint == ALL else int(self.trees[p.joint])

    def inertia(self, q: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Each joint's own inertia at a posture, rotor included [kg m²]."""
        return np.diagonal(self._inertia(q)).copy()

    def _inertia(self, q: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n n"]:
        return mass_matrix(self.model, q, self.qadr)[np.ix_(self.dof, self.dof)]

    def numbers(
        self, table: Sequence[Parameter], theta: Float[np.ndarray, " P"], loop: Loop | None
    ) -> Numbers:
        """What a vector says of every joint, at the gains of a record."""
        return decoded(self.nominal, table, theta, self.loop if loop is None else loop)

    def structure(self, numbers: Numbers) -> Structure:
        """What a model must have to hold the numbers."""
        play = tuple(np.flatnonzero(numbers.play > 0).tolist())
        integral = tuple(np.flatnonzero(numbers.integral > 0).tolist())
        dead, across = bool(np.any(numbers.dead > 0)), bool(np.any(numbers.has_across))
        return Structure(dead, play, tuple(numbers.forces), integral, across)

    def variants(self, structure: Structure, some: Sequence[Numbers]) -> list[MjModel]:
        """Models with the numbers; valid until the next call for the structure."""
        m = self.compiled(structure)
        while len(m.copies) < len(some):
            m.copies.append(copy.copy(m.model))
        for model, x in zip(m.copies, some, strict=False):
            self._set(m, structure, model, x)
        return m.copies[: len(some)]

    def _set(self, m: Compiled, structure: Structure, model: MjModel, x: Numbers) -> None:
        x = x.at_joint
        implicit = maxwell(x, model.opt.timestep).implicit
        x = x._replace(kd=np.where(x.behind > 0, 0.0, x.kd))
        # Behind play there is nothing but the rotor.
        least = np.where(x.play > 0, _ROTOR, 0.0)
        armature = np.maximum(x.armature, least)
        model.dof_armature[m.dof] = armature
        model.dof_frictionloss[m.dof] = x.dry
        model.dof_damping[m.dof] = x.damping + x.back
        model.dof_dampingpoly[m.dof, 0] = m.model.dof_dampingpoly[m.dof, 0] + x.drag
        wind(m.model, model, m.dof, m.qadr, x)
        model.opt.gravity[:] = turned(m.model.opt.gravity, x.tilt)
        ratio, square = x.kp / self.loop.kp, m.gear**2
        model.actuator_gainprm[m.act, 0] = m.model.actuator_gainprm[m.act, 0] * ratio
        model.actuator_biasprm[m.act, 1] = m.model.actuator_biasprm[m.act, 1] * ratio
        model.actuator_biasprm[m.act, 0] = x.bias / m.gear
        model.actuator_biasprm[m.act, 2] = (x.back - x.kd - implicit) / square
        # A limit that is said stays, of whatever kind; another one replaces an actuator's.
        commanded = np.isfinite(x.limit) & (x.limit != self.loop.limit)
        reach = np.where(commanded, x.limit, 0.0) / np.abs(m.gear)
        said = m.model.actuator_forcelimited[m.act], m.model.actuator_forcerange[m.act]
        model.actuator_forcelimited[m.act] = np.where(commanded, 1, said[0])
        model.actuator_forcerange[m.act] = np.where(
            commanded[:, None], np.stack([-reach, reach], 1), said[1]
        )
        if m.dead is not None:
            model.actuator_gainprm[m.dead, 0] = -x.kp / square
            model.actuator_biasprm[m.dead, 1] = x.kp / square
            reach = x.kp * x.dead / np.abs(m.gear)
            model.actuator_forcerange[m.dead] = np.stack([-reach, reach], 1)
        if len(m.integral):
            own, gear = list(structure.integral), m.gear[list(structure.integral)]
            model.actuator_gainprm[m.integral, 0] = x.integral[own] / gear**2
            held = np.isfinite(x.windup[own])
            reach = np.where(held, x.windup[own], 0.0) * np.abs(gear) / x.integral[own]
            model.actuator_actlimited[m.integral] = held
            model.actuator_actrange[m.integral] = np.stack([-reach, reach], 1)
        if m.dead is not None or len(m.integral):
            # Of several actuators together, the limit is the joint's.
            several, joint = x.shares_limit & np.isfinite(x.limit), model.dof_jntid[m.dof]
            model.actuator_forcelimited[m.act[several]] = 0
            model.jnt_actfrclimited[joint] = np.where(several, 1, m.model.jnt_actfrclimited[joint])
            top = np.where(several, x.limit, 0.0)
            model.jnt_actfrcrange[joint] = np.where(
                several[:, None], np.stack([-top, top], 1), m.model.jnt_actfrcrange[joint]
            )
        if len(m.across):
            wind_across(model, m.across, [j for _, j in self.pairs], x)
        for actuators, force in zip(m.pull, x.forces.values(), strict=True):
            model.actuator_biasprm[actuators, 0] = force
        if len(m.play):
            half = 0.5 * x.play[list(structure.play)]
            model.jnt_range[m.play] = np.stack([-half, half], 1)
        for field in _INERTIAL:
            getattr(model, field)[:] = getattr(m.model, field)
        for body in changed_bodies(x):
            change_body(model, body, x)
        lightened(model, m.dof, x)
        if len(m.play) or not self.holds:
            # Stops and friction that creeps are as soft as 1 / inertia, of rotors that the file may not have at all.
            mujoco.mj_setConst(model, mujoco.MjData(model))
        model.dof_armature[m.dof] = armature - self._lighter(x, armature, model.opt.timestep)

    def _lighter(self, x: Numbers, armature: np.ndarray, h: float) -> Float[np.ndarray, " n"]:
        """D h/2 of the damping that is taken implicitly, less what the model's own steps do; nothing in those.

        No more than a share of the inertia that is there.
        """
        if self._as_the_model:
            return np.zeros_like(armature)
        own = np.where(x.play > 0, armature, self._room + armature - self.nominal.armature)
        here = 0.5 * h * (x.damping + x.kd)
        there = self.own.of_damping * x.damping + self.own.of_kd * x.kd
        return np.minimum(here - there, _TAKEN * np.maximum(own, 0.0))

    @property
    def shift(self) -> float:
        """By how much later controls are given than they act, a step's mean being about its middle [s]."""
        return 0.5 * self.step - self.own.early
