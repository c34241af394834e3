"""What a diagnosis from targets and encoders found."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.result import Verdict
from jax_inertia.replay.fit import Fit
from jax_inertia.replay.loop import Loop
from jax_inertia.replay.simulate import Record


class Size(NamedTuple):
    """A number with its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclasses.dataclass(frozen=True)
class Effect:
    """Something that the replayed model lacks."""

    family: str
    kind: str
    """Of its place: "joint", "body" or "global"."""
    name: str
    parameter: str
    size: Size
    nominal: float
    share: float
    """Of the nominal replay's squared error on the checked run: what returns when it alone is left out."""
    ordinary: bool
    ties: tuple[tuple[str, str], ...]
    """What positions alone cannot tell it from and by what sum they are bound, each "exact" or "motion_limited"."""


@dataclasses.dataclass(frozen=True, eq=False)
class Replayed:
    """Replays of the run that played no part in the fit."""

    record: Record
    nominal: Float[np.ndarray, "T n"]
    corrected: Float[np.ndarray, "T n"]
    floor: Float[np.ndarray, " n"]
    of: str
    """Which run: "the other run" or "the rest of the log"."""

    def error(self, path: Float[np.ndarray, "T n"]) -> Float[np.ndarray, " n"]:
        """Of one replay at each joint, rms over what counts [rad]."""
        return rms((path - self.record.q)[self.record.settled])

    @property
    def before(self) -> Float[np.ndarray, " n"]:
        """Error of the nominal model at each joint, rms [rad]."""
        return self.error(self.nominal)

    @property
    def after(self) -> Float[np.ndarray, " n"]:
        """Error of the corrected model at each joint, rms [rad]."""
        return self.error(self.corrected)


def rms(error: Float[np.ndarray, "*b T n"]) -> Float[np.ndarray, "*b n"]:
    """Root mean square along time."""
    return np.sqrt(np.mean(error**2, axis=-2))


def total(per_joint: Float[np.ndarray, " n"]) -> float:
    """Root mean square over joints."""
    return float(np.sqrt(np.mean(per_joint**2)))


@dataclasses.dataclass(frozen=True, eq=False)
class Diagnosis:
    """Verdict, effects, every joint's numbers, and the replays that prove or disprove them."""

    verdict: Verdict
    confidence: float
    headline: str
    names: tuple[str, ...]
    loop: Loop
    effects: tuple[Effect, ...]
    everything: Fit
    """All ordinary numbers at once, with their intervals: what is known of each joint, listed as an effect or not."""
    found: Fit
    """Those that are needed, the others at the nominal model's."""
    replayed: Replayed
    worse: tuple[str, ...]
    """Joints that the corrected model replays worse than the nominal one."""
    notes: tuple[str, ...]
