"""Log odds that a model lacks its joints' ordinary physics, as it is bought, against one that is calibrated: nats.

Every joint has friction and a rotor. A calibrated model has them too, and a robot differs from it by single effects; a
model as it is bought lacks them everywhere. So each joint votes on each ordinary number by what the log says of it,

    v = ln P(x > t) / P(x < t),    |v| ≤ the prior odds of a single effect,

x being what the joint has beyond the model and t what a good model may be off by. A number that the log does not
determine has no vote, and no joint says more than what a single effect there would cost.
"""

import numpy as np
from jaxtyping import Float
from scipy.stats import norm

from jax_inertia.diagnosis.checks import rms, rows
from jax_inertia.diagnosis.corrected.intervals import reported
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import CalibrationState, Settings
from jax_inertia.model.robot import Robot

NUMBERS = {
    "viscous_friction": "damping",
    "coulomb_friction": "frictionloss",
    "armature": "armature",
}
"""Ordinary numbers that a model can hold, by family."""


def stated_by_model(robot: Robot) -> CalibrationState:
    """What a model alone says: every joint has friction, so one that states none of any joint is as it is bought."""
    rubs = np.asarray(robot.damping) + np.asarray(robot.frictionloss)
    states = bool(np.any(rubs[robot.topology.dof_scalar]))
    return CalibrationState.CALIBRATED if states else CalibrationState.AS_BOUGHT


def log_odds_as_bought(selection: Selection, settings: Settings) -> float:
    """Votes of all joints on the number that most of them lack [nats]."""
    chosen = {h.key: h for h in selection.posterior.chosen}
    votes = dict.fromkeys(NUMBERS, 0.0)
    gap = _beside_odd(selection)
    for h in selection.tried:
        if h.key in chosen and h.family in NUMBERS:
            votes[h.family] += _vote(selection, chosen[h.key], gap, settings)
        elif h.family in NUMBERS:
            # Its best value is below what any joint has.
            votes[h.family] -= settings.odd_odds
    return max(votes.values())


def _beside_odd(selection: Selection) -> Float[np.ndarray, " n"]:
    """Rms of each row without what is odd [N m]: next to a heavy load no friction is material."""
    left, now = selection.evidence.y.copy(), selection.posterior
    for h in selection.odd:
        left -= now.torque(h)
    return rows(left, selection.residual.weight)


def _vote(
    selection: Selection, h: Hypothesis, gap: Float[np.ndarray, " n"], settings: Settings
) -> float:
    """v of one number."""
    row = h.place.index
    own = float(getattr(selection.residual.context, NUMBERS[h.family])[row])
    per_unit = max(float(rms(h.own_columns, selection.residual.weight[:, [row]])), 1e-12)
    good = max(
        settings.ordinary_tolerance * own,
        np.sqrt(settings.material) * gap[row] / per_unit,
    )
    mean, covariance = reported(selection, h)
    away = (mean[0] - good) / np.sqrt(covariance[0, 0])
    return float(
        np.clip(norm.logcdf(away) - norm.logsf(away), -settings.odd_odds, settings.odd_odds)
    )
