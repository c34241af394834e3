"""Whether log and model mean the same, how far off replays may be for no reason, and where something is touched."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation, binary_opening
from scipy.special import comb, ndtri

from jax_inertia.replay.fitting.errors import replay_errors
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.joint_numbers import Numbers
from jax_inertia.replay.loop import HALF_PERIOD, Loop, Parameter
from jax_inertia.replay.record import Record
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import WINDOW, Windows, replay

LOOSE_TIME = HALF_PERIOD
"""How well log and loop agree about the time [s], which a model does not know."""
_ROUGH = 0.05
"""Of a friction, what no law of it says: it repeats to a few per cent and varies with position by as much (Armstrong-
Hélouvry, Dupont and Canudas de Wit, Automatica 30(7), 1994). Stated."""
_ORDERS, _QUANTILES = (3, 5, 8), (0.25, 0.5)
_REPEATS = 0.05
_AGAINST = -0.5
_MOVES = 0.02
_FROM_TARGETS = 0.3
_FAR = 5.0
"""Times a joint's usual error (1.4826 of the median), beyond which it is parted from the replay."""
_LEAST_ERROR = 2.0
"""Of the usual error: in steps of the encoder, or in what a joint that stands still errs by."""
_JOINTS = 3
"""Parted together, of one chain; a force on fewer looks like a law of the joints."""
_LASTS, _AROUND = 0.3, 0.5
"""A touch lasts at least so long, and leaves so much before and after it that is not free either [s]."""
_RARE = 0.4
"""Of the log at most: what goes on for longer is how the robot is."""


def objections(record: Record, names: Sequence[str]) -> tuple[str, ...]:
    """What looks wrong about signs and zeros, one line a joint."""
    out = []
    for j, name in enumerate(names):
        q, target = record.q[:, j], record.target[:, j]
        if min(np.ptp(q), np.ptp(target)) > _MOVES and np.corrcoef(q, target)[0, 1] < _AGAINST:
            out.append(
                f"{name!r} moves against its targets: is the sign of qpos or of qpos_target turned?"
            )
        far = float(np.median(q - target))
        if abs(far) > _FROM_TARGETS:
            out.append(
                f"{name!r} stays {far:.2f} rad from its targets: do both have the same zero?"
            )
        if np.ptp(target) == 0 and np.ptp(q) > 0.1:
            out.append(
                f"qpos_target of {name!r} never changes, and it moves by {np.ptp(q):.2f} rad"
            )
    return tuple(out)


def encoder_noise(q: Float[np.ndarray, "T n"]) -> Float[np.ndarray, " n"]:
    """Standard deviation of one sample of each encoder [rad]: of its counts, or of what is no smooth motion."""
    out = np.zeros(q.shape[1])
    for j, x in enumerate(q.T):
        values = np.unique(x)
        steps = np.diff(values)
        steps = steps[steps > 1e-9]
        if not steps.size:
            continue
        repeats = len(values) < (1.0 - _REPEATS) * len(x)
        count = _count(steps) or float(np.median(steps)) * repeats
        out[j] = max(count / np.sqrt(12.0), _rough(x))
    return out


def _rough(x: Float[np.ndarray, " T"]) -> float:
    """What is no smooth motion: the least that differences of several orders say, by several of their quantiles.

    k-th differences of white noise have √C(2k, k) of its deviation, and those of a slow motion fall with k; where a
    motion turns, or rests, its own are small, and noise is not.
    """
    orders = [k for k in _ORDERS if len(x) > 2 * k]
    each = [
        np.quantile(np.abs(np.diff(x, k)) / np.sqrt(comb(2 * k, k)), _QUANTILES) for k in orders
    ]
    # Of a normal distribution's absolute value.
    own = ndtri(0.5 * (1.0 + np.array(_QUANTILES)))
    return float(np.min(each / own)) if each else 0.0


