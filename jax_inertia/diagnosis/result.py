"""What a diagnosis of the whole robot found."""

import dataclasses
import enum

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Effect, Interval, Parameter, Place
from jax_inertia.diagnosis.effects.identified import Identified
from jax_inertia.diagnosis.friction_curve import FrictionCurve
from jax_inertia.model.model_errors import NO_ERRORS, NamedErrors
from jax_inertia.model.mujoco_types import MjSpec
from jax_inertia.text.notebook_page import line, table
from jax_inertia.text.words import at, chance, plain, unit


class Verdict(enum.StrEnum):
    """What can be said of the gap."""

    EXPLAINED = "explained"
    PARTLY = "partly"
    UNKNOWN = "unknown"
    NO_GAP = "no_gap"


@dataclasses.dataclass(frozen=True)
class Tie:
    """Another effect that this log cannot tell from the one given."""

    family: str
    place: Place
    kind: str
    """'exact' where no motion of this robot can, 'motion_limited' where another motion would."""


@dataclasses.dataclass(frozen=True)
class Found:
    """One effect that the model lacks."""

    family: str
    place: Place
    parameters: dict[str, Interval]
    share: float
    """Of the gap's energy in N² m²: what returns when it alone is left out."""
    evidence: float
    """Log evidence that it brings, prior odds taken off, nats."""
    log_odds: float
    """That it, or one that it is tied with, is there, as the search has it: before calibration [nats]."""
    probability: float
    """The same, calibrated (`calibration.json`)."""
    equivalent: tuple[Tie, ...]
    ordinary: bool
    equation: str
    handed_over: bool = True
    """Whether corrected.xml and the friction laws have it: not where they predict held-out rows better without it."""
    explained_heldout: float = 0.0
    """`share` on held-out rows, by numbers that were fitted to the others."""

    @property
    def sizes(self) -> str:
        """Every parameter with its 95 % interval, the model's own number included."""
        return ", ".join(
            f"{name} {w.value:.4g} [{w.low:.4g}, {w.high:.4g}]{unit(p.unit)}{p.of_model}"
            for name, p, w in ((name, p, p.whole) for name, p in self.parameters.items())
        )

    @property
    def ties(self) -> str:
        """What this log cannot tell it from."""
        return ", ".join(f"{t.family}{at(t.place)}" for t in self.equivalent)

    @property
    def cells(self) -> tuple[str, ...]:
        """A row of a table: effect, equation, place, sizes, probability, ties."""
        name, sure = plain(self.family), chance(self.probability)
        return name, self.equation, self.place.name, self.sizes, sure, self.ties

    def __repr__(self) -> str:
        ties = f"; or {self.ties}" if self.equivalent else ""
        return f"{self.family}{at(self.place)}: {self.sizes}{ties}"


@dataclasses.dataclass(frozen=True)
class NotListed:
    """An effect that may be there and is not listed."""

    family: str
    place: Place
    log_odds: float
    """Before calibration [nats]."""
    probability: float


@dataclasses.dataclass(frozen=True)
class Shrink:
    """Torque error of the files as written on a run, rms over the rows in which a joint moves [N m].

    On held-out rows: numbers of the other rows, and what the files lose of the fit.
    """

    before: float
    ordinary: float
    after: float
    noise: float
    per_joint: dict[str, tuple[float, float]]
    """Before and after."""
    interval: tuple[float, float] = (0.0, 1.0)
    """95 % interval of `share`, stretches of the run drawn again (block bootstrap; Künsch, Ann. Stat. 17(3), 1989)."""
    least_squares: float | None = None
    """By plain least squares of four terms a joint (`baseline`)."""

    @property
    def share(self) -> float:
        """By how much the rms shrinks."""
        return 1.0 - self.after / max(self.before, 1e-300)


@dataclasses.dataclass(frozen=True)
class Remainder:
    """What no effect explains, on the run that was checked."""

    share: float
    """Of the gap's energy, the sensors' noise taken off."""
    where: dict[str, float]
    """Each joint's part of it, and of shapes that name no cause, summing to one."""
    resembles: tuple[str, ...]
    """Shapes that name no cause, and effects that only stand in for one, that fit it."""
    with_shapes: float
    """Residual of that run with such shapes too, which no file holds, rms of moving rows [N m]."""


@dataclasses.dataclass(frozen=True, eq=False)
class Trace:
    """Torque residual of the checked run along time, for figures: R rows of n."""

    time: Float[np.ndarray, " R"]
    before: Float[np.ndarray, "R n"]
    after: Float[np.ndarray, "R n"]
    moving: Float[np.ndarray, "R n"]
    """Weight of each row: 0 where it rests."""
    rows: tuple[str, ...]
    state: dict[str, Float[np.ndarray, "R n"]]
    """Each row's position, velocity and logged torque: q, v, tau."""


@dataclasses.dataclass(frozen=True, eq=False)
class Region:
    """Where in a signal of one row the gap's energy lies."""

    row: str
    signal: str
    """'q', 'v' or 'tau'."""
    edges: Float[np.ndarray, " E"]
    """Quintiles of the signal over the log."""
    share: Float[np.ndarray, " B"]
    """Of the row's energy above noise, by quintile: 0.2 each where the signal does not matter."""


