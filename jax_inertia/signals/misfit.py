"""Joints whose residual is no noise: what an estimate of bodies leaves there, the model lacks."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

# Of the white part, so many times as large is what cannot be noise; and of the torque, this share is worth a word.
_TIMES, _SHARE = 5.0, 0.05
_FEW = 20
_TOLD = 5


class Misfit(NamedTuple):
    """One joint's residual, its noise and its torque, all rms [N m, N]."""

    row: int
    residual: float
    noise: float
    torque: float

    @property
    def exceeds(self) -> bool:
        """The residual exceeds the torque: the model makes it worse than no model."""
        return self.residual > self.torque


def misfits(
    residual: Float[np.ndarray, "T nv"],
    torque: Float[np.ndarray, "T nv"],
    valid: Bool[np.ndarray, "T nv"],
) -> list[Misfit]:
    """Rows of the equations of motion whose residual is far above its noise, the largest first.

    Samples are spaced so that noise is white (`log_filter.thinned`): its size σ is that of the third differences, of
    which motion and what the model lacks have next to none, √20 σ.
    """
    out = []
    for j in range(residual.shape[1]):
        r, ok = residual[:, j], valid[:, j]
        four = ok[3:] & ok[2:-1] & ok[1:-2] & ok[:-3]
        if four.sum() < _FEW:
            continue
        noise = _rms(np.diff(r, 3)[four]) / np.sqrt(20.0)
        one = Misfit(j, _rms(r[ok]), noise, _rms(torque[ok, j]))
        if one.residual > max(_TIMES * noise, _SHARE * one.torque):
            out.append(one)
    return sorted(out, key=lambda one: -one.residual)


def misfit_notes(found: Sequence[Misfit], names: Sequence[str]) -> list[str]:
    """What is to be said of the misfits of a log and a model, given the rows' names."""
    notes = []
    if worse := [one for one in found if one.exceeds][:_TOLD]:
        told = (f"{names[one.row]} {one.residual:.2g} N m of {one.torque:.2g}" for one in worse)
        notes.append(
            f"the residual exceeds the torque itself ({', '.join(told)}, rms): the log's torques are not this model's; "
            "look at signs, units and order of joints before any number here"
        )
    if rest := [one for one in found if not one.exceeds][:_TOLD]:
        told = (f"{names[one.row]} {one.residual:.2g} N m, noise {one.noise:.2g}" for one in rest)
        notes.append(
            f"the residual is larger than noise ({'; '.join(told)}, rms): the model lacks something there; jax-inertia "
            "diagnose of the same log and model says what"
        )
    return notes


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))
