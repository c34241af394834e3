"""What a diagnosis from targets and encoders found."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.certainty.probability import confidence, probability
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.diagnosis.verdict import Left
from jax_inertia.model.write import Change
from jax_inertia.replay.fitting.draws import Draws
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.joint_numbers import Numbers
from jax_inertia.replay.loop import Loop
from jax_inertia.replay.record import Record


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
    sizes: tuple[tuple[str, Size], ...]
    """Its parameters by name, the one that says how large it is first."""
    nominal: float
    """Of the first."""
    share: float
    """Of the nominal replay's squared error on validation rows: what returns when it alone is left out."""
    log_odds: float
    """That it, or one that it is tied with by an equation, is there (`search/probability.py`) [nats]."""
    ordinary: bool
    ties: tuple["Tie", ...]

    @property
    def probability(self) -> float:
        """The same, calibrated."""
        return probability(self.log_odds)

    @property
    def parameter(self) -> str:
        """The first one's name."""
        return self.sizes[0][0]

    @property
    def size(self) -> Size:
        """The first one's."""
        return self.sizes[0][1]


class Tie(NamedTuple):
    """What positions alone cannot tell an effect from, by what sum they are bound, and what would part them."""

    family: str
    kind: str
    name: str
    text: str
    exact: bool
    """By the equation; else on this motion only."""


class Torques(NamedTuple):
    """What torques err by on a run that played no part in the fit, rms of each joint [N m]."""

    loop_before: Float[np.ndarray, " n"]
    """Of the loop as said, at the positions that were measured: targets → torque alone."""
    loop_after: Float[np.ndarray, " n"]
    before: Float[np.ndarray, " n"]
    """Along the nominal model's replay: both halves."""
    after: Float[np.ndarray, " n"]
    floor: Float[np.ndarray, " n"]
    """What encoders and clocks leave of the loop's."""
    replay_floor: Float[np.ndarray, " n"]
    """And of the replay's, which is at positions that are off by theirs."""


class Fan(NamedTuple):
    """Replays of one run by draws of the corrected robot."""

    low: Float[np.ndarray, "T n"]
    """5 % of the draws' positions are below it [rad]."""
    high: Float[np.ndarray, "T n"]
    """5 % of the draws' positions are above it [rad]."""
    errors: Float[np.ndarray, " D"]
    """Of each draw, rms over joints and samples that count [rad]."""


OTHER_RUN = "the test log"
"""What a replayed test log is called."""


@dataclasses.dataclass(frozen=True, eq=False)
class Replayed:
    """Replays of the test rows: of the model as given and of the corrected file, each in its own steps."""

    records: tuple[Record, ...]
    nominal: tuple[np.ndarray, ...]
    """Positions (T, n) of each run."""
    corrected: tuple[np.ndarray, ...]
    floor: Float[np.ndarray, " n"]
    of: str
    """Which: "the test log", "the last part of the log" or "the last parts of the logs"."""
    fan: Fan | None = None
    """Of the shown run, where anything was changed."""
    torques: Torques | None = None
    """Where they are logged."""

    def error(self, paths: tuple[np.ndarray, ...]) -> Float[np.ndarray, " n"]:
        """Of replays at each joint, rms over all that counts [rad]."""
        parts = [(p - r.q)[r.settled] for p, r in zip(paths, self.records, strict=True)]
        return rms(np.concatenate(parts))

    @property
    def before(self) -> Float[np.ndarray, " n"]:
        """Error of the nominal model at each joint, rms [rad]."""
        return self.error(self.nominal)

    @property
    def after(self) -> Float[np.ndarray, " n"]:
        """Error of the corrected model at each joint, rms [rad]."""
        return self.error(self.corrected)

    @property
    def shown(self) -> int:
        """The run that the nominal model misses most."""
        return int(
            np.argmax(
                [np.sum((p - r.q) ** 2) for p, r in zip(self.nominal, self.records, strict=True)]
            )
        )


def rms(error: Float[np.ndarray, "*b T n"]) -> Float[np.ndarray, "*b n"]:
    """Root mean square along time."""
    return np.sqrt(np.mean(error**2, axis=-2))


def total(per_joint: Float[np.ndarray, " n"]) -> float:
    """Root mean square over joints."""
    return float(np.sqrt(np.mean(per_joint**2)))


@dataclasses.dataclass(frozen=True, eq=False)
class Correction:
    """What is handed over: every number of loop and joints as the model has it and as it is put in its place."""

    names: tuple[str, ...]
    loop: Loop
    numbers: Numbers
    in_file: Numbers
    """The same as a file holds them (`file_form`)."""
    original: Numbers
    friction: Float[np.ndarray, " n"]
    """Dry friction's mean along the fitted runs [N m], which is what a file has of one that varies."""
    holds: bool
    """Whether dry friction holds a joint at rest; else it creeps there, as MuJoCo's own does."""
    pairs: Sequence[tuple[int, int]] = ()
    """Joints that follow each other in a chain."""


class Resemblance(NamedTuple):
    """What a joint's remaining replay error is like."""

    joint: str
    shape: str
    """The generic form that goes with it best; empty where none goes with a tenth of it."""
    share: float
    """Of the remaining error's variance, what that shape takes."""
    frequency: float
    """At which most of it is [Hz]."""

    def __str__(self) -> str:
        like = f"{self.shape} ({100 * self.share:.0f} %)" if self.shape else "no generic shape"
        return f"{self.joint}: {like}, mostly at {self.frequency:.2g} Hz"


@dataclasses.dataclass(frozen=True, eq=False)
class Diagnosis:
    """Verdict, effects, every joint's numbers, and the replays that prove or disprove them."""

    verdict: Verdict
    log_odds: float
    """That the verdict is right, before calibration [nats]."""
    headline: str
    effects: tuple[Effect, ...]
    everything: Fit
    """All ordinary numbers at once, with their intervals: what is known of each joint, listed as an effect or not."""
    found: Fit
    """Those that are needed, the others at the nominal model's."""
    correction: Correction
    """What is handed over."""
    text: str
    """The corrected model's file, whose replays `replayed` has."""
    changes: tuple[Change, ...]
    """Every number of the model that it changes, read back."""
    clock: tuple[tuple[str, Size], ...]
    """What of it is the loop's clock and no gap."""
    replayed: Replayed
    discrepancy: Float[np.ndarray, " n"]
    """What no number of the model can take up of each joint's error, as it is stated, rms [rad]."""
    left: tuple[Left, ...]
    """Joints whose replay still errs by more than is explained."""
    resembles: tuple[Resemblance, ...]
    """What the remainder of each of them is like."""
    impossible: tuple[str, ...]
    """Why the numbers cannot be, taken together."""
    worse: tuple[str, ...]
    """Joints that the corrected model replays worse than the nominal one."""
    notes: tuple[str, ...]
    draws: Draws | None = None
    """Of the corrected robot; none where nothing but a clock was changed."""

    @property
    def confidence(self) -> float:
        """Calibrated probability that the verdict is right."""
        return confidence(self.log_odds)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the log's joints."""
        return self.correction.names

    @property
    def loop(self) -> Loop:
        """As it is said to be."""
        return self.correction.loop

    @property
    def numbers(self) -> Numbers:
        """Of every joint of the corrected model."""
        return self.correction.numbers

    @property
    def holds(self) -> bool:
        """Whether dry friction holds a joint at rest."""
        return self.correction.holds