def _count(steps: Float[np.ndarray, " S"]) -> float:
    """The step of an encoder, of differences between values that it gave: they are whole numbers of it; 0 if not.

    The least one, where nearly all are multiples of that: a fast motion passes over most counts.
    """
    least = float(np.min(steps[steps > 0.01 * np.median(steps)]))
    multiples = steps / least
    whole = np.abs(multiples - np.round(multiples)) < 0.1
    return least if np.mean(whole) > 0.9 else 0.0


def floor(records: Sequence[Record]) -> Float[np.ndarray, " n"]:
    """What replays err by though nothing is wrong, rms [rad]: by encoders, and by nothing that a fit could take up."""
    square = [len(r.q) * encoder_noise(r.q) ** 2 for r in records]
    return np.sqrt(np.sum(square, axis=0) / sum(len(r.q) for r in records))


def discrepancy(
    x: Numbers, records: Sequence[Record], steps: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """What is stated that no number can take up of each joint's error, rms [rad].

    A friction differs from any law of it by `_ROUGH` of itself, from place to place and time to time, which moves a
    loop by so much over kp; and `steps`, what the simulation's own steps do.
    """
    square = [np.mean(np.gradient(r.q, r.time, axis=0) ** 2, axis=0) for r in records]
    friction = x.dry + x.damping * np.sqrt(np.mean(square, axis=0))
    return np.hypot(steps, _ROUGH * friction / x.kp)


def moving(records: Sequence[Record]) -> Bool[np.ndarray, " n"]:
    """Joints that move, or are commanded to."""
    travel = [np.maximum(np.ptp(r.q, axis=0), np.ptp(r.target, axis=0)) for r in records]
    return np.max(travel, axis=0) > _MOVES


def torque_floor(
    records: Sequence[Record], loop: Loop, clock: float = LOOSE_TIME
) -> Float[np.ndarray, " n"]:
    """What the loop's torque errs by though nothing is wrong, rms [N m]: by encoders, and `clock` at its speed."""
    square, count = np.zeros(len(loop.kp)), 0
    for r in records:
        windows = Windows(r.time)
        counts = encoder_noise(r.q)
        speed = np.stack([windows.slope(x) for x in r.tau.T])
        own = (loop.kp * counts) ** 2 + (loop.kd * counts / WINDOW) ** 2 / 2.0
        own = own + encoder_noise(r.tau) ** 2 + clock**2 * np.mean(speed**2, axis=1)
        square, count = square + len(r.q) * own, count + len(r.q)
    return np.sqrt(square / count)


def least(records: Sequence[Record], loop: Loop) -> Float[np.ndarray, " m"]:
    """What remains of each output's error at least: what encoders leave.

    What the clocks leave is no noise of a sample: a fit may take it up in its delay.
    """
    encoders = np.sqrt(np.mean([np.mean(encoder_noise(r.q) ** 2) for r in records]))
    positions = np.full(len(loop.kp), encoders)
    if records[0].torque is None:
        return positions
    return np.concatenate([positions, torque_floor(records, loop, 0.0)])


def step_error(plant: Plant, found: Fit, records: Sequence[Record]) -> Float[np.ndarray, " m"]:
    """What the steps of a simulation leave of each output's error, rms: twice what half a step changes of it."""
    whole, half = (
        replay_errors(p, found.table, found.theta[None], records)[0]
        for p in (plant, plant.in_steps(0.5 * plant.step))
    )
    return 2.0 * np.sqrt(np.mean((half - whole) ** 2, axis=0))


def settling(plant: Plant, records: Sequence[Record]) -> list[Record]:
    """Records that count from where their start is forgotten.

    The velocity at the first stamp is a parabola's through the first samples, which is none where a first target jolts
    the joint. It may be the first difference as well, or nothing, as of a robot at rest. The nominal model replays the
    targets from each; until they are less apart than encoders see, the start shows.
    """
    seen = least(records, plant.loop)[: len(plant.names)]
    return [r._replace(settles=max(r.settles, _forgotten(plant, r, seen))) for r in records]


def _forgotten(plant: Plant, record: Record, seen: Float[np.ndarray, " n"]) -> float:
    """When the start no longer shows [s]."""
    first = (record.q[1] - record.q[0]) / (record.time[1] - record.time[0])
    starts = (record.start, first, np.zeros_like(first))
    paths = [replay(plant, (), np.zeros((1, 0)), record._replace(start=v))[0] for v in starts]
    shows = np.flatnonzero((np.ptp(paths, axis=0) > seen).any(axis=1))
    return float(record.time[shows[-1]]) if len(shows) else 0.0


def loose(table: Sequence[Parameter]) -> Float[np.ndarray, " P"]:
    """What a clock's phase adds to each delay's deviation [s]; how long the loop holds is a number of its own."""
    late = "target_delay", "target_lag", "actuator_lag", "torque_lead", "target_low_pass"
    return np.array([LOOSE_TIME / np.sqrt(3.0) * (p.family in late) for p in table])


def without_touches(
    plant: Plant, found: Fit, records: Sequence[Record], known: Sequence[Record] = ()
) -> list[Record]:
    """The same records, each with the samples in which the robot touches something, which do not count.

    `known`: records of the same logs, from the same first samples on, in which touches were found before.
    """
    paths = [replay(plant, found.table, found.theta[None], r)[0] for r in records]
    masks = touches([p - r.q for p, r in zip(paths, records, strict=True)], records, plant.trees)
    for mask, before in zip(masks, known, strict=bool(known)):
        if before.touched is not None:
            mask[: len(before.touched)] |= before.touched[: len(mask)]
    return [r._replace(touched=m) if m.any() else r for r, m in zip(records, masks, strict=True)]


def touches(
    errors: Sequence[Float[np.ndarray, "T n"]], records: Sequence[Record], trees: np.ndarray
) -> list[Bool[np.ndarray, " T"]]:
    """Samples of each record in which joints of a chain part from the replay together; none where it is not rare.

    A force from outside acts on every joint between its point and the base: while it lasts, these joints part from the
    replay together, by far more than they err by at all other times. No law of one joint does that.

    `errors`: replay minus log [rad]; `trees`: the chain that each joint belongs to.
    """
    every = np.concatenate(errors)
    steps = np.max([encoder_noise(r.q) for r in records], axis=0) * np.sqrt(12.0)
    usual = 1.4826 * np.median(np.abs(every), axis=0)
    # A joint that is at rest for most of the log has no usual error of its own: that of the others.
    usual = np.maximum(usual, np.maximum(_LEAST_ERROR * steps, 0.5 * np.median(usual)))
    out = []
    for e, r in zip(errors, records, strict=True):
        far = np.abs(e) > _FAR * usual
        together = np.zeros(len(e), bool)
        for tree in np.unique(trees):
            together |= far[:, trees == tree].sum(axis=1) >= _JOINTS
        width = [max(round(s / r.period), 1) for s in (_LASTS, _AROUND)]
        lasting = binary_opening(together, np.ones(width[0]))
        out.append(binary_dilation(lasting, np.ones(2 * width[1] + 1)) & r.settled)
    share = sum(m.sum() for m in out) / max(sum(len(m) for m in out), 1)
    return out if share <= _RARE else [np.zeros(len(m), bool) for m in out]


def touch_note(records: Sequence[Record]) -> list[str]:
    """What is to be said of the touches in some records, at most one line."""
    spans = []
    for k, r in enumerate(records):
        if r.touched is None:
            continue
        edges = np.flatnonzero(np.diff(np.concatenate([[0], r.touched.astype(int), [0]])))
        of = f" of log {k + 1}" if len(records) > 1 else ""
        spans += [
            f"{r.time[a]:.1f} to {r.time[b - 1]:.1f} s{of}"
            for a, b in zip(edges[::2], edges[1::2], strict=True)
        ]
    if not spans:
        return []
    return [
        f"several joints part from the replay together ({', '.join(spans)}): does the robot touch something there? "
        "A replay has no contacts, and the fit left these samples out; leave them out of the log"
    ]
