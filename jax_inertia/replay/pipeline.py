"""From a log of targets and encoders to what the model lacks, proved by replays."""

from collections.abc import Callable, Sequence

import mujoco
import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.result import Verdict
from jax_inertia.logs.log import Log, LogError
from jax_inertia.model.mujoco_types import MjModel, MjSpec
from jax_inertia.replay import checks, odd
from jax_inertia.replay import fit as fitting
from jax_inertia.replay.fit import Fit
from jax_inertia.replay.loop import (
    LOGARITHMIC,
    ORDINARY,
    UNITS,
    Loop,
    Parameter,
    ordinary,
    position_loop,
)
from jax_inertia.replay.result import Diagnosis, Effect, Replayed, Size, total
from jax_inertia.replay.simulate import Plant, Record, record_of

FIT_SHARE = 0.7
"""Of a log without another one to test on, what is fitted; the rest is replayed."""
LONGEST = 40.0
"""Of each log, what is fitted at most [s]."""
_AT_FLOOR = 2.0
_NEARLY, _SOME = 0.35, 0.8
_IDLE, _LISTED = 0.005, 0.01
_SPARSER = 1.01
_CREEPS = 1.1


def diagnose(
    logs: Sequence[Log],
    spec: Callable[[], MjSpec],
    *,
    test_log: Log | None = None,
    kp: Sequence[float] | None = None,
    kd: Sequence[float] | None = None,
    exclude: Sequence[str] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> Diagnosis:
    """Find what the model lacks, from targets and positions alone; `spec` gives the nominal model anew at each call.

    The fit sees `logs` (without a test log, the first 70 % of the only one); verdict, shares and gate are of replays of
    the rest. Raises `LogError` where joints or gains are missing.
    """
    names = logs[0].joint_names
    records, held, of = _parts(logs, test_log)
    loop = position_loop(logs[0], spec().compile(), kp, kd)
    check_base(spec().compile())
    bare, plant = Plant(spec(), names, loop), Plant(spec(), names, loop, holds=True)
    torque = typical_torque(plant, records)
    table = tuple(p for p in _ordinary(plant, records, torque) if p.family not in exclude)
    theta0 = np.array([p.nominal for p in table])
    floor = checks.floor(held)
    # What the clocks leave is no noise of a sample: the fit may take it up in its delay.
    least = float(np.sqrt(np.mean(checks.encoder_noise(held.q) ** 2)))
    progress("replaying the nominal model")
    nominal = bare.replay((), np.zeros((1, 0)), held)[0]
    replayed = Replayed(held, nominal, nominal, floor, of)
    before = replayed.before
    progress("looking for kp and delay")
    start = fitting.start(plant, table, records, loop.source == "model")
    everything = fitting.fit(plant, table, records, start, floor=least, progress=progress)
    if np.all(before <= _AT_FLOOR * floor):
        found, kept = everything._replace(theta=theta0), []
        after_path, worse, creeping = nominal, (), before
    else:
        held_back = _causal(plant, everything, records, least, progress)
        found = _sparse(plant, held_back, records, held, loop, least, progress)
        if "odd" not in exclude:
            found = odd.add_odd(plant, found, records, [held], torque, least, progress)
        progress("taking each effect back")
        found, shares = _gated(plant, found, held, before)
        kept = [(k, s) for k, s in shares.items() if s > _LISTED and _distinct(found, k, loop)]
        after_path = plant.replay(found.table, found.theta[None], held)[0]
        after = replayed.error(after_path)
        creeping = replayed.error(bare.replay(found.table, found.theta[None], held)[0])
        worse = tuple(
            n for n, a, b, f in zip(names, after, before, floor, strict=True)
            if a > max(1.05 * b, 1.5 * f)
        )  # fmt: skip
    replayed = Replayed(held, nominal, after_path, floor, of)
    effects = tuple(_effect(found, k, s, loop, names) for k, s in sorted(kept, key=lambda x: -x[1]))
    verdict, confidence = _verdict(replayed, effects)
    notes = [*checks.objections(records[0], names), *_notes(everything, loop)]
    if total(creeping) > _CREEPS * total(replayed.after):
        notes.append(
            "friction that holds a joint at rest (solimpfriction in corrected.xml) matters: with MuJoCo's own, which "
            f"creeps, the same numbers err by {total(creeping):.2g} rad"
        )
    return Diagnosis(
        verdict, confidence, _headline(verdict, replayed), names, loop, effects, everything, found, replayed, worse,
        tuple(notes),
    )  # fmt: skip


def _ordinary(
    plant: Plant, records: Sequence[Record], torque: Float[np.ndarray, " n"]
) -> tuple[Parameter, ...]:
    """The ordinary numbers about those of the plant's model."""
    m, dofs = plant.model, plant.dof
    inertia = np.mean([plant.inertia(r.q[k]) for r in records for k in (0, len(r.q) // 2)], axis=0)
    own = m.dof_armature[dofs], m.dof_damping[dofs], m.dof_frictionloss[dofs]
    return ordinary(plant.loop, *own, inertia, torque, records[0].period)


def _parts(logs: Sequence[Log], test_log: Log | None) -> tuple[list[Record], Record, str]:
    """What is fitted, what is replayed, and what the latter is called."""
    records = [record_of(log) for log in logs]
    for r in records:
        if np.ptp(r.target, axis=0).max() < 1e-3:
            raise LogError("qpos_target never changes: it cannot show how the robot follows")
    if test_log is not None:
        held, of = record_of(test_log), "the other run"
    else:
        whole = records[-1]
        cut = int(FIT_SHARE * len(whole.time))
        records[-1], held, of = (
            whole.between(0, cut),
            whole.between(cut, len(whole.time)),
            "the rest of the log",
        )
    records = [r.between(0, int(np.searchsorted(r.time, LONGEST, side="right"))) for r in records]
    return records, held, of


FLOATS = (
    "the model's base floats, and a replay needs to know what carries it; log a robot that hangs "
    "with its base fixed, and give --fix-base"
)


def check_base(model: MjModel) -> None:
    """Raise `LogError` for a base that floats."""
    free = model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)
    if free.any():
        raise LogError(FLOATS)


def typical_torque(plant: Plant, records: Sequence[Record]) -> Float[np.ndarray, " n"]:
    """What gravity and inertia ask of each joint along the logs, rms [N m]."""
    data, parts = mujoco.MjData(plant.model), []
    for r in records:
        wide = max(int(0.05 / r.period), 1)
        rows = np.arange(2 * wide, len(r.q) - 2 * wide, max(len(r.q) // 200, 1))
        # Curvature over ten hundredths of a second: of the encoders' counts nothing is left.
        bend = (r.q[rows + 2 * wide] - 2 * r.q[rows] + r.q[rows - 2 * wide]) / (
            2 * wide * r.period
        ) ** 2
        for k, a in zip(rows, bend, strict=True):
            mujoco.mj_resetData(plant.model, data)
            data.qpos[plant.qadr] = r.q[k]
            mujoco.mj_forward(plant.model, data)
            weight = data.qfrc_bias[plant.dof].copy()
            parts.append(np.abs(weight) + plant_inertia(plant, data) * np.abs(a))
    return np.maximum(np.sqrt(np.mean(np.square(parts), axis=0)), 1e-3)


def plant_inertia(plant: Plant, data) -> np.ndarray:
    """Each joint's own inertia where the data are."""
    return plant.inertia(data.qpos[plant.qadr])


def _causal(plant, everything: Fit, records, least, progress) -> Fit:
    """The fit without a negative delay of all targets, which no model can have: found again with none."""
    early = np.array([p.family == "target_delay" for p in everything.table]) & (
        everything.theta < 0
    )
    if not early.any():
        return everything
    start = np.where(early, 0.0, everything.theta)
    return fitting.fit(
        plant,
        everything.table,
        records,
        start,
        free=~early,
        floor=least,
        rounds=6,
        progress=progress,
    )


def _sparse(plant, everything: Fit, records, held, loop, least, progress) -> Fit:
    """The numbers that are needed, refitted alone; all of them where the held-out replay is better for it."""
    keep = checks.needed(everything, checks.loose(everything.table, loop))
    free = np.zeros(len(everything.table), bool)
    free[keep] = True
    nominal = np.array([p.nominal for p in everything.table])
    start = np.where(free, everything.theta, nominal)
    few = fitting.fit(
        plant, everything.table, records, start, free=free, floor=least, rounds=5, progress=progress
    )
    both = np.stack([everything.theta, few.theta])
    square = np.mean(fitting.errors(plant, everything.table, both, [held]) ** 2, axis=(1, 2))
    return few if square[1] <= _SPARSER**2 * square[0] else everything


def _gated(plant, found: Fit, held: Record, before) -> tuple[Fit, dict[int, float]]:
    """Without the numbers that make the held-out replay worse, and what share of its error each of the others takes."""
    nominal = np.array([p.nominal for p in found.table])
    energy = float(np.mean(before**2))
    theta, away, shares = found.theta.copy(), np.zeros(0, int), np.zeros(0)
    for _ in range(3):
        away = np.flatnonzero(theta != nominal)
        thetas = np.repeat(theta[None], len(away) + 1, axis=0)
        thetas[np.arange(len(away)) + 1, away] = nominal[away]
        square = np.mean(fitting.errors(plant, found.table, thetas, [held]) ** 2, axis=(1, 2))
        shares = (square[1:] - square[0]) / energy
        harm = [k for k, s in zip(away, shares, strict=True) if s < -_IDLE]
        if not harm:
            break
        theta[away[int(np.argmin(shares))]] = nominal[away[int(np.argmin(shares))]]
    return found._replace(theta=theta), dict(zip(away.tolist(), shares.tolist(), strict=True))


def _distinct(found: Fit, k: int, loop: Loop) -> bool:
    """Whether a number's interval leaves the nominal one out."""
    p, sd = found.table[k], np.hypot(found.sigma[k], checks.loose(found.table, loop)[k])
    return bool(abs(found.theta[k] - p.nominal) > 1.96 * sd)


CHANGES = ("armature", "viscous_friction", "coulomb_friction")
"""Families whose effect is what is added to the model's own number."""


def whole(p: Parameter, x: float, loop: Loop) -> float:
    """A number of the vector as people have it."""
    if p.family in LOGARITHMIC:
        return float(np.exp(x))
    if p.family == "viscous_friction":
        return float(x - loop.kd[p.joint])
    return float(x)


PARAMETERS = {
    "armature": "armature", "viscous_friction": "damping", "coulomb_friction": "coulomb", "encoder_offset": "offset",
    "kp_scale": "scale", "target_delay": "delay", "target_lag": "lag", "torque_bias": "bias",
    "torque_saturation": "limit", "payload": "mass",
}  # fmt: skip
"""What the one parameter of each family is called."""


def size_of(found: Fit, k: int, loop: Loop) -> Size:
    """A number and its interval; what only the loop's own clock could tell widens it."""
    p = found.table[k]
    sd = float(np.hypot(found.sigma[k], checks.loose(found.table, loop)[k]))
    ends = [whole(p, float(found.theta[k] + s * sd), loop) for s in (0.0, -1.96, 1.96)]
    return Size(ends[0], ends[1], ends[2], UNITS[p.family])


def _effect(found: Fit, k: int, share: float, loop: Loop, names) -> Effect:
    p = found.table[k]
    size, nominal, share = size_of(found, k, loop), whole(p, p.nominal, loop), min(share, 1.0)
    if p.family in CHANGES:
        size = Size(size.value - nominal, size.low - nominal, size.high - nominal, size.unit)
    kind, name = (
        ("body", p.body)
        if p.body
        else ("joint", names[p.joint])
        if p.joint >= 0
        else ("global", "global")
    )
    is_ordinary = p.family in ORDINARY and not (p.family == "target_delay" and p.joint >= 0)
    return Effect(
        p.family, kind, name, PARAMETERS[p.family], size, nominal, share,
        is_ordinary, _ties(found, k, loop, names),
    )  # fmt: skip


_ALWAYS_TIED = {
    "kp_scale": "torque gain (kp, strength of the motor and voltage are one product: only torque tells them apart)",
    "viscous_friction": "kd (their sum is what a replay knows)",
    "encoder_offset": "torque bias (kp · offset is one)",
    "torque_bias": "encoder offset (offset = bias / kp)",
}
_TIED = 0.9


def _ties(found: Fit, k: int, loop: Loop, names) -> tuple[tuple[str, str], ...]:
    """What else would do as well: by the equation always, and on this motion by the fit's correlations."""
    p = found.table[k]
    out = [(_ALWAYS_TIED[p.family], "exact")] if p.family in _ALWAYS_TIED else []
    sigma = found.sigma
    for i, other in enumerate(found.table):
        if i == k or not sigma[i] > 0 or not sigma[k] > 0:
            continue
        if abs(found.covariance[i, k]) > _TIED * sigma[i] * sigma[k]:
            where = f" of {names[other.joint]}" if other.joint >= 0 else ""
            slope = found.covariance[i, k] / sigma[k] ** 2
            name = other.family.replace("_", " ")
            out.append((f"{name}{where}: one more here is {slope:.3g} there", "motion_limited"))
    if p.family in _DELAY_TIES:
        damps = (
            f"1 ms of delay damps like kp · 1 ms = {1e-3 * loop.kp[max(p.joint, 0)]:.3g} N m s/rad"
        )
        out.append((f"{_DELAY_TIES[p.family]}, in part: {damps}", "motion_limited"))
    return tuple(out)


_DELAY_TIES = {"target_delay": "viscous friction", "viscous_friction": "target delay"}


def _verdict(replayed: Replayed, effects) -> tuple[Verdict, float]:
    before, after, floor = (total(x) for x in (replayed.before, replayed.after, replayed.floor))
    if np.all(replayed.before <= _AT_FLOOR * replayed.floor):
        return Verdict.NO_GAP, 0.9
    left = np.sqrt(max(after**2 - floor**2, 0.0)) / before
    if not effects or after > _SOME * before:
        return Verdict.UNKNOWN, 0.9
    if after <= 1.5 * floor or after <= _NEARLY * before:
        return Verdict.EXPLAINED, float(np.clip(1.0 - left, 0.5, 0.97))
    return Verdict.PARTLY, 0.8


def _headline(verdict: Verdict, r: Replayed) -> str:
    before, after, floor = (total(x) for x in (r.before, r.after, r.floor))
    if verdict is Verdict.NO_GAP:
        return f"replay error on {r.of}: {before:.2g} rad, no more than encoders and clocks leave ({floor:.2g} rad)"
    return f"replay error on {r.of}: {before:.2g} → {after:.2g} rad (floor {floor:.1g}: encoders and clocks)"


def _notes(everything: Fit, loop: Loop) -> list[str]:
    out = []
    shared = [p.family == "target_delay" and p.joint < 0 for p in everything.table]
    for late, sd in zip(everything.theta[shared], everything.sigma[shared], strict=True):
        if late < -2.0 * np.hypot(sd, checks.LOOSE_TIME):
            out.append(
                f"positions lead their targets by {-1e3 * late:.1f} ms: are the stamps of targets late? "
                "No model can hold that; other numbers take it up"
            )
    if loop.source == "model":
        out.append(
            "kp is the model's: the log does not say it, and what a replay finds of it has a wide prior"
        )
    return out
