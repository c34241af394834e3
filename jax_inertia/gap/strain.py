"""What a misfit as small as noise may hide: errors of the model beyond its tolerances, and slow motion (`slow`).

The nominal model's tolerances are integrated out (`evidence`), and one of many columns may be bent far at a price that
a whole log hardly feels: an armature 70 % off costs no more than noise does. So what the log wants each number of the
model to be, z = Λ² Nᵀ (1 + N Λ² Nᵀ)⁻¹ (y − A θ) with its posterior error, is held against the tolerance stated.
"""

import dataclasses
from collections.abc import Callable, Collection

import numpy as np
from jaxtyping import Float

from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.slow import Slow

# Above this multiple of the noise's own misfit, something is there even where nothing in the library fits it.
NOISE_ONLY = 2.0
# A number of the model that has to be this many times its tolerance off is not within it.
STRAINED = 4.0
# Of that border, a number counts for no less that is off while all others of its kind are right.
STANDS_OUT = 1.5


@dataclasses.dataclass(frozen=True)
class Strained:
    """A number of the nominal model that the log wants further off than its tolerance allows."""

    column: int
    """Which of the tolerances (`Evidence.tolerances`)."""
    name: str
    off: float
    """How far, in tolerances."""
    error: float
    """One standard deviation of that."""
    energy: float
    """Misfit that the error would leave if it were not granted."""

    def __str__(self) -> str:
        return f"{self.name} off by {self.off:.1f} ± {self.error:.1f} times its tolerance"


@dataclasses.dataclass(frozen=True)
class Left:
    """What effects leave of a log's missing torque, in the charged metric of its evidence."""

    evidence: Evidence
    torque: Float[np.ndarray, " n"]

    def deviations(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`Evidence.deviations`, no kind of number held tighter than was stated.

        A kind that the log finds right to a thirtieth would hold on to its one number that is not.
        """
        own = self.evidence
        stated = own.rescaled({kind: max(scale, 1.0) for kind, scale in own.scales.items()})
        return stated.deviations(stated.recharging(own)(self.torque[:, None])[:, 0])


def strained(
    left: Left, alone: Collection[int] = (), again: Callable[[], Left] | None = None
) -> list[Strained]:
    """The numbers of the model that are strained by what effects leave, the furthest first.

    `alone`: columns of tolerances whose numbers are off while the others of their kind are right. `again`: the same of
    the log with its sensors' noise added once more. A floating base's accelerations are as noisy in the columns as in
    what is missing, so a number comes out too small by the noise's share; where twice the noise makes it so much less,
    none would make it as much more (SIMEX; Cook & Stefanski 1994).
    """
    off, error, size = left.deviations()

    def beyond(off: np.ndarray, error: np.ndarray) -> list[int]:
        # By more than the log can be wrong about it: a direction that it hardly sees may lie anywhere.
        return np.flatnonzero(np.abs(off) > STRAINED + 2 * error).tolist()

    out = beyond(off, error)
    if out and again is not None:
        steady = beyond(2 * off - again().deviations()[0], np.sqrt(2) * error)
        out = [j for j in out if j in steady]
    named = left.evidence.named
    every = [
        Strained(j, named[j], abs(float(off[j])), float(error[j]), float((off[j] * size[j]) ** 2))
        for j in {*out, *alone}
    ]
    return sorted(every, key=lambda x: -x.off)


@dataclasses.dataclass(frozen=True)
class Strangeness:
    """What a log shows without any effect, each number against the border above which something is there."""

    misfit: float
    slow: float
    """Of the loudest row, in the motion's own band."""
    strain: float

    @property
    def most(self) -> float:
        """Above one, the sensors' noise and the model's tolerances are not all there is."""
        return max(self.misfit, self.slow, self.strain)


def strangeness(slow: Slow, floor: float, strains: list[Strained]) -> Strangeness:
    """Of the missing torque as it is; `floor` is the noise's misfit, `strains` by the missing torque, `strained`."""
    y = slow.evidence.y
    return Strangeness(
        float(y @ y) / (NOISE_ONLY * slow.slack * floor),
        slow.bare,
        max(STANDS_OUT, strains[0].off / STRAINED) if strains else 0.0,
    )
