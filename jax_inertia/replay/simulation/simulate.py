"""What targets give, many variants of a model at once: positions by closed-loop replays, and torques by the loop.

Positions are those of the targets through MuJoCo's own dynamics. Torque, where it is logged, is what the loop gives at
the positions that were measured: over a window of ± `WINDOW` about every sample,

    e_τ = mean(kp dz(q*(t − d) − q) + kd (q̇* − q̇) + τ_ff + b, cut off at the limit) − mean(τ)

At measured positions, not at replayed ones: p(q, τ | q*, θ) is the product over samples of p(τ_t | q up to t, θ) and
p(q_t | τ before t, θ). What friction or masses do to q beyond the model is in the replay's error once, and not in the
torque's again; and torque tells the loop's own numbers whatever the robot does. The mean of q̇ over a window is the
difference of q over it, as old as the replay's is, and an edge of a target that is known to a part of a sample moves a
mean by little.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float
from mujoco import rollout

from jax_inertia.replay.joint_numbers import Numbers
from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.record import Record, controls, low_passed, step_means
from jax_inertia.replay.simulation.plant import Compiled, Plant
from jax_inertia.replay.simulation.stepped import PARTS, cores, limited_at, stepped_at, stepwise

_ROLLS, _STEPPED = 16, 64
LOST = 10.0
"""Where a simulation diverges, its error is taken to be this [rad]."""
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
WINDOW = 0.01
"""Half of what torques are averaged over [s]: targets of a policy change every 20 ms."""
_FINE = 1e-3
"""Steps in which targets are delayed and lag [s]."""
_SLOPE = 4e-3
"""Half of what a velocity that decides on a limit is taken over [s]."""
_LAW = (
    "kp", "kd", "bias", "limit", "back", "dead", "delay", "lag", "lead", "low_pass", "integral", "windup",
)  # fmt: skip


def replay(
    plant: Plant,
    table: Sequence[Parameter],
    thetas: Float[np.ndarray, "B P"],
    record: Record,
) -> Float[np.ndarray, "B T n"]:
    """Positions as the encoders would log them, of every vector."""
    every = [plant.numbers(table, theta, record.loop) for theta in thetas]
    kinds = [(plant.structure(x), bool(np.any(stepped_at(plant, x)))) for x in every]
    out = np.empty((len(thetas), *record.q.shape))
    for kind in dict.fromkeys(kinds):
        mine = [b for b, k in enumerate(kinds) if k == kind]
        most = _STEPPED if kind[1] else _ROLLS
        for first in range(0, len(mine), most):
            rows = mine[first : first + most]
            some = _Some(plant, kind, [every[b] for b in rows], record)
            if kind[0].integral:
                some.wind()
            out[rows] = some.moved(record)
    return out


class _Some:
    """Variants of one structure, and what each is commanded along a record."""

    def __init__(self, plant: Plant, kind, some: Sequence[Numbers], record: Record):
        self.plant, self.some, self.record = plant, some, record
        self.structure, self.varies = kind
        self.m = m = plant.compiled(self.structure)
        self.limited = np.array([limited_at(plant, x) for x in some])
        self.joints = np.flatnonzero(np.any([stepped_at(plant, x) for x in some], axis=0))
        self.models = plant.variants(self.structure, some)
        steps = self._steps(record)
        self.state = np.zeros((len(some), mujoco.mj_stateSize(m.model, _STATE)))
        self.control = np.zeros((len(some), steps, m.model.nu))
        data, own, parted = mujoco.MjData(m.model), list(self.structure.integral), []
        fed = record.commanded.velocity is not None or record.commanded.torque is not None
        bare = record._replace(commanded=record.commanded.of_positions)
        cache: dict[bytes, np.ndarray] = {}
        for b, x in enumerate(some):
            times = x.delay, x.lag, x.low_pass
            key = np.concatenate([*times, x.kp, x.kd] if fed else times).tobytes()
            if key not in cache:
                cache = dict(list(cache.items())[-2:])
                cache[key] = self._commanded(record, x, steps)
            each = cache[key] - x.offset
            parted.append(each[:, :, self.joints])
            whole, control = each.mean(axis=1), self.control[b]
            control[:, m.act] = whole * m.gear
            if m.dead is not None:
                control[:, m.dead] = control[:, m.act]
            if fed and own:
                whole = self._commanded(bare, x, steps).mean(axis=1) - x.offset
            control[:, m.integral] = (whole * m.gear)[:, own]
            mujoco.mj_resetData(self.models[b], data)
            data.qpos[m.qadr], data.qvel[m.dof] = record.q[0] - x.offset, record.start
            mujoco.mj_getState(self.models[b], data, self.state[b], _STATE)
        self.parted, self.offset = np.array(parted), np.stack([x.offset for x in some])[:, None]

    def _steps(self, record: Record) -> int:
        return int(np.ceil(record.time[-1] / self.plant.step)) + 1

    def _commanded(self, record: Record, x: Numbers, steps: int) -> Float[np.ndarray, "K p n"]:
        # What acts on a step from h/2 before its position to h/2 after it, as early as in the model's own steps.
        own, parts = self.plant.own, PARTS if self.limited.any() else 1
        whole = own.step if own.early else 0.0
        h = self.plant.step / parts
        of_parts = controls(record, h, steps * parts, x, self.plant.shift, whole)
        return of_parts.reshape(steps, parts, -1)

    def moved(self, record: Record) -> Float[np.ndarray, "B T n"]:
        """Positions at the stamps of the record, or of its head."""
        m, h, count = self.m, self.plant.step, self._steps(record)
        control = np.ascontiguousarray(self.control[:, :count])
        if self.varies:
            limited, lacking = self.limited[:, self.joints], 0.5 * h - self.plant.own.of_kd
            parted = self.parted[:, :count]
            path = stepwise(
                m, self.joints, limited, self.models, self.some, self.state, control, parted, h, lacking
            )  # fmt: skip
        else:
            path = _at_once(m, self.models, self.state, control)
        q = np.concatenate([self.state[:, None, 1 + m.qadr], path[:, :, 1 + m.qadr]], axis=1)
        # A MuJoCo that has diverged starts anew from its reference posture: the clock shows it.
        lost = np.diff(path[:, :, 0], axis=1) <= 0
        now = between_steps(q, record.time / h) + self.offset
        now[lost.any(axis=1)] = record.q + LOST
        return np.nan_to_num(now, nan=LOST)

    def wind(self) -> None:
        """Find what the integrals of drives had reached at the record's start."""
        record, own, model = self.record, list(self.structure.integral), self.m.model
        late, head = record.head, record.upto(record.head.stop)
        felt = [x.at_joint for x in self.some]
        kp, gain, windup = (
            np.stack([getattr(x, k)[own] for x in felt]) for k in ("kp", "integral", "windup")
        )
        act = 1 + model.nq + model.nv + model.actuator_actadr[self.m.integral]
        torque = np.zeros_like(kp)
        for _ in range(WINDINGS):
            error = (head.q - self.moved(head))[:, late][..., own]
            torque = wound(error, torque, kp, windup)
            self.state[:, act] = torque / gain
            # What a replay in steps has changed.
            self.models = self.plant.variants(self.structure, self.some)


