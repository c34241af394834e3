"""Likelihood of logs of targets and positions: torque columns through the closed loop, replays as the judge.

    q_measured − q_replay(θ) = G(θ) E (θ_real − θ) + noise

`ClosedLoop.errors` asks a simulator for the left side; `ClosedLoop.rows` makes G E of it, along the measured motion
(right at any distance) or along the replay's own (free of the encoders' noise).
"""

import dataclasses
from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.features.context import Context
from jax_inertia.likelihood import linearised, motion
from jax_inertia.likelihood.columns import (
    ALL,
    FAMILIES,
    FRICTION_FORMS,
    Number,
    Seen,
    columns,
)
from jax_inertia.likelihood.drive import FAMILIES as OF_DRIVE
from jax_inertia.likelihood.drive import FINITE, DriveNumbers, drive_of
from jax_inertia.likelihood.linearised import Joints, Matrices
from jax_inertia.likelihood.motion import Grid, Moments, Run
from jax_inertia.likelihood.response import Loop, response
from jax_inertia.likelihood.rows import Likelihood, Rows
from jax_inertia.model.robot import Robot

Replay = Callable[[Float[np.ndarray, "B P"], int, Float[np.ndarray, " K1"]], np.ndarray]
"""(numbers, which run, times) → positions of each vector's replay at the times (B, K1, n), as encoders show them."""
_PART = 0.02
"""Of a number that is there, a difference that its law is linear over."""
_PAD = 512
"""Steps come in multiples of this, so that logs of all lengths share few compilations."""
_PAD_COLUMNS = 32


