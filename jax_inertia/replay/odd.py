"""What may be wrong beyond what every robot has: candidates that compete on what the ordinary numbers leave.

Each is one more number, judged by its column: by how much the cost would fall, the others following.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.replay import fit as fitting
from jax_inertia.replay.fit import Fit
from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.simulate import Plant, Record

MOST = 4
LOG_ODDS = float(np.log(20.0))
"""Against any one odd effect: one robot in twenty has it."""
_BIAS_SHARE, _LAG, _OWN_DELAY, _MASS_SHARE = 0.5, 0.02, 0.01, 0.5
_GAIN = 0.02


def candidates(plant: Plant, torque: Float[np.ndarray, " n"]) -> tuple[Parameter, ...]:
    """One parameter each: torque bias, lag and own delay of a joint's targets, mass at a body that moves."""
    out = []
    for j in range(len(plant.names)):
        out += [
            Parameter("torque_bias", j, 0.0, _BIAS_SHARE * torque[j], -np.inf, np.inf),
            Parameter("target_lag", j, 0.0, _LAG, 0.0, 0.5),
            Parameter("target_delay", j, 0.0, _OWN_DELAY, 0.0, 0.2),
        ]
    model = plant.model
    for b in range(1, model.nbody):
        name = model.body(b).name
        if name and model.body_mass[b] > 0 and model.body_weldid[b] > 0:
            sd = max(_MASS_SHARE * model.body_mass[b], 0.02 * float(model.body_mass.sum()))
            out.append(Parameter("payload", -2, 0.0, sd, -0.9 * model.body_mass[b], np.inf, name))
    return tuple(out)


def add_odd(
    plant: Plant,
    found: Fit,
    records: Sequence[Record],
    held_out: Sequence[Record],
    torque: Float[np.ndarray, " n"],
    floor: float,
    progress: Callable[[str], None],
) -> Fit:
    """The fit with odd effects added one by one, for as long as evidence and held-out replays both ask for them."""
    pool = list(candidates(plant, torque))
    best = _square(plant, found, held_out)
    for k in range(MOST):
        progress(f"looking for odd effects, {k} found")
        gains = _gains(plant, found, pool, records, floor)
        if not len(gains):
            break
        first = int(np.argmax(gains))
        if gains[first] < np.log(found.samples) + 2.0 * LOG_ODDS:
            break
        new = pool.pop(first)
        table = (*found.table, new)
        free = np.append(_free(found), True)
        start = np.append(found.theta, new.nominal)
        tried = fitting.fit(plant, table, records, start, free=free, floor=floor, rounds=4)
        square = _square(plant, tried, held_out)
        # A number that does not carry over to another stretch is none of the robot's.
        if square > (1.0 - _GAIN) ** 2 * best:
            continue
        found, best = tried, square
    return found


def _free(found: Fit) -> np.ndarray:
    return np.diagonal(found.covariance) > 0


def _square(plant: Plant, found: Fit, records: Sequence[Record]) -> float:
    error = fitting.errors(plant, found.table, found.theta[None], records)[0]
    return float(np.mean(error**2))


def _gains(plant, found: Fit, pool, records, floor) -> np.ndarray:
    """By how much the cost falls with each candidate, the free numbers following, on the cost's parabola."""
    if not pool:
        return np.zeros(0)
    table = (*found.table, *pool)
    theta = np.append(found.theta, [p.nominal for p in pool])
    n = len(found.table)
    own = np.flatnonzero(_free(found))
    free = np.concatenate([_free(found), np.ones(len(pool), bool)])
    error, columns = fitting.derivatives(plant, table, records, theta, free)
    w = fitting.weights(error, floor)
    mean, sd = np.array([p.nominal for p in table]), np.array([p.sd for p in table])
    hessian, gradient = fitting.normal(error, columns, w, theta, mean, sd)
    inverse = np.linalg.inv(hessian[np.ix_(own, own)])
    out = []
    for c in range(n, len(table)):
        across = hessian[own, c]
        curvature = hessian[c, c] - across @ inverse @ across
        slope = gradient[c] - across @ inverse @ gradient[own]
        wanted = -slope / max(curvature, 1e-300)
        beyond = wanted + theta[c] < table[c].low
        out.append(0.0 if beyond else slope**2 / max(curvature, 1e-300))
    return np.array(out)
