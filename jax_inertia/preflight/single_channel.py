"""Checks of one channel at a time: dropped, frozen, saturated, spiked, in degrees."""

from collections.abc import Iterator

import numpy as np

from jax_inertia.logs.findings import Finding, Severity, run_bounds, spans
from jax_inertia.logs.log import CHANNELS, Log
from jax_inertia.logs.schema import SHAPES
from jax_inertia.signals.spikes import off_neighbours, quantum

_MANY_NAN = 0.2
_FROZEN_SECONDS, _FROZEN_SAMPLES = 0.5, 20
_REPEATED_SHARE = 0.02
_CLIPPED_RUN, _CLIPPED_SAMPLES, _CLIPPED_PILE = 3, 10, 3
# From a register's end to its beginning a value jumps by less than its motion from sample to sample; in shares of it.
_WRAPPED = 0.1
_SPIKE_LEAST = {"qpos": 5e-3, "qvel": 5e-2, "tau": 0.0}
_STILL, _MOVED = 1e-3, 1e-2


def dropped(log: Log, time: np.ndarray) -> Iterator[Finding]:
    """Samples that are not numbers, channel by channel."""
    for label, x in _columns(log, CHANNELS):
        bad = ~np.isfinite(x)
        if bad.any():
            grave = bad.mean() > _MANY_NAN
            yield Finding(
                Severity.ERROR if grave else Severity.WARNING,
                "nan",
                f"{label} is NaN or Inf in {bad.sum()} of {bad.size} samples ({spans(time, bad)}); "
                + ("log it, or leave the joint out" if grave else "these rows will be masked"),
            )


def frozen(log: Log, time: np.ndarray) -> Iterator[Finding]:
    """Channels that stand still, to the last bit, while something says that they should not."""
    qpos = np.asarray(log.qpos)
    moving = _moving(qpos, time)
    # Without torque it is the targets that tell whether a joint should move, and without these nothing does.
    told = log.qpos_target if log.tau is None else log.tau
    tau = np.zeros(qpos.shape) if told is None else np.asarray(told)
    for j, name in enumerate(log.joint_names):
        if log.qvel is not None:
            yield from _frozen_motion(name, qpos[:, j], np.asarray(log.qvel)[:, j], time)
        else:
            yield from _frozen_encoder(name, qpos[:, j], tau[:, j], time, moving)
        x = tau[:, j]
        if log.tau is None:
            continue
        if np.ptp(x) == 0:
            message = f"tau of {name!r} is {x[0]:g} throughout; log it, or leave the joint out"
            yield Finding(Severity.WARNING, "frozen", message)
            continue
        for a, b in _constant_runs(x, time):
            # At an extreme value it is rather a limit: see `saturated`.
            if moving[a:b].mean() > 0.5 and (x[a] == 0 or x[a] not in (x.min(), x.max())):
                message = (
                    f"tau of {name!r} stays at exactly {x[a]:g} from {time[a]:.4g} to "
                    f"{time[b - 1]:.4g} s while the robot moves; a dropped sensor or a drive "
                    "switched off: cut it out"
                )
                yield Finding(Severity.WARNING, "frozen", message)
                break


def repeated(log: Log, time: np.ndarray) -> Iterator[Finding]:
    """Rows that repeat the row before in every joint channel, far above coincidence."""
    if log.tau is None and log.qvel is None:
        # Encoders alone are coarse: a slow joint repeats its counts.
        return
    rows = np.hstack([np.asarray(x) for x in (log.qpos, log.qvel, log.tau) if x is not None])
    same = (np.diff(rows, axis=0) == 0)[_moving(np.asarray(log.qpos), time)[1:]]
    if not same.size:
        return
    share = same.all(axis=1).mean()
    # Coarse sensors repeat values too, but not all of them in the same rows.
    if share > max(_REPEATED_SHARE, 5 * np.prod(same.mean(axis=0))):
        message = (
            f"{100 * share:.0f} % of the rows repeat the row before in every channel while the "
            "robot moves; the logger is faster than the robot's samples, or stalls: log fresh samples only"
        )
        yield Finding(Severity.WARNING, "repeated", message)


def saturated(log: Log, time: np.ndarray) -> Iterator[Finding]:
    """Torque piled up at its exact extreme value while the robot moves."""
    if log.tau is None:
        return
    moving = _moving(np.asarray(log.qpos), time)
    for j, name in enumerate(log.joint_names):
        x = np.asarray(log.tau)[:, j]
        reach = max(0.01 * np.ptp(x), 1.5 * quantum(x))
        for limit, side in ((x.max(), "maximum"), (x.min(), "minimum")):
            runs = run_bounds((x == limit) & moving)
            runs = runs[runs[:, 1] - runs[:, 0] >= _CLIPPED_RUN]
            held = int(np.sum(runs[:, 1] - runs[:, 0]))
            # A smooth peak leaves samples just below its top too: a sine, 2.4 times fewer in the
            # next of equal steps.
            below = np.sum((np.abs(x - limit) <= reach) & (x != limit))
            strong = abs(limit) > 0.3 * np.abs(x).max()
            if strong and held >= _CLIPPED_SAMPLES and held > _CLIPPED_PILE * below:
                message = (
                    f"tau of {name!r} sits at its {side} {limit:g} in {held} samples (first at "
                    f"{time[runs[0, 0]]:.4g} s); clipped: mask these rows, or move less hard"
                )
                yield Finding(Severity.WARNING, "saturated", message)


