"""Lines of a report about numbers that are unusual."""

from collections.abc import Iterator

import numpy as np

from jax_inertia.diagnosis.corrected.motor_gains import distinct
from jax_inertia.diagnosis.effects.actuator import GainTolerance
from jax_inertia.diagnosis.effects.base import Interval
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import Settings


def unusual(
    selection: Selection,
    joints: dict[str, dict[str, Interval]],
    gains: dict[str, Interval],
    settings: Settings,
) -> Iterator[str]:
    """A line for each rotor that is too large to be one, and for each motor whose torque is not what its log says."""
    yield from _rotors(selection, joints)
    yield from _constants(selection, gains, settings)


def _rotors(selection: Selection, joints: dict[str, dict[str, Interval]]) -> tuple[str, ...]:
    """Numbers that fit and that no robot has."""
    out = []
    context = selection.residual.context
    _, _, da = context.sensitivity
    for name, row in context.joint_dofs.items():
        link = float(np.median(da[:, row, row])) - float(context.armature[row])
        rotor = joints[name]["armature"].value
        if rotor > 20.0 * max(link, 1e-9) and rotor > 0.5:
            out.append(
                f"rotor inertia of {rotor:.3g} kg m² at {name} is over 20 times what the joint moves: "
                "it fits, and is no rotor's"
            )
    return tuple(out)


def _constants(
    selection: Selection, gains: dict[str, Interval], settings: Settings
) -> Iterator[str]:
    """Torque constants that are distinct from what the log's torques were computed with."""
    for h in selection.posterior.chosen:
        if isinstance(h.effect, GainTolerance) and distinct(selection.posterior, h, settings):
            gain = gains[h.place.name]
            yield (
                f"the motor of {h.place.name} gives {gain.value:.3g} [{gain.low:.3g}, {gain.high:.3g}] times the "
                "torque that its current was taken for"
            )
