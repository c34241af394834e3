"""What a diagnosis found, and how it reads in a console and in a notebook."""

import dataclasses

from jax_inertia.diagnosis.effects.base import Interval, Parameter, Place
from jax_inertia.diagnosis.effects.identified import Identified
from jax_inertia.diagnosis.simulate.plant import Erring
from jax_inertia.diagnosis.simulate.rollout import Known
from jax_inertia.gap.energies import Shrink
from jax_inertia.gap.motors import with_torque_noise
from jax_inertia.gap.trace import Trace
from jax_inertia.gap.verdict import Verdict
from jax_inertia.logs.log import Log
from jax_inertia.model.robot import Robot
from jax_inertia.text.notebook_page import line, table
from jax_inertia.text.words import at, chance, length, named, number, percent, plain, unit


@dataclasses.dataclass(frozen=True)
class Tie:
    """Another explanation that this log cannot tell from the one given."""

    family: str
    place: Place
    kind: str
    """'exact' where no motion of this robot can, 'motion_limited' where another motion would."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """One effect that the model lacks."""

    family: str
    place: Place
    parameters: dict[str, Interval]
    explained: float
    """Share of the gap's excess energy that goes with it, on held-out stretches of the log."""
    probability: float
    equivalent: tuple[Tie, ...]
    equation: str = ""
    """The family's torque, as text."""

    @property
    def sizes(self) -> tuple[str, ...]:
        """Every parameter with its 95 % interval; one that only says where something is has none."""
        return tuple(
            f"{name} {p.value:.4g} [{p.low:.4g}, {p.high:.4g}]{unit(p.unit)}"
            if p.low < p.high
            else f"{name} {p.value:.4g}"
            for name, p in self.parameters.items()
        )

    @property
    def rivals(self) -> str:
        """What this log cannot tell it from."""
        return ", ".join(f"{t.family}{at(t.place)} ({t.kind})" for t in self.equivalent)

    def __repr__(self) -> str:
        or_else = f"; or {self.rivals}" if self.equivalent else ""
        return f"{self.family}{at(self.place)}: {', '.join(self.sizes)}{or_else}"


