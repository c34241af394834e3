"""Effects that few robots have: which numbers each takes, and at which sizes it is first tried."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.environment import LEVEL
from jax_inertia.model.joint_inertia import bodies_off_their_axes, moved_bodies
from jax_inertia.replay.joint_numbers import CENTRE, FORCE, RATIO, SHIFT, TILT, Numbers
from jax_inertia.replay.loop import ALL, NO_JOINT, Parameter
from jax_inertia.replay.record import Record, step_means
from jax_inertia.replay.simulation.plant import Plant

STEPPED = (
    "load_friction", "stribeck_friction", "position_friction", "torque_saturation",
    "torque_speed", "actuator_lag",
)  # fmt: skip
"""Families of what changes a joint along the motion, whose replays are stepped."""


class Candidate(NamedTuple):
    """One effect at one place."""

    family: str
    parameters: tuple[Parameter, ...]
    starts: tuple[tuple[float, ...], ...]
    """Values of the parameters to be tried."""
    scales: bool = False
    """Whether its columns grow with its numbers: one start for each is enough, and the best ones are on a parabola.

    Numbers without a start of their own stay as they are in the others' until a fit.
    """

    @property
    def place(self) -> tuple[int, str]:
        """Joint and body."""
        return self.parameters[0].joint, self.parameters[0].body


# Prior deviations: of torque as a share of a joint's typical one, of times [s], of widths [rad; m of a slide], of a
# mass's share.
_BIAS_SHARE, _LAG, _OWN_DELAY, _MASS_SHARE = 0.5, 0.02, 0.01, 0.5
_WIDTH, _LOAD = 0.015, 0.15
_DRAG_SHARE = 0.3
"""Of a joint's typical torque, quadratic viscous friction at its largest speed."""
_STRENGTH = 0.2
"""Of a motor, prior deviation of its logarithm."""
_DEAD_BANDS, _PLAYS = (0.003, 0.01, 0.025), (0.004, 0.012, 0.03)
_LOADS = (0.08, 0.2)
_LARGEST_LIMIT, _NEXT_LIMIT, _LEAST_LIMITS = 0.9, 0.8, 4
"""Of the largest torque that is asked for, what the first limit has; each of the next; how many at least.

A loop asks for many times what a strong limit lets it have: the others go down to what the motion takes.
"""
_FREE_SPEEDS = (1.0, 2.0)
"""Of the largest speed."""
_INTEGRALS, _INTEGRAL_RATE = (1.0, 4.0), 3.0
"""Gains of a drive's integral over its kp [1/s], where it is first tried, and the prior deviation: a drive that
integrates takes up a standing error within a second."""
_STICTIONS, _SLOW = (0.5, 1.5), (0.03, 0.15)
_LONGEST_OWN = 0.2
_PAYLOAD_OFFSET, _TRIED_OFFSET = 0.05, 0.03
"""Of a load from its body's centre of mass [m]."""
_TRIED = 0.3
"""Of a prior deviation, where a number is first tried whose column grows with it."""
_LACKS = 0.3
"""Of a body's mass, what of it a robot lacks at most: covers, a battery."""
_SPRING_SHARE = 0.5
"""Of kp, a spring across two joints: a loop is stiffer than what it has to hold."""
_LEAST_RATIO = 0.2
"""Of two joints' turns in a spring across both; over one of 5 it is a spring of one joint."""
_FORCE_SHARE, _GRAVITY = 0.2, 9.81
_SHIFT_SHARE = 0.3
"""Of a body's radius of gyration, by which covers, cables and batteries that CAD leaves out move its centre."""


def candidates(
    plant: Plant,
    records: Sequence[Record],
    now: Numbers,
    torque: Float[np.ndarray, " n"],
) -> list[Candidate]:
    """All of them; `now`: as fitted so far, `torque`: typical of each joint's motion [N m]."""
    asked, fastest = demands(records, now)
    travel = np.ptp(np.concatenate([r.q for r in records]), axis=0)
    out = []
    for j in range(len(plant.names)):
        dry = max(now.dry[j], 0.1 * torque[j])
        if records[0].torque is not None:
            out.append(
                _one("torque_gain", j, 0.0, _STRENGTH, -2.0, 2.0, (0.3 * _STRENGTH,), scales=True)
            )
            # Without torque it is a bias of the loop's.
            out.append(
                _one(
                    "asymmetric_coulomb", j, 0.0, dry, -np.inf, np.inf, (_TRIED * dry,), scales=True
                )
            )
        else:
            # Of the motor's torque, which that of the loop does not have.
            out.append(_lag("actuator_lag", j))
        out += [_lag("target_lag", j), _own_delay(j), _integral(j, now.kp[j], torque[j])]
        out += _of_motor(j, asked[j], fastest[j], torque[j], now.limit[j])
        out += _of_friction(j, dry, travel[j])
        joint = plant.model.joint(plant.names[j])
        own = float(plant.model.jnt_stiffness[joint.id])
        out += _of_motion(j, torque[j], fastest[j], travel[j], own)
        out += _of_widths(j)
    if len(plant.names) > 1:
        out += _of_widths(ALL)
        out += [_one("load_friction", ALL, 0.0, _LOAD, 0.0, 0.9, _LOADS)]
        # A lag of all motors alike is the hold of their loop, too, and no candidate.
        out.append(_lag("target_lag", ALL))
        out.append(_integral(ALL, float(np.mean(now.kp)), float(np.mean(torque))))
    out.append(_lag("target_low_pass", ALL))
    if np.any(plant.model.opt.gravity):
        out.append(_several("gravity_tilt", TILT, ALL, "", LEVEL, 1.0))
    rest = _masses(plant) + _shifts(plant) + _forces(plant)
    return out + _across(plant, travel) + rest


