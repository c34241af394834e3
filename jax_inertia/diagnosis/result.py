"""What a diagnosis of the whole robot found."""

import dataclasses
import enum

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Interval, Parameter, Place
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
    probability: float
    """That it, or one that it is tied with, is there."""
    equivalent: tuple[Tie, ...]
    ordinary: bool
    equation: str
    explained_heldout: float = 0.0
    """`share` on held-out stretches, by numbers that were fitted to the others."""

    @property
    def sizes(self) -> str:
        """Every parameter with its 95 % interval."""
        return ", ".join(
            f"{name} {p.value:.4g} [{p.low:.4g}, {p.high:.4g}]{unit(p.unit)}"
            for name, p in self.parameters.items()
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
class Shrink:
    """Residual torque of moving rows on a run that played no part [N m, rms]."""

    before: float
    ordinary: float
    after: float
    noise: float
    per_joint: dict[str, tuple[float, float]]
    """Before and after."""
    interval: tuple[float, float] = (0.0, 1.0)
    """95 % interval of `share`, stretches of the run drawn again (block bootstrap; Künsch, Ann. Stat. 17(3), 1989)."""

    @property
    def share(self) -> float:
        """By how much the rms shrinks."""
        return 1.0 - self.after / max(self.before, 1e-300)


@dataclasses.dataclass(frozen=True)
class Remainder:
    """What no effect explains, on the run that played no part."""

    share: float
    """Of the gap's energy, the sensors' noise taken off."""
    where: dict[str, float]
    """Each joint's part of it, and of shapes that name no cause, summing to one."""
    resembles: tuple[str, ...]
    """Shapes that name no cause, and effects that only stand in for one, that fit it."""
    after: float
    """Residual that the causes leave on that run, rms of moving rows [N m]; with such shapes it is `Shrink.after`."""


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
class Diagnosis:
    """Verdict, effects, the ordinary physics of every joint, and the remainder."""

    verdict: Verdict
    confidence: float
    headline: str
    found: tuple[Found, ...]
    joints: dict[str, dict[str, Interval]]
    """By joint and family: the joint's whole number, the model's own included; found or not."""
    presliding: dict[str, float]
    """Displacement over which each joint's dry friction turns round [rad]."""
    as_bought: float
    """Log odds that the model lacks its joints' ordinary physics, against one that is calibrated [nats]."""
    heldout: Shrink
    test: Shrink | None
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
        where, s = "held out" if self.test is None else "other motion", self.checked
        return f"{where}: {s.before:.3g} → {s.after:.3g} N m (noise {s.noise:.3g})"

    @property
    def odd(self) -> tuple[Found, ...]:
        """Effects beyond those that every robot has."""
        return tuple(f for f in self.found if not f.ordinary)

    @property
    def checked(self) -> Shrink:
        """On the other run where there is one, on held-out stretches where not."""
        return self.heldout if self.test is None else self.test

    def __repr__(self) -> str:
        lines = [f"{self.verdict} (confidence {self.confidence:.2f})", f"  {self.headline}"]
        lines += [f"  {f!r}" for f in self.found]
        lines.append(f"  {self._shrinks()}")
        return "\n".join(lines)