# Of several that a log cannot tell apart the first one is hardly in doubt from this probability.
SURE = 0.9
# Effects that explain less than this share of a gap are not near it.
NOTHING = 0.05


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found."""

    verdict: Verdict
    confidence: float
    chi2: float
    """Whitened energy per sample before anything is explained; about one without a gap."""
    noise_floor: float
    per_joint_rms: dict[str, float]
    share: dict[str, float]
    findings: tuple[Finding, ...]
    heldout: Shrink
    test: Shrink | None
    when: tuple[tuple[float, float], ...]
    undetectable_below: tuple[tuple[str, Place, Parameter], ...]
    notes: tuple[str, ...]
    """Of the log."""
    doubts: tuple[str, ...]
    """Why what was found is not, or not all of, the cause: what the log says of one that is not in the library."""
    trace: Trace

    @property
    def unit(self) -> str:
        """Of what is missing, over the joints that hold the gap."""
        told = zip(self.trace.rows, self.trace.units, strict=True)
        joints = {x for k, (row, x) in enumerate(told) if k in self.trace.gap and "[" not in row}
        return " and ".join(sorted(joints, reverse=True)) or "N m"

    @property
    def headline(self) -> str:
        """The verdict in one or two sentences."""
        if self.verdict is Verdict.NO_GAP:
            return "No gap: model and robot agree within the sensors' noise and what a good model may be off by."
        where = max(self.share, key=lambda name: self.share[name])
        explained = sum(f.explained for f in self.findings)
        if not self.findings or (self.verdict is Verdict.UNKNOWN and explained < NOTHING):
            return f"Something is missing, mostly at {where}, but no effect in the library explains it."
        names = [_named(f) for f in self.findings]
        every = names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
        them = "it" if len(names) == 1 else "them"
        shrink = f"With {them}, the missing torque {self._shrunk()}."
        if self.verdict is Verdict.EXPLAINED:
            return f"The model lacks {every}. {shrink}"
        if self.verdict is Verdict.PARTLY:
            return f"The model lacks {every}, and something more that was not found. {shrink}"
        nearest = (
            f"effect is {every}, but it does"
            if len(names) == 1
            else f"effects are {every}, but they do"
        )
        return (
            f"Something is missing, mostly at {where}, that no effect in the library explains. The nearest {nearest} "
            "not fit the data."
        )

    @property
    def certainty(self) -> str:
        """How sure the verdict is, in words."""
        tied = self.verdict is not Verdict.UNKNOWN and bool(
            self.findings and self.findings[0].equivalent
        )
        told = " that it is the first of those that this log cannot tell apart"
        return (
            f"confidence {chance(self.confidence)}{told if tied and self.confidence < SURE else ''}"
        )

    def __repr__(self) -> str:
        lines = [f"{self.verdict} (confidence {self.confidence:.2f})"]
        lines += [f"  {f!r}" for f in self.findings]
        lines += [f"  {name}: {text}" for name, text in self._shrinks()]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """For notebooks: the verdict in words, doubts about it, the effects as a table, how far the gap shrinks."""
        verdict = f"{plain(str(self.verdict))} ({self.certainty})"
        out = line(verdict, strong=True) + line(self.headline)
        out += "".join(line(doubt) for doubt in self.doubts)
        if self.findings:
            head = ("effect", "equation", "where", "size, 95 % interval", "explains", "or")
            out += table(
                head,
                (
                    (
                        plain(f.family),
                        f.equation,
                        f.place.name,
                        "; ".join(f.sizes),
                        percent(f.explained),
                        f.rivals,
                    )
                    for f in self.findings
                ),
            )
        return out + "".join(line(f"{name}: {text}") for name, text in self._shrinks())

    def _shrunk(self) -> str:
        """By how much, where it was above its floor to begin with."""
        tried = (("held-out data", self.heldout), ("another motion", self.test))
        shares = [(where, s.share) for where, s in tried if s is not None]
        by = [f"by {percent(share)} on {where}" for where, share in shares if share is not None]
        still = [f"on {where}" for where, share in shares if share is None]
        parts = ["shrinks " + " and ".join(by)] if by else []
        parts += ["was at its floor before " + " and ".join(still)] if still else []
        return ", and ".join(parts)

    def _shrinks(self) -> list[tuple[str, str]]:
        """Missing torque before and after, where it was predicted rather than fitted."""
        tried = (("held out", self.heldout), ("other motion", self.test))
        return [
            (name, f"{s.before:.3g} → {s.after:.3g} {self.unit} (floor {s.noise:.3g})")
            for name, s in tried
            if s is not None
        ]


def effects_of(found: Diagnosis) -> tuple[Identified, ...]:
    """The findings of a diagnosis as numbers alone, the most important first."""
    return tuple(
        Identified(
            f.family,
            f.place.kind,
            f.place.name,
            {k: p.value for k, p in f.parameters.items()},
            f.place.other,
        )
        for f in found.findings
    )


def known_of(found: Diagnosis, robot: Robot, log: Log) -> Known:
    """What rollouts of the log need to know, with the findings."""
    trace = found.trace
    loud = with_torque_noise(log, robot, trace.torque_noise)
    return Known(trace.turning, Erring(trace.time, trace.erring), loud)


def _named(f: Finding) -> str:
    """Effect, place and the first of its numbers; of a vector's, its length."""
    first = next(iter(f.parameters.values()), None)
    if first is None:
        return named(f.family, f.place)
    vector = length(f.parameters)
    size = first.value if vector is None else vector
    times = "× " if first.factor else ""
    return f"{named(f.family, f.place)} ({times}{number(size)}{unit(first.unit)})"
