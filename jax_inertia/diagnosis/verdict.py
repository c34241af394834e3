"""One meaning of the verdict, by torque and by replays: a table of errors on rows that no number was fitted to.

Each output j (a joint's torque or its replayed position) that moves is judged by itself, by rms errors:

| quantity | meaning |
|---|---|
| f | floor: noise of the sensors, and nothing else; what a fit could take up, such as a clock, is none of it |
| b, a | error of the model as given, and of the corrected one as it was written to its files and read back |
| d | what the equations' stated errors and numbers that the log leaves open add to either; 0 where none are stated |

| condition | verdict |
|---|---|
| no effect is named, nothing stands against it, and b ≤ 1.5 √(f² + d²) at every output of every run | no_gap |
| one is, nothing stands against it, and at every output a ≤ 1.5 f, or a ≤ 1.5 √(f² + d²) and a ≤ 0.1 b | explained |
| else: one is, and Σ max(a² − f², 0) / f² < Σ max(b² − f², 0) / 2 f² | partly |
| else | unknown |

Of an output whose b ≤ 1.5 f there is nothing that a tenth might be of: there a ≤ 1.5 √(f² + d²) is enough.
The model as given has its numbers where they fit within its stated tolerances, and a position loop's clock likewise.
Against a verdict stand numbers that are not possible together, numbers of the model beyond its tolerances (against
no_gap), one more effect that is more likely there than not, and a remainder that is distinct and has no name.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.diagnosis.result import Verdict

FLOORS = 1.5
"""Times the floor that an error may be and still show nothing. Decision."""
NEARLY = 0.1
"""Of the error of the model as given, what a stated discrepancy may leave of it at most. Decision."""
HALF = 0.5
"""Of the gap's energy, what may remain of a gap that is explained in part. Decision."""


@dataclasses.dataclass(frozen=True, eq=False)
class Errors:
    """Errors on rows that no number was fitted to, rms of each of m outputs, in the output's own unit."""

    names: tuple[str, ...]
    floor: Float[np.ndarray, " m"]
    before: Float[np.ndarray, " m"]
    after: Float[np.ndarray, " m"]
    moves: Bool[np.ndarray, " m"]
    """Outputs that are judged; what rests shows nothing."""
    discrepancy: Float[np.ndarray, " m"]

    def as_given(self) -> "Errors":
        """Of a corrected model that is the one given, with numbers moved within its tolerances."""
        return dataclasses.replace(self, before=self.after)

    @property
    def quiet(self) -> Bool[np.ndarray, " m"]:
        """Where the model as given shows no gap, or the output rests."""
        return (self.before <= self.silence) | ~self.moves

    @property
    def silence(self) -> Float[np.ndarray, " m"]:
        """Up to what error the model as given shows no gap."""
        return FLOORS * np.hypot(self.floor, self.discrepancy)

    @property
    def done(self) -> Bool[np.ndarray, " m"]:
        """Where the corrected model leaves nothing that is to be explained, or the output rests."""
        return (self.after <= self.limit) | ~self.moves

    @property
    def limit(self) -> Float[np.ndarray, " m"]:
        """Up to what error the corrected model leaves nothing that is to be explained."""
        own = FLOORS * self.floor
        # Of an output at which the model as given shows no gap, there is nothing that a share might be of.
        most = np.where(self.before <= own, self.silence, NEARLY * self.before)
        return np.maximum(own, np.minimum(self.silence, most))

    @property
    def unexplained(self) -> float:
        """Share of the gap's energy that is left, each output in units of its own floor; 1 where there is no gap."""
        unit = np.maximum(self.floor, 1e-300)
        gap, rest = (
            np.sum(np.maximum((x / unit) ** 2 - 1.0, 0.0)[self.moves])
            for x in (self.before, self.after)
        )
        return float(rest / gap) if gap > 0 else 1.0


@dataclasses.dataclass(frozen=True)
class Left:
    """The remainder of one output."""

    name: str
    after: float
    floors: float
    """`after` over the floor."""
    share: float
    """`after` over the error of the model as given."""


@dataclasses.dataclass(frozen=True)
class Judgement:
    """A verdict, and what stands against `explained`."""

    verdict: Verdict
    left: tuple[Left, ...]
    """Outputs at which something is left, the farthest beyond its floor first."""
    against: tuple[str, ...]
    """What stands against `no_gap` and `explained` whatever the errors are, one sentence each."""


def judged(errors: Errors, named: bool, against: Sequence[str] = ()) -> Judgement:
    """The verdict of the table above; `named`: an effect is, with a place and a size.

    >>> import numpy as np
    >>> floor, moves = np.array([1.0, 1.0]), np.array([True, True])
    >>> at = Errors(("hip", "knee"), floor, np.array([9.0, 40.0]), np.array([1.1, 12.0]), moves, 0 * floor)
    >>> found = judged(at, named=True)
    >>> str(found.verdict), found.left[0].name
    ('partly', 'knee')
    """
    if not named and np.all(errors.quiet) and not against:
        return Judgement(Verdict.NO_GAP, (), ())
    floors = errors.after / np.maximum(errors.floor, 1e-300)
    shares = errors.after / np.maximum(errors.before, 1e-300)
    left = tuple(
        Left(errors.names[j], float(errors.after[j]), float(floors[j]), float(shares[j]))
        for j in np.argsort(-floors).tolist()
        if not errors.done[j]
    )
    if named and not left and not against:
        return Judgement(Verdict.EXPLAINED, (), ())
    part = named and errors.unexplained < HALF
    verdict = Verdict.PARTLY if part else Verdict.UNKNOWN
    return Judgement(verdict, left, tuple(against))


def joined(runs: Sequence[Errors]) -> Errors:
    """The outputs of several runs, side by side."""
    return Errors(
        tuple(n for e in runs for n in e.names),
        np.concatenate([e.floor for e in runs]),
        np.concatenate([e.before for e in runs]),
        np.concatenate([e.after for e in runs]),
        np.concatenate([e.moves for e in runs]),
        np.concatenate([e.discrepancy for e in runs]),
    )
