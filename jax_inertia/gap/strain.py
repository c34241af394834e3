"""What a misfit as small as noise may hide: errors of the model beyond its tolerances, and slow motion in fast noise.

The nominal model's tolerances are integrated out (`evidence`), and one of many columns may be bent far at a price that
a whole log hardly feels: an armature 70 % off costs no more than noise does. So what the log wants each number of the
model to be, z = Λ² Nᵀ (1 + N Λ² Nᵀ)⁻¹ (y − A θ) with its posterior error, is held against the tolerance stated. What
is missing at the motion's own few frequencies is held against the noise there, row by row, not against all of it.
"""

import dataclasses
from collections.abc import Callable, Collection

import numpy as np
from jaxtyping import Float

from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.noise import NOISE_ERROR

# Above this multiple of the noise's own misfit, something is there even where nothing in the library fits it.
NOISE_ONLY = 2.0
# In the motion's own band: twice the log of the odds that a row is louder than noise, as an effect must bring them.
SLOWLY = 30.0
# A number of the model that has to be this many times its tolerance off is not within it.
STRAINED = 4.0
# Of that border, a number counts for no less that is off while all others of its kind are right.
STANDS_OUT = 1.5
# Where the log does not state its noise and what is left is not at random, a motor may have missed its command by more
# than the log can show.
NOISE_UNSTATED = 4.0


def known_to(known: bool) -> float:
    """The factor to which a log's noise is known, by whether it is stated or found to be what it was taken for."""
    return NOISE_ERROR if known else NOISE_UNSTATED


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


def strangeness(
    evidence: Evidence,
    replicas: Float[np.ndarray, "K R nv"],
    floor: float,
    known: bool,
    strains: list[Strained],
) -> Strangeness:
    """Of the missing torque as it is; `floor` is the noise's misfit, `known` whether that can be relied on.

    `strains`: by the missing torque, `strained`.
    """
    y = evidence.y
    slack = known_to(known) / NOISE_ERROR
    return Strangeness(
        float(y @ y) / (NOISE_ONLY * slack * floor),
        _slowly(evidence, replicas, slack) / (SLOWLY + 2 * np.log(evidence.used.shape[1])),
        max(STANDS_OUT, strains[0].off / STRAINED) if strains else 0.0,
    )


def _slowly(evidence: Evidence, replicas: Float[np.ndarray, "K R nv"], slack: float) -> float:
    """Evidence that the loudest row is no noise in the motion's own band, d (r − 1 − ln r): twice the log of the odds.

    Whitened noise has one unit in each of a row's d numbers there, and the row has r times as much. Row by row, since
    a gap at one joint of many is little beside the noise of all.
    """

    def energies(x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " nv"]:
        slow = evidence.slow(x[:, None]).reshape(evidence.slow_modes, -1)
        return np.sum(slow**2, axis=0)

    noise = np.mean([energies(evidence.charged(x)) for x in replicas], axis=0)
    seen = noise > 0
    louder = np.maximum(energies(evidence.y)[seen] / (slack * noise[seen]), 1.0)
    return float(np.max(noise[seen] * (louder - 1 - np.log(louder)), initial=0.0))