class ClosedLoop(Likelihood):
    """Runs of a robot, its model and a simulator.

    `numbers` are what the model may be off by; `floor` is what encoders leave of each joint's error, rms [rad].
    """

    def __init__(
        self,
        robot: Robot,
        joints: Joints,
        runs: Sequence[Run],
        numbers: Sequence[Number],
        replay: Replay,
        floor: Float[np.ndarray, " n"],
    ):
        self.robot, self.joints, self.runs = robot, joints, tuple(runs)
        super().__init__(numbers, floor, [r.counts for r in runs])
        self._replay = replay
        rows = np.array(joints.dofs)
        self._own = {
            "armature": np.asarray(robot.armature)[rows],
            "viscous_friction": np.asarray(robot.damping)[rows],
            "coulomb_friction": np.asarray(robot.frictionloss)[rows],
        }
        still = Moments(*(np.zeros((1, len(rows))) for _ in range(5)))
        still = still._replace(q=runs[0].q[:1])
        inertia = linearised.matrices(robot, joints, still, 1).mass[0]
        self.inertia = np.diagonal(inertia).copy()
        """Of each joint at the first posture [kg m²]."""
        kp = np.max([r.kp for r in runs], axis=0)
        stiffest = float(np.sqrt(np.max(kp / self.inertia)))
        self.grids = tuple(motion.grid_of(r, stiffest) for r in self.runs)
        self._drives = tuple(drive_of(r, g) for r, g in zip(self.runs, self.grids, strict=True))
        self._measured: list[Moments | None] = [None] * len(self.runs)
        self._paths: dict[bytes, list[np.ndarray]] = {}
        self._known: dict[int, tuple[Matrices, Context]] = {}
        self._about: list[_About] = []

    def errors(self, thetas: Float[np.ndarray, "B P"]) -> list[Float[np.ndarray, "B T n"]]:
        """Measured minus replayed positions of every vector, run by run [rad]."""
        out = []
        for k, (run, grid) in enumerate(zip(self.runs, self.grids, strict=True)):
            paths = self._replay(thetas, k, grid.edges)
            for theta, path in zip(thetas, paths, strict=True):
                self._paths.setdefault(theta.tobytes(), [np.empty(0)] * len(self.runs))[k] = path
            out.append(run.q - paths[:, :: grid.every])
        return out

    def rows(
        self,
        theta: Float[np.ndarray, " P"],
        errors: Sequence[Float[np.ndarray, "T n"]],
        *,
        along_replay: bool = False,
        asked: Collection[int] | None = None,
    ) -> Rows:
        """The errors' linear model about θ; `along_replay`: along the replay of θ.

        Numbers that no law is of have columns by replays with them and without.
        """
        out, self._about = [], []
        asked = range(len(theta)) if asked is None else asked
        lawful = [i for i in asked if self.numbers[i].family in FAMILIES]
        others = [i for i in asked if self.numbers[i].family not in FAMILIES]
        mine = theta.tobytes()
        self._paths = {key: x for key, x in self._paths.items() if key == mine}
        if along_replay and not self._paths:
            self.errors(theta[None])
        for k, (run, grid) in enumerate(zip(self.runs, self.grids, strict=True)):
            if along_replay:
                moments = motion.replayed(self._paths[mine][k], grid)
            else:
                moments = self._measured[k] or motion.measured(run, grid)
                self._measured[k] = moments
            about = self._seen(theta, k, moments, lawful)
            self._about.append(about)
            torque = np.asarray(columns([self.numbers[i] for i in lawful], about.seen))
            moved = np.zeros((len(run.time), torque.shape[1], len(theta)))
            moved[:, :, lawful] = _padded_response(about.loop, torque, grid)
            for i in others:
                moved[:, :, i] = self._compared(theta, k, i)
            out.append(moved)
        return Rows.of(theta, errors, out, self.counts)

    def _compared(self, theta: np.ndarray, k: int, i: int) -> Float[np.ndarray, "T n"]:
        """What one of a number does to positions, by replays with it and without, where no law says it."""
        every, edges = self.grids[k].every, self.grids[k].edges
        there, none = theta.copy(), theta.copy()
        there[[j for j, n in enumerate(self.numbers) if n.place == self.numbers[i].place]] = 0.0
        there[i], none[i] = theta[i] or self.numbers[i].compared, 0.0
        paths = self._replay(np.array([there, none]), k, edges)
        return (paths[0] - paths[1])[::every] / there[i]

    def delayed(self, delays: Sequence[float]) -> list[list[Float[np.ndarray, "T n"]]]:
        """What targets later by each of some delays do to positions, about the last `rows`; for each, run by run."""
        out = []
        for about, drive, grid in zip(self._about, self._drives, self.grids, strict=True):
            x, parts = about.numbers, []
            for d in delays:
                later = drive.changed(
                    x, about.motion, "target_delay", x.target_delay + d, x.target_delay
                )
                parts.append(later)
            out.append(_padded_response(about.loop, np.stack(parts, axis=-1), grid))
        return [[m[:, :, i] for m in out] for i in range(len(delays))]

    def of(self, theta: Float[np.ndarray, " P"], family: str) -> Float[np.ndarray, " n"]:
        """A family's numbers at each joint; those of all joints count at each."""
        out = np.zeros(len(self.joints.dofs))
        for number, value in zip(self.numbers, theta, strict=True):
            if number.family == family:
                out[slice(None) if number.joint == ALL else number.joint] += value
        return out

    def _rigid(self, k: int, moments: Moments) -> tuple[Matrices, Context]:
        """What the model's bodies make of a motion; that of the measured one is computed once."""
        if moments is self._measured[k] and k in self._known:
            return self._known[k]
        grid = self.grids[k]
        every = max(int(linearised.REFRESHED / grid.step), 1)
        own = linearised.matrices(self.robot, self.joints, moments, every)
        out = own, linearised.context(self.robot, self.joints, grid.middles, moments)
        if moments is self._measured[k]:
            self._known[k] = out
        return out

    def _seen(self, theta: np.ndarray, k: int, moments: Moments, asked: Sequence[int]) -> "_About":
        run, drive = self.runs[k], self._drives[k]
        own, context = self._rigid(k, moments)
        parts = {name: self.of(theta, name) for name in (*OF_DRIVE, *FINITE)}
        x = DriveNumbers(**{name: _in_law(name, y, run) for name, y in parts.items()})
        torque = np.asarray(drive.torque(x, moments))
        context.tau = np.asarray(self.joints.rates(torque))
        rows, more = np.array(self.joints.dofs), {f: self.of(theta, f) for f in self._own}
        needed = context.inverse[:, rows] + more["armature"] * moments.a
        needed = needed + more["viscous_friction"] * moments.v
        level = self._own["coulomb_friction"] + more["coulomb_friction"]
        level = level + self._forms(theta, moments, torque)
        resting = motion.balanced(moments, torque - needed, level)
        context.side = np.asarray(self.joints.rates(resting.side))
        gain = (1.0 + parts["torque_gain"]) * drive.within(x, moments)
        kp, kd = (
            gain * y * (1.0 + parts[s]) for y, s in ((run.kp, "kp_scale"), (run.kd, "kd_scale"))
        )
        hold, diagonal = parts["loop_hold"], np.eye(len(rows))
        late = hold + run.of_steps * parts["own_steps"]
        loop = Loop(
            own.mass + diagonal * (more["armature"] - late * kd)[:, None],
            own.damping + diagonal * (more["viscous_friction"] + kd - hold * kp)[:, None],
            own.stiffness + diagonal * kp[:, None],
            resting.still,
        )
        finite = self._finite(theta, k, x, moments, asked)
        seen = Seen(context, drive.differences(x, moments), own.stiffness, self.joints.dofs, finite)
        return _About(seen, loop, x, moments, torque)

    def _forms(
        self, theta: np.ndarray, moments: Moments, torque: Float[np.ndarray, "K n"]
    ) -> Float[np.ndarray, "K n"]:
        """What dry friction has beyond its level [N m]."""
        out = np.zeros_like(torque)
        for n, x in zip(self.numbers, theta, strict=True):
            if x != 0.0 and n.family in FRICTION_FORMS:
                form = FRICTION_FORMS[n.family](moments.q, moments.v, torque, n.shape or 0.0)
                out += x * form * ((np.arange(out.shape[1]) == n.joint) | (n.joint == ALL))
        return out

    def _finite(
        self, theta: np.ndarray, k: int, x: DriveNumbers, moments: Moments, asked: Sequence[int]
    ) -> dict[Number, np.ndarray]:
        """Torque of one of each number of the drive that has a shape: a derivative, or by its shape while it is 0."""
        run, drive, out = self.runs[k], self._drives[k], {}
        there: dict[tuple[str, tuple[str, int, str]], float] = {}
        for n, value in zip(self.numbers, theta, strict=True):
            there[n.family, n.place] = there.get((n.family, n.place), 0.0) + float(value)
        for turn in _turns([(i, self.numbers[i]) for i in asked]):
            family, everywhere = turn[0][1].family, turn[0][1].joint == ALL
            # Own numbers of joints come on top of those of all, and these on top of them.
            none, size = np.zeros(len(run.kp)), np.zeros(len(run.kp))
            for n, value in zip(self.numbers, theta, strict=True):
                if n.family == family and (n.joint == ALL) != everywhere:
                    none[slice(None) if n.joint == ALL else n.joint] += value
            for _, n in turn:
                mine = slice(None) if everywhere else n.joint
                # By a part of what is there, of it or of what it stands in for, or from none to the size that is tried.
                now = there.get((n.family, n.place), 0.0)
                none[mine] += now
                size[mine] = _PART * now or n.compared
            law = drive.changed(
                self._beside(theta, x, turn, run),
                moments,
                family,
                _in_law(family, none + size, run),
                _in_law(family, none, run),
            )
            for _, n in turn:
                mine = everywhere | (np.arange(len(size)) == n.joint)
                out[n] = np.asarray(law) * mine / np.where(size == 0.0, 1.0, size)
        return out

    def _beside(
        self, theta: np.ndarray, x: DriveNumbers, turn: Sequence[tuple[int, Number]], run: Run
    ) -> DriveNumbers:
        """With a limit where there is none and a number is asked about that changes a limit with speed."""
        if turn[0][1].family != "torque_speed":
            return x
        limit = self.of(theta, "torque_saturation")
        for _, n in turn:
            if limit[n.joint] == 0.0:
                limit[n.joint] = n.beside
        return dataclasses.replace(x, torque_saturation=_in_law("torque_saturation", limit, run))