def demands(records: Sequence[Record], now: Numbers) -> tuple[np.ndarray, np.ndarray]:
    """The largest torque that each joint's loop asks for, and its largest speed, for 99.5 % of the time."""
    asked, speed = [], []
    for r in records:
        steps = int(r.time[-1] / r.period)
        commanded = step_means(
            r.commanded.time, r.commanded.position, r.period, steps, now.delay, now.lag
        )
        q = np.stack([np.interp(np.arange(steps) * r.period, r.time, x) for x in r.q.T], axis=1)
        asked.append(np.abs(now.kp * (commanded - (q - now.offset))))
        wide = max(int(0.02 / r.period), 1)
        speed.append(np.abs(q[wide:] - q[:-wide]) / (wide * r.period))
    top = [np.percentile(np.concatenate(x), 99.5, axis=0) for x in (asked, speed)]
    return np.maximum(top[0], 1e-6), np.maximum(top[1], 1e-6)


def _one(family, joint, nominal, sd, low, high, starts, *, scales=False, centre=None) -> Candidate:
    p = Parameter(family, joint, nominal, sd, low, high, "", centre)
    return Candidate(family, (p,), tuple((x,) for x in starts), scales)


def _several(
    name: str, families: Sequence[str], joint: int, body: str, sd: float, most: float
) -> Candidate:
    """Of several coordinates alike, each tried alone."""
    every = tuple(Parameter(f, joint, 0.0, sd, -most, most, body) for f in families)
    starts = tuple(tuple(x) for x in _TRIED * sd * np.eye(len(every)))
    return Candidate(name, every, starts, True)


def _lag(family: str, j: int) -> Candidate:
    return _one(family, j, 0.0, _LAG, 0.0, 0.5, (0.5 * _LAG,), scales=True)


def _own_delay(j: int) -> Candidate:
    start = (0.5 * _OWN_DELAY,)
    return _one("target_delay", j, 0.0, _OWN_DELAY, 0.0, _LONGEST_OWN, start, scales=True)


def _integral(j: int, kp: float, torque: float) -> Candidate:
    """Its gain, and one over its clamp, which is 0 where none is reached."""
    gain = Parameter("drive_integral", j, 0.0, _INTEGRAL_RATE * kp, 0.0, 20.0 * _INTEGRAL_RATE * kp)
    clamp = Parameter("integral_windup", j, 0.0, 1.0 / torque, 0.0, 20.0 / torque)
    starts = tuple((rate * kp, x / torque) for rate in _INTEGRALS for x in (0.0, 1.0))
    return Candidate("drive_integral", (gain, clamp), starts)


def _of_motor(j: int, asked: float, fastest: float, torque: float, said: float) -> list[Candidate]:
    bias = _BIAS_SHARE * torque
    out = [_one("torque_bias", j, 0.0, bias, -np.inf, np.inf, (0.2 * bias,), scales=True)]
    limit = float(np.log(said)) if np.isfinite(said) else np.inf
    top = min(asked, said)
    lowest = min(torque, _LARGEST_LIMIT * _NEXT_LIMIT ** (_LEAST_LIMITS - 1) * top)
    count = int(np.ceil(np.log(_LARGEST_LIMIT * top / lowest) / -np.log(_NEXT_LIMIT) - 1e-9)) + 1
    limits = np.log(np.geomspace(_LARGEST_LIMIT * top, lowest, count)).tolist()
    low, high = float(np.log(0.1 * lowest)), float(np.log(1.5 * top))
    centre, sd = 0.5 * (limits[0] + limits[-1]), max(0.5, 0.5 * (limits[0] - limits[-1]))
    out.append(_one("torque_saturation", j, limit, sd, low, high, limits, centre=centre))
    stall = Parameter("torque_saturation", j, limit, sd, low, high + 1.0, "", centre)
    typical = 0.5 * top / fastest
    back = Parameter("torque_speed", j, 0.0, typical, 0.0, 20.0 * typical, "", typical)
    starts = tuple((a, float(np.exp(a)) / (b * fastest)) for a in limits[:-1] for b in _FREE_SPEEDS)
    return [*out, Candidate("torque_speed", (stall, back), starts)]


