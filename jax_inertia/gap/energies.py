"""How large the missing torque is before and after, against a floor that no effect removes.

It is measured on the rows that hold the gap, where others add but noise, and on the samples that effects and the
model's errors are fitted to (`Evidence.used`): next to rest, the filters carry friction that no model predicts. The
floor is the sensors' noise and the energy that goes with the nominal model's own errors, as a log most likely has them,
when they are taken out of what is left.

Frequencies that the motion does not have add noise and little else, which hides a gap that is plain below them: what is
summed is the motion's own band, unless the gap lies above it.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.fft
import scipy.stats
from jaxtyping import Bool, Float

# Of the floor: a gap below this is mostly the floor's own.
NEAR = 1.2
# A row holds the gap that has this share of it.
HOLDING = 0.02


def shares(excess: Float[np.ndarray, " nv"]) -> Float[np.ndarray, " nv"]:
    """What each row has of the gap, by its energy above the noise's."""
    excess = np.maximum(excess, 0.0)
    return excess / max(excess.sum(), 1e-300)


def holding(share: Sequence[float] | Float[np.ndarray, " nv"]) -> list[int]:
    """Rows that hold the gap, the loudest first, by each row's share of it."""
    order = sorted(range(len(share)), key=lambda k: -share[k])
    return [k for k in order if share[k] >= HOLDING] or order[:1]


@dataclasses.dataclass(frozen=True)
class Counted:
    """Samples and frequencies that energies are summed over."""

    used: Bool[np.ndarray, "R n"]
    modes: int | None = None
    """Cosines in time that count, the slowest ones; None: all."""

    def energy(self, x: Float[np.ndarray, "*k R n"]) -> Float[np.ndarray, "*k R"]:
        """Squared torques summed over rows, moment by moment."""
        x = np.where(self.used, x, 0.0)
        if self.modes is not None:
            cosines = np.asarray(scipy.fft.dct(x, axis=-2, norm="ortho"))
            cosines[..., self.modes :, :] = 0.0
            x = np.asarray(scipy.fft.idct(cosines, axis=-2, norm="ortho"))
        return np.sum(x**2, axis=-1)

    def rms(self, x: Float[np.ndarray, "R n"]) -> float:
        """Of torques, over the samples that count."""
        return float(np.sqrt(self.energy(x).sum() / max(self.count, 1)))

    @property
    def count(self) -> int:
        """Number of samples."""
        return int(self.used.sum())


@dataclasses.dataclass(frozen=True)
class Shrink:
    """Rms of the missing torque over the rows that hold the gap [N m]: before, after, and what no effect removes."""

    before: float
    after: float
    sensors: float
    """Of the sensors' noise, and of a drive's where what is left passes for it."""
    excused: float
    """Of the nominal model's own errors as this log most likely has them: its numbers within their tolerances, how its
    friction turns over, when within a period a torque acted. What goes with them, in energy, is there before and after
    alike."""
    interval: tuple[float, float] | None = None
    """95 %, of the share on another motion; None where that was not foretold."""
    band: float | None = None
    """Up to which frequency it was measured [Hz]; None: as far as the chain's filters let torques through."""

    @property
    def noise(self) -> float:
        """The floor: sensors and model together."""
        return float(np.hypot(self.sensors, self.excused))

    @property
    def share(self) -> float | None:
        """1 − after/before, both with the floor taken off; None where hardly more than it was there before."""
        if self.before <= NEAR * self.noise:
            return None
        gap = self.before**2 - self.noise**2
        return 1.0 - float(np.sqrt(max(self.after**2 - self.noise**2, 0.0) / gap))


@dataclasses.dataclass(frozen=True)
class Energies:
    """Squared torques summed over rows, moment by moment [N² m²]."""

    before: Float[np.ndarray, " R"]
    after: Float[np.ndarray, " R"]
    left: Float[np.ndarray, " R"]
    """After, and without what the nominal model's own errors most likely have in it."""
    sensors: Float[np.ndarray, " R"]
    count: int
    """Samples that were summed."""

    @classmethod
    def of(
        cls,
        counted: Counted,
        before: Float[np.ndarray, "R nv"],
        after: Float[np.ndarray, "R nv"],
        excused: Float[np.ndarray, "R nv"],
        replicas: Float[np.ndarray, "K R nv"],
    ) -> "Energies":
        """Of finished torques; `excused`: the model's errors in `after`, `replicas`: draws of the sensors' noise."""
        energy = counted.energy
        there, without = energy(after), energy(after - excused)
        if without.sum() > there.sum():
            # Errors that would leave more than there is are none.
            without = there
        sensors = energy(replicas).mean(axis=0)
        return cls(energy(before), there, without, sensors, counted.count)

    @property
    def shrink(self) -> Shrink:
        """One number each."""
        before, after, left, sensors = (
            float(np.sum(x)) / max(self.count, 1)
            for x in (self.before, self.after, self.left, self.sensors)
        )
        return Shrink(*np.sqrt([before, after, sensors, after - left]).tolist())

    def interval(
        self, rate: float, own: float = 0.0, *, block: float = 1.0, draws: int = 1000, seed: int = 0
    ) -> tuple[float, float] | None:
        """95 % interval of the share on another motion: a bootstrap over blocks of time [s] (Künsch 1989).

        Drawn twice, once for what chance and the equations' own errors leave here, once for the same on the other
        motion; `own` is the energy that those errors leave [N² m²], as large as they usually are. None where the gap
        is below its floor.
        """
        of_block = (np.arange(len(self.before)) / (rate * block)).astype(int)
        before, after, left, sensors = (
            np.bincount(of_block, weights=x)
            for x in (self.before, self.after, self.left, self.sensors)
        )
        rest, gap = left - sensors, before - after + left - sensors
        whole, count = gap.sum(), len(gap)
        if whole <= 0:
            return None
        rng = np.random.default_rng(seed)
        pick = rng.integers(0, count, (2, draws, count))
        # A draw that hardly holds the gap tells no share of it.
        chance = rest[pick].sum(axis=2) / np.maximum(gap[pick].sum(axis=2), 0.1 * whole)
        # Few blocks vary less than what they were drawn from.
        few = scipy.stats.t.ppf(0.975, max(count - 1, 1)) / scipy.stats.norm.ppf(0.975)
        expected = rest.sum() / whole
        here, there = own / whole * rng.standard_normal((2, draws)) ** 2
        remains = expected + few * (chance - expected).sum(axis=0) + there - here
        low, high = np.quantile(1.0 - np.sqrt(np.maximum(remains, 0.0)), [0.025, 0.975])
        return float(low), float(high)