def _turns(numbers: Sequence[tuple[int, Number]]) -> list[list[tuple[int, Number]]]:
    """Numbers of the drive with a size to be compared with none, which joints take together, one of each at a time."""
    out: dict[tuple[str, bool, int], list[tuple[int, Number]]] = {}
    count: dict[tuple[str, int], int] = {}
    for i, n in numbers:
        if n.shape is not None and n.family in (*OF_DRIVE, *FINITE):
            turn = count[n.family, n.joint] = count.get((n.family, n.joint), -1) + 1
            out.setdefault((n.family, n.joint == ALL, turn), []).append((i, n))
    return list(out.values())


def _in_law(family: str, value: Float[np.ndarray, " n"], run: Run) -> np.ndarray:
    """A drive's number in its law; that of a limit L is 1/L more than the model states, so that 0 is none."""
    return (
        1.0 / np.maximum(value + 1.0 / run.limit, 1e-12) if family == "torque_saturation" else value
    )


class _About(NamedTuple):
    """All that is known of a run at some numbers."""

    seen: Seen
    loop: Loop
    numbers: DriveNumbers
    motion: Moments
    torque: Float[np.ndarray, "K n"]


def _padded_response(loop: Loop, torque: Float[np.ndarray, "K n P"], grid: Grid) -> np.ndarray:
    """`response` with a zero first row, computed for a few sizes only."""
    steps, _, count = torque.shape
    block = grid.every * _PAD
    more = -steps % block
    wide = np.pad(torque, ((0, more), (0, 0), (0, -count % _PAD_COLUMNS)))
    longer = jax.tree.map(
        lambda x: np.pad(np.asarray(x), ((0, more), *((0, 0),) * (x.ndim - 1)), "edge"), loop
    )
    out = response(longer, wide, grid.step, grid.every)
    out = np.asarray(out)[: steps // grid.every, :, :count]
    return np.concatenate([np.zeros((1, *out.shape[1:])), out])
