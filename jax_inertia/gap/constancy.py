"""Whether an effect that was found is as large throughout as its equation says.

A friction, a gain, an encoder's scale: each is one number. So each found effect e(t) is tried with a size that changes,

    e(t) (1 + Σ aₖ Pₖ(x(t))),    Pₖ Legendre's polynomials over the range of x,

x being time, or the position, load or speed of a joint. Where that fits better by more than its numbers cost, and the
size would have to change by much, the cause is something else that resembles the effect on average: an encoder whose
disk sits off its axis resembles a wrong scale, a ripple of a gear under load resembles cogging, a clock that runs slow
resembles a lag. Likewise a push is one force for a while: one that turns about is none, nor are forces at two bodies.
"""

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Columns
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.gap.candidate import Beside, Candidate
from jax_inertia.gap.pool import Pool
from jax_inertia.gap.suited import SUITS
from jax_inertia.gap.together import stacked
from jax_inertia.text.words import named, percent

# By which share (rms) of itself a size has to change to speak against the effect: equations are never exact.
CHANGES = 0.3
# The same of a push's force, whose flanks may have any form.
TURNS_ABOUT = 0.15
# Harmonics over a push's window.
HARMONICS = 4


@dataclasses.dataclass(frozen=True)
class Inconstant:
    """A found effect whose size changes, and with what."""

    effect: Candidate
    along: str
    by: float
    """Share (rms) of the effect."""

    def __str__(self) -> str:
        effect = named(self.effect.family.name, self.effect.place)
        return f"{effect} would have to change by {percent(self.by)} with {self.along}"


def inconstant(pool: Pool, chosen: list[Candidate], noise: float) -> Inconstant | None:
    """The found effect that is least of one size; None where all are. `noise` is the misfit they competed against."""
    if not chosen:
        return None
    left = Beside.of(pool.evidence, *stacked(pool, chosen))
    unit = max(1.0, float(left.target @ left.target) / max(noise, 1.0))
    worst, most = None, SUITS
    for c in chosen:
        size = max(float(c.effect @ c.effect), 1e-300)
        for along, border, columns in _variations(pool, c):
            free = left.free(columns)
            change, *_ = np.linalg.lstsq(free, left.target, rcond=1e-8)
            won = float(np.sum((free @ change) ** 2))
            score = won / unit - columns.shape[1] * np.log(pool.evidence.rows)
            by = float(np.sqrt(won / size))
            if by > border and score > most:
                worst, most = Inconstant(c, along, by), score
    return worst


def crowded(chosen: list[Candidate]) -> tuple[Candidate, Candidate] | None:
    """Two effects in passing, at different bodies or without a pause: likelier is one cause, of no equation here."""
    passing = [c for c in chosen if c.family.passing]
    pairs = itertools.combinations(passing, 2)
    return next(((a, b) for a, b in pairs if a.place != b.place or a.same_cause(b)), None)


def _variations(pool: Pool, c: Candidate) -> Iterator[tuple[str, float, Float[np.ndarray, "n k"]]]:
    """What the size may change with, the border of that change, and the columns of it."""
    context, family = pool.context, c.family
    if family.passing:
        rows = context.force_rows[:, c.place.index]
        waves = _harmonics(context, *c.shape[:2])
        free = np.einsum("tjc,tk->tjkc", rows, waves).reshape(*rows.shape[:2], -1)
        yield "time", TURNS_ABOUT, pool.evidence.column(Columns(free))
    else:
        for along, factors in _factors(context, c):
            columns = family.varying(context, c.place, c.shape, c.theta, factors)
            yield along, CHANGES, pool.evidence.column(columns)


def _factors(context: Context, c: Candidate) -> Iterator[tuple[str, Float[np.ndarray, "T k"]]]:
    """Functions of what an effect's size may change with."""
    changes = c.family.changes
    if "time" in changes:
        yield "time", _legendre(context.time, 3)
    if c.place.kind == "joint":
        row, name = c.place.index, c.place.name
        signals = {
            "position": (context.joint_position[:, row], 3),
            "load": (np.abs(context.inverse[:, row]), 2),
            "speed": (np.abs(context.v[:, row]), 2),
        }
        for of, (x, degree) in signals.items():
            if of in changes:
                yield f"{name}'s {of}", _legendre(x, degree)


def _legendre(x: Float[np.ndarray, " T"], degree: int) -> Float[np.ndarray, "T k"]:
    """P₁ … P_degree over the range of x, a hundredth at either end apart."""
    low, high = np.percentile(x, [0.5, 99.5])
    z = np.clip(2 * (x - low) / max(high - low, 1e-12) - 1, -1.2, 1.2)
    return np.polynomial.legendre.legvander(z, degree)[:, 1:]


def _harmonics(context: Context, start: float, stop: float) -> Float[np.ndarray, "T k"]:
    """sin πφ sin kπφ over a window's phase φ."""
    phase = np.pi * np.clip((context.time - start) / (stop - start), 0, 1)
    return np.sin(phase)[:, None] * np.sin(phase[:, None] * np.arange(1, HARMONICS + 1))
