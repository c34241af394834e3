"""What would have replayed as well in an effect's place: one number for another, all the others following.

For each effect that was found, on the cost's parabola about the replay without it: every number that is not in use, and
every effect whose replay grows in proportion to it, each at its best size. The best of those that cost no more than a
twentieth of the likelihood are replayed, and stay if that holds of the replay, one more step of the others allowed.

By the equation of a joint that moves alone, (I + I_a) q̈ + g(q) + friction = s kp (q* − q) − kd q̇: with I and g as of
M + m in place of M, and friction, rotor and kd by the same factor 1 + m / M larger, s may be as much larger too.

Dry friction that falls with speed is the plain one and more: it would do where the evidence between both is no more
than 20 to 1 (`undecided.py`).
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.replay.fitting.errors import replay_errors
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.record import Record
from jax_inertia.replay.search.candidates import Candidate
from jax_inertia.replay.search.held_out import Unseen
from jax_inertia.replay.search.tries import AS_GOOD, LOG_ODDS, column, tried_errors
from jax_inertia.replay.search.undecided import open_between
from jax_inertia.replay.simulation.plant import Plant

Rows = tuple[int, ...]
_PLAIN, _FALLING = "coulomb_friction", "stribeck_friction"
_MOST, _LARGEST = 3, 8
"""That are replayed for each effect, and effects of which all other numbers are asked; of a friction, always."""


class Instead(NamedTuple):
    """A number that would do, how large it would be, and the sum that binds both where it is by the equation."""

    parameter: Parameter
    value: float
    bound: str = ""
    cost: float = 0.0
    """By how much the log is less likely with it, in twice nats, validation rows included."""


class _Try(NamedTuple):
    unit: Rows
    option: int
    theta: np.ndarray


def in_place_of(
    plant: Plant,
    found: Fit,
    columns: Float[np.ndarray, "P N n"],
    units: Sequence[Rows],
    pool: Sequence[Candidate],
    records: Sequence[Record],
    run: Unseen,
) -> Mapping[Rows, tuple[Instead, ...]]:
    """By the rows of each effect, the largest first; `columns`: derivatives of the error by all of the table.

    `run`: the validation rows.
    """
    if not units:
        return {}
    every, units = units, units[:_LARGEST]
    own = np.array([p.nominal for p in found.table])
    thetas = np.repeat(found.theta[None], len(units) + 1, axis=0)
    for theta, unit in zip(thetas[1:], units, strict=True):
        theta[list(unit)] = own[list(unit)]
    errors = replay_errors(plant, found.table, thetas, records)
    # One number in another's place, which is something by itself.
    options = [c for c in pool if c.scales and len(c.starts) == len(c.parameters)]
    tries = [(c, s) for c in options for s in c.starts]
    about = found._replace(error=errors[0])
    changes = {}
    for c, start, error in tried_errors(plant, about, tries, records):
        k, change = column(c, start, error - errors[0])
        # A spring without stiffness is a torque, which has a number of its own.
        if c.parameters[k].family != "spring_torque":
            changes[c.parameters[k]] = change
    more = list(changes.values())
    table = (*found.table, *changes)
    costs = _Costs(
        found, table, np.concatenate([columns, np.array(more).reshape(-1, *columns.shape[1:])])
    )
    away = np.flatnonzero(found.free & (found.theta != own))
    limit = costs.least(errors[0], costs.padded(found.theta), away) + AS_GOOD
    each = float(np.log(max(found.samples, 2.0)))
    kept: list[_Try] = []
    for unit, theta, error in zip(units, thetas[1:], errors[1:], strict=True):
        others = np.setdiff1d(away, unit)
        free = np.setdiff1d(np.arange(len(table)), [*others, *unit])
        usable = [k for k in free if np.isfinite(table[k].nominal) and np.any(costs.flat[k])]
        ranked = costs.ranked(error, costs.padded(theta), others, np.array(usable, int))
        room = limit + each * (len(unit) - 1)
        kept += [_Try(unit, k, new) for cost, k, new in ranked[:_MOST] if cost <= room]
    by_load = {u: x for u in units if (x := _by_load(plant, found, u, pool)) is not None}
    held = _Held(run, found)
    proved = _proved(plant, records, costs, away, kept, limit, each, held)
    falling = _falling(plant, about, columns, away, every, pool, records)
    return {u: (*by_load.get(u, ()), *proved.get(u, ()), *falling.get(u, ())) for u in every}


def _falling(
    plant: Plant, about: Fit, columns, away, units: Sequence[Rows], pool, records
) -> Mapping[Rows, tuple[Instead, ...]]:
    """Of each dry friction, the one that falls with speed, where the log does not decide between both."""
    plain = {about.table[u[0]].joint: u for u in units if about.table[u[0]].family == _PLAIN}
    sought = [c for c in pool if c.family == _FALLING and c.parameters[0].joint in plain]
    tries = [(c, s) for c in sought for s in c.starts]
    bends: dict[Candidate, list[tuple[float, float]]] = {}
    for c, start, error in tried_errors(plant, about, tries, records):
        change = (error - about.error) / start[0]
        costs = _Costs(
            about, (*about.table, c.parameters[0]), np.concatenate([columns, change[None]])
        )
        bends.setdefault(c, []).append(costs.along(about.error, costs.padded(about.theta), away))
    out = {}
    for c, each in bends.items():
        p = c.parameters[0]
        odds, size = open_between([b for b, _ in each], [a for _, a in each], p.sd)
        if odds > -LOG_ODDS:
            out[plain[p.joint]] = (Instead(p, size, cost=-2.0 * odds),)
    return out


def _by_load(
    plant: Plant, found: Fit, unit: Rows, pool: Sequence[Candidate]
) -> tuple[Instead, ...] | None:
    """The load that does what a kp does, at the body of a joint that moves alone."""
    p, model = found.table[unit[0]], plant.model
    if p.family != "kp_scale" or np.sum(plant.trees == plant.trees[p.joint]) > 1:
        return None
    body = model.body(model.dof_bodyid[plant.dof[p.joint]])
    loads = [c.parameters[0] for c in pool if c.parameters[0].body == body.name]
    scale = float(np.exp(found.theta[unit[0]]))
    mass = float(body.mass[0]) * (1.0 / scale - 1.0)
    text = (
        f"{mass:.3g} kg more at {body.name}, with friction, rotor and kd {1.0 / scale:.3g} times these, is the same "
        "motion: kp / (mass of what moves) is one number; torque distinguishes them"
    )
    return tuple(Instead(x, mass, text) for x in loads if x.family == "payload")


class _Held:
    """Validation rows, by what is found and by something else."""

    def __init__(self, run: Unseen, found: Fit):
        self._run, self._weights = run, found.weights
        self._own = run.errors(found)

    def loses(self, table, theta: np.ndarray) -> float:
        """By how much they are less likely by other numbers, in twice nats."""
        errors = self._run.errors_of(table, theta)
        return self._run.likelier(self._own, errors, self._weights)


def _proved(plant, records, costs: "_Costs", away, tries: Sequence[_Try], limit, each, held: _Held):
    """Those whose replays are as good."""
    out: dict[Rows, tuple[Instead, ...]] = {}
    if not tries:
        return out
    thetas = np.array([t.theta for t in tries])
    for t, error in zip(tries, replay_errors(plant, costs.table, thetas, records), strict=True):
        free = np.append(np.setdiff1d(away, t.unit), t.option)
        saved = each * (len(t.unit) - 1)
        least = costs.least(error, t.theta, free) - saved
        if least <= limit:
            p, more = costs.table[t.option], least - (limit - AS_GOOD)
            more += held.loses(costs.table, t.theta)
            out[t.unit] = (*out.get(t.unit, ()), Instead(p, float(t.theta[t.option]), cost=more))
    return out


class _Costs:
    """The cost on the parabola about an error, at the weights of a fit."""

    def __init__(self, found: Fit, table: tuple[Parameter, ...], columns: np.ndarray):
        self.table, self.root = table, found.weights.root
        self.flat = (columns * self.root).reshape(len(table), -1)
        self.mean, self.sd = (np.array([getattr(p, k) for p in table]) for k in ("mean", "sd"))
        self.low, self.high = (np.array([getattr(p, k) for p in table]) for k in ("low", "high"))
        self.hessian = self.flat @ self.flat.T + np.diag(self.sd**-2.0)

    def padded(self, theta: np.ndarray) -> np.ndarray:
        """With the options at nothing."""
        return np.append(theta, [p.nominal for p in self.table[len(theta) :]])

    def _at(self, error, theta, free) -> tuple[float, np.ndarray]:
        white = (error * self.root).ravel()
        pull = (theta - self.mean) / self.sd
        gradient = self.flat @ white
        gradient[free] += (pull / self.sd)[free]
        return float(white @ white + np.sum(pull[free] ** 2)), gradient

    def least(self, error, theta, free) -> float:
        """With the numbers in `free` at their best."""
        now, gradient = self._at(error, theta, free)
        own = self.hessian[np.ix_(free, free)]
        return now - float(gradient[free] @ np.linalg.solve(own, gradient[free]))

    def along(self, error, theta, others) -> tuple[float, float]:
        """(b, a) of the cost c + 2 b x + a x² by the last number, `others` at their best."""
        _, gradient = self._at(error, theta, others)
        across, own = self.hessian[others, -1], self.hessian[np.ix_(others, others)]
        solved = np.linalg.solve(own, np.column_stack([gradient[others], across]))
        b, a = gradient[-1] - across @ solved[:, 0], self.hessian[-1, -1] - across @ solved[:, 1]
        return float(b), float(a)

    def ranked(self, error, theta, others, options) -> list[tuple[float, int, np.ndarray]]:
        """(cost, option, numbers) with each option at its best, `others` following, the least first."""
        if not len(options):
            return []
        now, gradient = self._at(error, theta, others)
        across = self.hessian[np.ix_(others, options)]
        solved = np.linalg.solve(
            self.hessian[np.ix_(others, others)], np.column_stack([gradient[others], across])
        )
        slope = gradient[options] - across.T @ solved[:, 0]
        bend = np.diagonal(self.hessian)[options] - np.sum(across * solved[:, 1:], axis=0)
        size = np.clip(-slope / bend, *(x[options] - theta[options] for x in (self.low, self.high)))
        costs = now - gradient[others] @ solved[:, 0] + 2 * slope * size + bend * size**2
        out = []
        for i in np.argsort(costs)[:_MOST]:
            new = theta.copy()
            new[options[i]] += size[i]
            new[others] -= solved[:, 0] + solved[:, 1 + i] * size[i]
            out.append((float(costs[i]), int(options[i]), np.clip(new, self.low, self.high)))
        return out