def registers(log: Log) -> Iterator[Finding]:
    """Signed values in a register read without its sign: they jump by all that it holds, and by nothing near it.

    They have one sign then, whatever the scale. One that has both is none: of continuous values the least step means
    nothing, and some multiple of it is always near the largest jump.
    """
    for label, x in _columns(log, ("qpos", "qvel", "tau")):
        step = quantum(x)
        if x.min() < 0.0 < x.max():
            continue
        change = np.abs(np.diff(x))
        for bits in (16, 32):
            whole = step * (1 << bits)
            jumps = np.abs(change - whole) < _WRAPPED * whole
            if whole and jumps.any() and np.all(change[~jumps] < _WRAPPED * whole):
                message = (
                    f"{label} jumps by {whole:.6g} about 0, {jumps.sum()} times: a register of {bits} bits without its "
                    f"sign (two's complement); subtract {whole:.6g} from what is above {0.5 * whole:.6g}"
                )
                yield Finding(Severity.ERROR, "register", message)


def spikes(log: Log, time: np.ndarray) -> Iterator[Finding]:
    """Single samples far off both neighbours, measured by the channel's usual changes."""
    for array, least in _SPIKE_LEAST.items():
        for label, x in _columns(log, (array,)):
            off, enough = off_neighbours(x)
            bad = off > max(enough, least)
            if bad.any():
                k = int(np.argmax(off))
                message = (
                    f"{label} has {bad.sum()} single samples far off their neighbours, the largest "
                    f"{x[k]:.4g} at {time[k]:.4g} s; outliers: a diagnosis leaves them out; "
                    "for an estimate set them to NaN, or gate"
                )
                yield Finding(Severity.WARNING, "spike", message)


def degrees(log: Log, scalar_kinds: dict[str, str]) -> Iterator[Finding]:
    """Positions of hinges beyond two turns: degrees, or a joint that really turns on."""
    qpos = np.asarray(log.qpos)
    whole = np.all(qpos == np.round(qpos), axis=0) & (np.ptp(qpos, axis=0) > 4 * np.pi)
    counted = [name for name, w in zip(log.joint_names, whole, strict=True) if w]
    if counted:
        message = (
            f"qpos of {', '.join(counted)} are whole numbers over more than two turns: counts of an encoder; expected "
            "rad: jax-inertia convert --position-scale (rad of a count) --position-zero (its zero)"
        )
        yield Finding(Severity.ERROR, "counts", message)
        return
    far = [
        f"{name!r} ({qpos[:, j].min():.4g} to {qpos[:, j].max():.4g})"
        for j, name in enumerate(log.joint_names)
        if scalar_kinds.get(name, "hinge") == "hinge" and np.abs(qpos[:, j]).max() > 4 * np.pi
    ]
    if far:
        message = (
            f"qpos goes beyond two turns: {', '.join(far)}; expected rad, these look like degrees"
        )
        yield Finding(Severity.WARNING, "degrees", message)


def wrapped(log: Log, time: np.ndarray, scalar_kinds: dict[str, str]) -> Iterator[Finding]:
    """Positions of hinges that jump by a whole turn from one sample to the next."""
    qpos = np.asarray(log.qpos)
    for j, name in enumerate(log.joint_names):
        jump = np.diff(qpos[:, j])
        turns = np.round(jump / (2 * np.pi))
        # The rest of the jump is motion: a sample's worth of it is far from half a turn.
        whole = (turns != 0) & (np.abs(jump - 2 * np.pi * turns) < 1.0)
        if (
            scalar_kinds.get(name, "hinge") == "hinge"
            and whole.any()
            and np.all(np.abs(jump[~whole]) < 1.0)
        ):
            k = int(np.argmax(whole)) + 1
            message = (
                f"qpos of {name!r} jumps by {jump[k - 1]:.4g} rad at {time[k]:.4g} s, {whole.sum()} times in all: "
                "an angle wrapped at half a turn; unwrap it (numpy.unwrap)"
            )
            yield Finding(Severity.ERROR, "wrapped", message)


