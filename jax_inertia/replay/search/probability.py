"""How probable an effect is, given this log: by Laplace's approximation of the evidence, against all that would do.

    L = −ln(exp(−E/2) + Σ_a exp(−c_a/2)),

E, in twice nats, is by how much the log is likelier with the effect's numbers than without, all others following: on
the cost's parabola θᵀ C⁻¹ θ of its numbers θ from the model's own, C their covariance, less ln N for each (BIC, N
independent samples) and the odds against an odd one; and less what validation rows lose by it, if they do. c_a,
likewise, is what alternative a costs more than the effect, on the fitted rows and on the validation rows together.
That the effect or an alternative with a name is there has the log odds without those alternatives' c_a.
What is the same by an equation is no alternative, and what has no name is one (`unnamed`). L becomes a probability
as by torque (`diagnosis.certainty.probability`).

A limit has no size in a model without one, no parabola leads there, and another motion may hardly ask for it: E is of
fitted and validation rows then, all others refitted without it. Of these rows together is what has no name, of all
effects: a stretch of two seconds is like some handful of shapes whatever moves there.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.certainty.probability import log_odds
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.joint_numbers import COORDINATES
from jax_inertia.replay.search.held_out import Unseen
from jax_inertia.replay.search.instead import Instead, Rows
from jax_inertia.replay.search.tries import LOG_ODDS


class Sure(NamedTuple):
    """Log odds L of an effect [nats]."""

    own: float
    """That it is there."""
    or_another: float
    """That it is, or one of those with a name that would do in its place."""

    @property
    def log_odds(self) -> float:
        """What a verdict that lists it stands on: the effect with its ties."""
        return self.or_another


def odds_of_effects(
    found: Fit,
    units: Sequence[Rows],
    odd: Sequence[Rows],
    instead: Mapping[Rows, tuple[Instead, ...]],
    run: Unseen,
    everything: Unseen,
    refitted: Callable[[Rows], Fit],
) -> dict[Rows, Sure]:
    """Of the effects of some rows; `odd`: those that few robots have, `run`: the validation rows.

    `everything`: fitted and validation rows; `refitted`: the fit without the numbers of some rows.
    """
    if not units:
        return {}
    held, errors = (rows.taken_back(found, units) for rows in (run, everything))
    now, out = errors[0], {}
    for rows, lost, without in zip(units, held[1:], errors[1:], strict=True):
        if np.isfinite([found.table[k].nominal for k in rows]).all():
            evidence = _evidence(found, rows) + min(run.likelier(held[0], lost, found.weights), 0.0)
        else:
            bare = refitted(rows)
            evidence = everything.likelier(now, everything.errors(bare), found.weights)
        evidence -= 2.0 * LOG_ODDS * (rows in odd)
        evidence -= numbers_paid(found, rows) * float(np.log(max(found.samples, 2.0)))
        named = [max(x.cost, 0.0) for x in instead.get(rows, ()) if not x.bound]
        # What has no name is as rare as any odd effect, and what every robot has is not. Behind an alternative with a
        # name it may be that one.
        rare = 2.0 * LOG_ODDS * (rows not in odd)
        unnamed = everything.unnamed(now, without, numbers_paid(found, rows)) + rare
        against = [evidence]
        if unnamed < min(named, default=np.inf):
            against.append(max(unnamed, 0.0))
        own, together = (
            log_odds([0.5 * x for x in costs]) for costs in ((*against, *named), against)
        )
        out[rows] = Sure(own, together)
    return out


def _evidence(found: Fit, rows: Rows) -> float:
    """On the cost's parabola, in twice nats."""
    off = np.array([found.theta[k] - found.table[k].nominal for k in rows])
    known = np.array([found.covariance[k, k] > 0 for k in rows])
    kept = np.array(rows)[known]
    own: Float[np.ndarray, "k k"] = found.covariance[np.ix_(kept, kept)]
    return float(off[known] @ np.linalg.solve(own, off[known])) if known.any() else 0.0


def numbers_paid(found: Fit, rows: Rows) -> int:
    """How many numbers of an effect are paid for."""
    return max(sum(found.table[k].family not in COORDINATES for k in rows), 1)
