"""Numbers of replays as the likelihood has them: 0 where the model is right, one for each size that is tried."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.likelihood.columns import FAMILIES, Number
from jax_inertia.replay.joint_numbers import CENTRE
from jax_inertia.replay.loop import LOGARITHMIC, NO_JOINT, TOLERANCES, Parameter
from jax_inertia.replay.search.candidates import Candidate
from jax_inertia.replay.simulation.plant import Plant

RARE = -float(np.log(20.0))
"""Log odds of any one odd effect: one robot in twenty has it."""
_MOST = 1e6
"""No prior is wider [rad, N m, ...]."""
_TIMES = (0.006, 0.02, 0.06)
"""Delays and lags of one joint that are compared with none [s]."""
_MOMENTS = dict(zip(CENTRE, ("moment_x", "moment_y", "moment_z"), strict=True))


class Entry(NamedTuple):
    """A number of the likelihood, and what it is in replays."""

    number: Number
    rows: tuple[int, ...]
    """Of the table: its own, and those that its shape is of."""
    start: tuple[float, ...] = ()
    """Of these rows, values that are there with it, where the likelihood has the effect as a whole or its shape."""


class Names(NamedTuple):
    """Numbers of the likelihood as numbers of replays."""

    table: tuple[Parameter, ...]
    entries: tuple[Entry, ...]

    @property
    def numbers(self) -> list[Number]:
        """As the likelihood has them."""
        return [e.number for e in self.entries]

    def theta(self, x: Float[np.ndarray, " K"]) -> Float[np.ndarray, " P"]:
        """As replays have them; the likelihood's are 0 where the model is right."""
        out = np.array([p.nominal for p in self.table], float)
        masses = {
            e.number.body: v for e, v in zip(self.entries, x, strict=True) if self._is_mass(e)
        }
        for e, v in zip(self.entries, x, strict=True):
            if v == 0.0:
                continue
            first, p = e.rows[0], self.table[e.rows[0]]
            out[list(e.rows[len(e.rows) - len(e.start) :])] = e.start
            if len(e.start) == len(e.rows):
                continue
            if p.family == "torque_saturation":
                stated = 1.0 / np.exp(p.nominal)
                out[first] = np.clip(-np.log(v + stated), p.low, p.high)
            elif p.family in LOGARITHMIC:
                out[first] += np.log1p(v)
            elif p.family in CENTRE:
                mass = masses.get(p.body, 0.0)
                out[first] = np.clip(v / mass, p.low, p.high) if mass > 0 else 0.0
            else:
                out[first] += v
        return out

    def _is_mass(self, e: Entry) -> bool:
        return self.table[e.rows[0]].family == "payload"


def named(plant: Plant, table: Sequence[Parameter], odd: Sequence[Candidate]) -> Names:
    """Every number of a table and of some candidates that a law or a size is known of, as the likelihood has it."""
    every, entries = list(table), [Entry(_number(p, ""), (k,)) for k, p in enumerate(table)]
    for c in odd:
        rows = tuple(range(len(every), len(every) + len(c.parameters)))
        every += c.parameters
        entries += _entries(plant, c, rows)
    known = [e for e in entries if e.number.shape or e.number.family in FAMILIES]
    return Names(tuple(every), tuple(known))


def _entries(plant: Plant, c: Candidate, rows: tuple[int, ...]) -> list[Entry]:
    first = c.parameters[0]
    if c.family == "stribeck_friction":
        speeds = sorted({s[1] for s in c.starts})
        return [Entry(_shaped(first, v), rows, (v,)) for v in speeds]
    if c.family == "dead_band":
        return [Entry(_shaped(first, s[0]), rows) for s in c.starts]
    if c.family in ("target_delay", "target_lag", "target_low_pass", "actuator_lag"):
        return [Entry(_shaped(first, late), rows) for late in _TIMES]
    if c.family == "torque_saturation":
        stated = 1.0 / np.exp(first.nominal)
        p = _limit(first)
        sizes = [float(np.exp(-s[0]) - stated) for s in c.starts]
        return [Entry(_shaped(p, x)._replace(effect="torque_speed"), rows) for x in sizes]
    if c.family == "position_friction":
        return [Entry(_shaped(first, float(plant.nominal.middle[first.joint])), rows)]
    if c.family == "torque_speed":
        return [x for k, s in enumerate(c.starts) for x in _falling_limit(c, rows, k, s)]
    if c.family == "backlash":
        return [Entry(_shaped(first, s[0]), rows) for s in c.starts]
    # A load's place is its first moment over its mass.
    mine = [p._replace(sd=p.sd * first.sd) if p.family in CENTRE else p for p in c.parameters]
    return [Entry(_number(p, c.family), (k,)) for p, k in zip(mine, rows, strict=True)]


def _limit(p: Parameter) -> Parameter:
    """A limit L as 1/L more than the model states, which is 0 where there is none."""
    return p._replace(nominal=0.0, sd=float(np.exp(-(p.centre or 0.0))), low=0.0, high=_MOST)


def _falling_limit(
    c: Candidate, rows: tuple[int, ...], k: int, start: tuple[float, ...]
) -> list[Entry]:
    """Both numbers of a limit that falls with speed, from its `k`-th start; it stands in for one that does not."""
    limit, slope = c.parameters
    size = float(np.exp(-start[0]) - 1.0 / np.exp(limit.nominal))
    # A limit that does not fall has a size for its shape, which is positive.
    both = {"effect": "torque_speed", "shape": -1.0 - k}
    return [
        Entry(_shaped(_limit(limit), 0.0)._replace(**both, size=size), rows[:1]),
        Entry(_shaped(slope, 0.0)._replace(**both, size=start[1], beside=size), rows[1:]),
    ]


def _shaped(p: Parameter, shape: float) -> Number:
    family = "target_lag" if p.family == "target_low_pass" else p.family
    low, high = p.low - p.nominal, p.high - p.nominal
    return Number(
        family, _joint(p), p.body, min(p.sd, _MOST), low, high, RARE, p.family, False, shape
    )


def _joint(p: Parameter) -> int:
    return -1 if p.joint == NO_JOINT else p.joint


def _number(p: Parameter, effect: str) -> Number:
    """A parameter of replays as a number: a part of an odd `effect`, or an ordinary one."""
    family, low, high = p.family, p.low - p.nominal, p.high - p.nominal
    if family in CENTRE:
        family, low, high = _MOMENTS[family], -np.inf, np.inf
    if family in LOGARITHMIC:
        low, high = float(np.expm1(low)), float(np.expm1(min(high, 20.0)))
    always = p.family in TOLERANCES
    odds = RARE if effect else 0.0
    whole = "tolerances" if always else effect
    return Number(family, _joint(p), p.body, min(p.sd, _MOST), low, high, odds, whole, always)