@dataclasses.dataclass(frozen=True)
class BodyForce:
    """The torque residual projected back to one body as a world force at its centre of mass."""

    body: str
    share: float
    """Of the gap's energy, what a force that is constant over half a second explains; 0 for no more than chance."""
    peak: float
    """Largest force of any half second [N]."""


@dataclasses.dataclass(frozen=True)
class Correction:
    """A nominal model with effects added."""

    spec: MjSpec
    in_model: tuple[Identified, ...]
    """Done by attributes alone."""
    by_callback: tuple[Identified, ...]
    """Need `step_law`, at least for torques given by `qfrc_applied`."""
    outside: tuple[Identified, ...]
    """Of sensors, or without a law: neither in the model nor done before a step."""
    notes: tuple[str, ...]
    extra: tuple[Effect, ...] = ()
    """Effects of a user's own among them."""

    @property
    def effects(self) -> tuple[Identified, ...]:
        """All of them."""
        return (*self.in_model, *self.by_callback, *self.outside)


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """Verdict, effects, the ordinary physics of every joint, and the remainder."""

    verdict: Verdict
    confidence: float
    """Probability that the verdict is right, calibrated."""
    log_odds: float
    """The same as the search has it: log odds before calibration [nats]."""
    headline: str
    found: tuple[Found, ...]
    joints: dict[str, dict[str, Interval]]
    """By joint and family: the joint's whole number, the model's own included; found or not."""
    presliding: dict[str, float]
    """Displacement over which each joint's dry friction turns round [rad]."""
    friction: dict[str, FrictionCurve]
    """Each joint's whole friction law, mild forms that name no cause included."""
    as_bought: float
    """Log odds that the model lacks its joints' ordinary physics, against one that is calibrated [nats]."""
    heldout: Shrink
    """On the log itself, each part of a joint's range predicted from the others: the same motion, so it may flatter."""
    validation: Shrink | None
    """On a run that choices were made by, and no numbers fitted to."""
    test: Shrink | None
    """On a run that nothing depends on."""
    remainder: Remainder
    chi2: float
    noise_floor: float
    per_joint_rms: dict[str, float]
    share: dict[str, float]
    inertials: dict[str, tuple[float, ...]]
    """Bodies' calibrated parameters π, errors within the model's tolerances taken out."""
    notes: tuple[str, ...]
    trace: Trace
    units: dict[str, str]
    """Of each row's torque: N m, or N of a slide."""
    regions: tuple[Region, ...] = ()
    """Of the row with the largest gap: at which positions, velocities and torques the gap lies."""
    forces: tuple[BodyForce, ...] = ()
    """What a force on each body would explain, the most telling first."""
    when: tuple[tuple[float, float], ...] = ()
    """Stretches [s] of the log in which the torque residual stands out."""
    gains: dict[str, Interval] = dataclasses.field(default_factory=dict)
    """Of each joint whose motor's gain is found or uncertain: torque at the joint over the logged one."""
    undetectable_below: tuple[tuple[str, Place, Parameter], ...] = ()
    """Family, place and smallest size of odd effects that this log would have shown."""
    speed: dict[str, float] = dataclasses.field(default_factory=dict)
    """Fastest usual speed of each row in this log, its 99th percentile [rad/s; m/s]."""
    drive_gains: dict[str, float] = dataclasses.field(default_factory=dict)
    """Of each joint whose torque was logged in another unit: N m for one unit, as the log was read."""
    not_listed: tuple[NotListed, ...] = ()
    """What else may be there, the likeliest first."""
    corrected: Correction | None = None
    """The model as corrected.xml has it."""
    errors: NamedErrors = NO_ERRORS
    """What the log leaves open of the corrected model's inertials and of its joints' numbers, all together."""

    def _repr_html_(self) -> str:
        """For notebooks: the verdict in words, the effects as a table, how far the gap shrinks."""
        verdict = f"{plain(str(self.verdict))} (confidence {chance(self.confidence)})"
        out = line(verdict, strong=True) + line(self.headline)
        if self.found:
            head = ("effect", "equation", "where", "size, 95 % interval", "probability", "or")
            out += table(head, (f.cells for f in self.found))
        return out + line(self._shrinks()) + "".join(line(note) for note in self.notes)

    def _shrinks(self) -> str:
        """How far the residual shrinks on the run that played no part."""
        s = self.checked
        return f"{self.checked_on}: {s.before:.3g} → {s.after:.3g} N m (noise {s.noise:.3g})"

    @property
    def odd(self) -> tuple[Found, ...]:
        """Effects beyond those that every robot has."""
        return tuple(f for f in self.found if not f.ordinary)

    @property
    def checked(self) -> Shrink:
        """On the test run where there is one, else on the validation run, else on held-out rows."""
        return self.test or self.validation or self.heldout

    @property
    def checked_on(self) -> str:
        """What run that is, in words."""
        if self.test is not None:
            return "other motion"
        return "held out" if self.validation is None else "validation motion"

    def __repr__(self) -> str:
        lines = [f"{self.verdict} (confidence {self.confidence:.2f})", f"  {self.headline}"]
        lines += [f"  {f!r}" for f in self.found]
        lines.append(f"  {self._shrinks()}")
        return "\n".join(lines)