WINDINGS = 4
"""Rounds in which a drive's integral at a record's start is found; each leaves a fifth of the error before."""


def wound(
    error: Float[np.ndarray, "*b T i"],
    torque: Float[np.ndarray, "*b i"],
    kp: Float[np.ndarray, "*b i"],
    windup: Float[np.ndarray, "*b i"],
) -> Float[np.ndarray, "*b i"]:
    """A better value of the torque of drives' integrals at a record's start, which no log has [N m].

    A loop that is off by δ at the end of the record's head lacks kp δ: z ← clip(z + kp mean(q − q_replay), ± windup).

    `error`: q − q_replay of a replay that began with `torque`, there (`Record.head`).
    """
    return np.clip(torque + kp * np.mean(error, axis=-2), -windup, windup)


def between_steps(
    q: Float[np.ndarray, "*b K n"], where: Float[np.ndarray, " T"]
) -> Float[np.ndarray, "*b T n"]:
    """Positions at stamps `where` in steps, along straight lines."""
    k = np.minimum(where.astype(int), q.shape[-2] - 2)
    first, last = q[..., k, :], q[..., k + 1, :]
    return first + (where - k)[:, None] * (last - first)


def _at_once(m: Compiled, models, state, control) -> np.ndarray:
    data = [mujoco.MjData(m.model) for _ in range(min(cores(), len(models)))]
    path, _ = rollout.rollout(models, data, state, control, persistent_pool=True)
    return path


def misses(
    plant: Plant,
    table: Sequence[Parameter],
    thetas: Float[np.ndarray, "B P"],
    record: Record,
    joints: Sequence[int] | None = None,
) -> Float[np.ndarray, "B T j"]:
    """Torque that the loop gives minus the one that was logged [N m], means over windows, of every vector.

    Of all joints, or of some.
    """
    every = [plant.numbers(table, theta, record.loop) for theta in thetas]
    windows = Windows(record.time)
    joints = range(record.q.shape[1]) if joints is None else joints
    out = np.empty((len(thetas), len(record.time), len(joints)))
    for k, j in enumerate(joints):
        # Most numbers of a vector are not the loop's, and most that are, another joint's.
        done: dict[tuple[float, ...], np.ndarray] = {}
        for b, x in enumerate(every):
            # A logged velocity is as old as it is.
            own_age = float(x.steps[j] * x.step_of_kd[j]) - plant.own.of_kd
            age = own_age if record.velocity is None else 0.0
            own = age, *(float(getattr(x, name)[j]) for name in _LAW)
            if own not in done:
                done[own] = _miss(record, windows, x, j, age)
            out[b, :, k] = done[own]
    return out


