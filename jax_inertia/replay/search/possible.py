"""Numbers that stand at a physical bound and are asked beyond it: a set that is not possible, however well it replays.

On the cost's parabola about a fit, gradient g and inverse curvature C of all free numbers, the one at its bound would
go by −(C g)_k were there no bound, and the cost would fall by (C g)_k² / C_kk. Where that is more than a factor of
twenty in likelihood, the robot does something that these numbers only stand in for. A clock's phase is in C of a delay.
"""

from collections.abc import Sequence

import numpy as np

from jax_inertia.replay import checks
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.fitting.problem import normal
from jax_inertia.replay.loop import LOGARITHMIC, UNITS, Parameter
from jax_inertia.replay.search.ties import place_of
from jax_inertia.replay.search.tries import AS_GOOD
from jax_inertia.text.words import number, plain, unit

_WHY = {
    "target_delay": "no target acts before it is sent: are the stamps of targets late, or are targets smoothed?",
    "coulomb_friction": "no friction drives a joint",
    "viscous_friction": "no damping drives a joint",
    "armature": "no rotor has less than no inertia",
    "payload": "no link lacks so much of its mass",
}
_NO_MATTER = "loop_hold", "own_steps"
"""A loop that is faster than the model's own steps is no fault of a robot."""


def pressed(found: Fit, names: Sequence[str]) -> tuple[str, ...]:
    """One sentence for each number that is at a bound and asked beyond it, the clearest first."""
    free = np.flatnonzero(found.free)
    mean, sd = (np.array([getattr(p, key) for p in found.table]) for key in ("mean", "sd"))
    hessian, gradient = normal(found.error, found.columns, found.weights, found.theta, mean, sd)
    inverse = np.linalg.inv(hessian[np.ix_(free, free)])
    step = -inverse @ gradient[free]
    falls = step**2 / (np.diagonal(inverse) + checks.loose(found.table)[free] ** 2)
    out = []
    for i in np.argsort(-falls):
        p, x = found.table[free[i]], float(found.theta[free[i]])
        near = 1e-6 * p.sd
        beyond = (x <= p.low + near and step[i] < 0) or (x >= p.high - near and step[i] > 0)
        if beyond and falls[i] > AS_GOOD and p.family not in _NO_MATTER:
            out.append(_sentence(p, x, x + float(step[i]), names))
    return tuple(out)


def _sentence(p: Parameter, bound: float, asked: float, names: Sequence[str]) -> str:
    if p.family in LOGARITHMIC:
        bound, asked = float(np.exp(bound)), float(np.exp(asked))
    kind, name = place_of(p.joint, p.body, names)
    at = "" if kind == "global" else f" at {name}"
    why = _WHY.get(p.family, "that is beyond what is possible")
    said = f"{number(asked)}{unit(UNITS[p.family])}"
    least = f"{number(bound)}{unit(UNITS[p.family])}"
    return f"the log asks for {said} of {plain(p.family)}{at}, and {least} is the bound: {why}"