def still(log: Log) -> Iterator[Finding]:
    """Joints that never move: one finding for all of them."""
    span = np.ptp(np.asarray(log.qpos), axis=0)
    names = [name for name, s in zip(log.joint_names, span, strict=True) if s < _STILL]
    if len(names) == len(log.joint_names):
        message = (
            "no joint moves by more than 1 mrad (or mm); gravity in one pose leaves inertias, "
            "friction and most masses unknown: record an exciting motion"
        )
        yield Finding(Severity.WARNING, "no_motion", message)
    elif names:
        message = (
            f"joints that do not move: {', '.join(names)}; their friction and inertia stay unknown"
        )
        yield Finding(Severity.NOTE, "no_motion", message)


_OF_JOINTS = tuple(name for name in CHANNELS if SHAPES[name][-1] == "n")


def _columns(log: Log, arrays: tuple[str, ...]) -> Iterator[tuple[str, np.ndarray]]:
    for array in arrays:
        if (value := getattr(log, array)) is None:
            continue
        x = np.asarray(value)
        for index in np.ndindex(x.shape[1:]):
            if array in _OF_JOINTS:
                label = f"{array} of {log.joint_names[index[0]]!r}"
            elif array == "contact_wrench":
                label = f"{array}[{index[1]}] of {log.contact_bodies[index[0]]!r}"
            elif array in ("contact_force", "contact_flag"):
                label = f"{array} of {log.contact_bodies[index[0]]!r}"
            else:
                label = f"{array}[{index[0]}]"
            yield label, x[:, *index]


def _frozen_motion(
    name: str, qpos: np.ndarray, qvel: np.ndarray, time: np.ndarray
) -> Iterator[Finding]:
    """The first long stretch of one value of qpos, and of qvel, that the other one contradicts."""
    if np.ptp(qpos) < _MOVED:
        return
    speed = np.percentile(np.abs(qvel), 99)
    step = quantum(qvel)
    for a, b in _constant_runs(qpos, time):
        if np.sqrt(np.mean(qvel[a:b] ** 2)) > max(0.1 * speed, 3 * step):
            yield _frozen(f"qpos of {name!r}", qpos[a:b], time[a:b], "qvel")
            break
    for a, b in _constant_runs(qvel, time):
        drift = np.ptp(qpos[a:b] - qvel[a] * (time[a:b] - time[a]))
        if drift > max(0.05 * np.ptp(qpos), 3 * step * (time[b - 1] - time[a])):
            yield _frozen(f"qvel of {name!r}", qvel[a:b], time[a:b], "qpos")
            break


# A fine encoder, by its step over its range, flickers where a joint stands; and one second is long for it not to.
_FINE, _STANDS = 1e-4, 1.0


def _frozen_encoder(
    name: str, qpos: np.ndarray, tau: np.ndarray, time: np.ndarray, moving: np.ndarray
) -> Iterator[Finding]:
    """A long stretch of one value of a fine encoder in which its joint's torque changes as it does elsewhere."""
    if np.ptp(qpos) < _MOVED or quantum(qpos) > _FINE * np.ptp(qpos):
        return
    for a, b in _constant_runs(qpos, time):
        long = time[b - 1] - time[a] > _STANDS and moving[a:b].mean() > 0.5
        if long and np.std(tau[a:b]) > 0.5 * np.std(tau):
            message = (
                f"qpos of {name!r} stays at exactly {qpos[a]:.4g} from {time[a]:.4g} to {time[b - 1]:.4g} s while its "
                "torque goes on as before; a frozen encoder: cut the stretch out, unless the joint is braked"
            )
            yield Finding(Severity.WARNING, "frozen", message)
            break


def _frozen(label: str, x: np.ndarray, time: np.ndarray, witness: str) -> Finding:
    value, start, stop = x[0], time[0], time[-1]
    message = (
        f"{label} stays at exactly {value:.4g} from {start:.4g} to {stop:.4g} s but {witness} says "
        "that the joint moves; a frozen sensor: cut the stretch out"
    )
    return Finding(Severity.ERROR, "frozen", message)


def _constant_runs(x: np.ndarray, time: np.ndarray) -> np.ndarray:
    """First and one past the last sample of every long stretch of one value, (runs, 2)."""
    runs = run_bounds(np.diff(x) == 0)
    runs[:, 1] += 1
    long = time[runs[:, 1] - 1] - time[runs[:, 0]] >= _FROZEN_SECONDS
    return runs[long & (runs[:, 1] - runs[:, 0] >= _FROZEN_SAMPLES)]


def _moving(qpos: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Whether any joint covers ground within ± 0.1 s of a sample, (T,)."""
    low = np.searchsorted(time, time - 0.1)
    high = np.minimum(np.searchsorted(time, time + 0.1), time.size - 1)
    ground = np.maximum(1e-2 * np.ptp(qpos, axis=0), _STILL)
    return np.any(np.abs(qpos[high] - qpos[low]) > ground, axis=1)