class Windows:
    """Means over windows about the stamps of a log."""

    def __init__(self, time: Float[np.ndarray, " T"]):
        self.time, self.period = time, float(np.median(np.diff(time)))
        self._ends = self.ends(WINDOW)
        self._length = np.diff(time[self._ends], axis=0)[0]

    def ends(self, half: float) -> np.ndarray:
        """First and last row of windows of ± `half` (2, T)."""
        wide = max(round(half / self.period), 1)
        rows = np.arange(len(self.time))
        return np.stack([np.maximum(rows - wide, 0), np.minimum(rows + wide, len(rows) - 1)])

    def mean(self, x: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
        """By trapezia."""
        parts = 0.5 * (x[1:] + x[:-1]) * np.diff(self.time)
        return np.diff(np.append(0.0, np.cumsum(parts))[self._ends], axis=0)[0] / self._length

    def slope(self, x: Float[np.ndarray, " T"], half: float = WINDOW) -> Float[np.ndarray, " T"]:
        """The mean of the derivative."""
        first, last = self.ends(half)
        return (x[last] - x[first]) / (self.time[last] - self.time[first])


def _miss(
    record: Record, windows: Windows, x: Numbers, j: int, age: float
) -> Float[np.ndarray, " T"]:
    """`age`: by how much a loop's velocity is older than its position, where the log has no velocity [s]."""
    q, targets = record.q[:, j], record.commanded
    kp, kd, back = x.kp[j], x.kd[j], x.back[j]
    aim = _held(record, targets.position[:, j], x, j)
    miss = aim - q
    miss = miss - np.clip(miss, -x.dead[j], x.dead[j])
    asked = kp * miss + x.bias[j]
    fed = x._replace(low_pass=np.zeros_like(x.low_pass))
    if targets.velocity is not None:
        asked = asked + kd * _held(record, targets.velocity[:, j], fed, j)
    if targets.torque is not None:
        asked = asked + _held(record, targets.torque[:, j], fed, j)
    if record.velocity is None:
        slopes = windows.slope(q, _SLOPE), windows.slope(q)
        v, mean_v = (np.interp(record.time - age, record.time, y) for y in slopes)
    else:
        v, mean_v = record.velocity[:, j], windows.mean(record.velocity[:, j])
    if x.integral[j] > 0:
        head = slice(0, record.head.stop)
        lacking = (record.tau[:, j] - asked + kd * v)[head]
        asked = asked + _integrated(x.integral[j] * record.period * (aim - q), lacking, x.windup[j])
    short = 0.0
    if np.isfinite(x.limit[j]):
        whole = asked - (kd - back) * v
        short = np.clip(whole, -x.limit[j], x.limit[j]) - whole
    return windows.mean(asked + short - record.tau[:, j]) - kd * mean_v


def _integrated(
    added: Float[np.ndarray, " T"], lacking: Float[np.ndarray, " h"], windup: float
) -> Float[np.ndarray, " T"]:
    """Torque of a drive's integral, to which each sample adds; it begins with what the record's head is `lacking`."""
    first = np.mean(lacking - np.append(0.0, np.cumsum(added)[: len(lacking) - 1]))
    z, out = float(np.clip(first, -windup, windup)), []
    for more in added.tolist():
        out.append(z)
        z = min(max(z + more, -windup), windup)
    return np.array(out)


def _held(record: Record, what: Float[np.ndarray, " S"], x: Numbers, j: int) -> np.ndarray:
    """What is commanded as the loop has it: its mean from each stamp to the next, as late as it comes."""
    period = record.period
    h = min(period, _FINE)
    steps = int(np.ceil((record.time[-1] + period) / h)) + 1
    delay, lag, smooth = (y[j : j + 1] for y in (x.delay - x.lead, x.lag, x.low_pass))
    time = record.commanded.time
    targets = low_passed(time, what[:, None], float(x.low_pass_period[0]), smooth)
    fine = step_means(time, targets, h, steps, delay, lag)[:, 0]
    area, edges = np.append(0.0, np.cumsum(fine)) * h, np.arange(steps + 1) * h
    ends = (np.interp(record.time + late, edges, area) for late in (period, 0.0))
    return (next(ends) - next(ends)) / period