def _of_friction(j: int, dry: float, travel: float) -> list[Candidate]:
    more = Parameter("stribeck_friction", j, 0.0, dry, 0.0, 20.0 * dry)
    slow = Parameter("stribeck_velocity", j, 0.1, 0.1, 0.01, 2.0)
    starts = tuple((a * dry, v) for a in _STICTIONS for v in _SLOW)
    slant = 2.0 * dry / max(travel, 0.1)
    return [
        _one("load_friction", j, 0.0, _LOAD, 0.0, 0.9, _LOADS),
        Candidate("stribeck_friction", (more, slow), starts),
        _one("position_friction", j, 0.0, slant, -np.inf, np.inf, (_TRIED * slant,), scales=True),
    ]


def _of_motion(j: int, torque: float, fastest: float, travel: float, own: float) -> list[Candidate]:
    drag, stiff = _DRAG_SHARE * torque / fastest**2, torque / max(travel, 0.1)
    spring = Parameter("joint_spring", j, 0.0, stiff, -own, np.inf)
    wound = Parameter("spring_torque", j, 0.0, torque, -np.inf, np.inf)
    starts = (_TRIED * stiff, 0.0), (0.0, _TRIED * torque)
    return [
        _one("quadratic_viscous", j, 0.0, drag, 0.0, np.inf, (_TRIED * drag,), scales=True),
        Candidate("joint_spring", (spring, wound), starts, True),
    ]


def _of_widths(j: int) -> list[Candidate]:
    return [
        _one("dead_band", j, 0.0, _WIDTH, 0.0, 0.3, _DEAD_BANDS),
        _one("backlash", j, 0.0, _WIDTH, 0.0, 0.3, _PLAYS),
    ]


def _across(plant: Plant, travel: Float[np.ndarray, " n"]) -> list[Candidate]:
    """Springs across neighbours: of a tendon over two joints, turning with both or one against the other."""
    out = []
    for before, j in plant.pairs:
        pair = [before, j]
        stiff = _SPRING_SHARE * float(np.mean(plant.loop.kp[pair]))
        wide = stiff * max(float(np.max(travel[pair])), 0.1)
        for ratio in (1.0, -1.0):
            low, high = sorted((_LEAST_RATIO * ratio, ratio / _LEAST_RATIO))
            every = (
                Parameter("spring_across", j, 0.0, stiff, 0.0, np.inf),
                Parameter("across_torque", j, 0.0, wide, -np.inf, np.inf),
                Parameter("across_damping", j, 0.0, 0.05 * stiff, 0.0, np.inf),
                Parameter(RATIO, j, ratio, 0.5, low, high),
            )
            starts = tuple(
                (*(_TRIED * p.sd * (p is tried) for p in every[:2]), 0.0, ratio)
                for tried in every[:2]
            )
            out.append(Candidate("spring_across", every, starts, True))
    return out


def _masses(plant: Plant) -> list[Candidate]:
    out, model = [], plant.model
    for b in moved_bodies(model):
        mass = float(model.body_mass[b])
        sd = max(_MASS_SHARE * mass, 0.02 * float(model.body_mass.sum()))
        p = Parameter("payload", NO_JOINT, 0.0, sd, -_LACKS * mass, np.inf, model.body(b).name)
        out.append(Candidate("payload", (p,), ((0.2 * sd,),), True))
    return out


def _shifts(plant: Plant) -> list[Candidate]:
    out, model = [], plant.model
    for b in bodies_off_their_axes(model):
        size = np.sqrt(model.body_inertia[b].sum() / (2.0 * model.body_mass[b]))
        sd = _SHIFT_SHARE * float(size)
        out.append(
            _several("com_shift", SHIFT, NO_JOINT, model.body(b).name, max(sd, 1e-3), 10.0 * sd)
        )
    return out


def _forces(plant: Plant) -> list[Candidate]:
    """Of cables, hoists and balancers, in units of the weight of all that moves, which none exceeds."""
    model = plant.model
    moved = moved_bodies(model)
    weight = _GRAVITY * float(model.body_mass[list(moved)].sum())
    names = [model.body(b).name for b in moved]
    return [
        _several("constant_force", FORCE, NO_JOINT, b, _FORCE_SHARE * weight, weight) for b in names
    ]


def centre_of(c: Candidate, plant: Plant) -> Candidate | None:
    """Where a load is on its body, once it is found; None where it is on the axis of a body that moves alone."""
    body = c.place[1]
    if plant.model.body_simple[plant.model.body(body).id]:
        return None
    axes = [Parameter(f, NO_JOINT, 0.0, _PAYLOAD_OFFSET, -0.5, 0.5, body) for f in CENTRE]
    starts = tuple(tuple(x) for x in _TRIED_OFFSET * np.concatenate([np.eye(3), -np.eye(3)]))
    return Candidate("payload_centre", tuple(axes), starts)
