"""How small an effect may be for a log to show it: below that, its absence is not known."""

import numpy as np

from jax_inertia.diagnosis.effects.base import Parameter, Place
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.pool import Entry, Pool
from jax_inertia.gap.propose import STOP


def undetectable(pool: Pool) -> tuple[tuple[str, Place, Parameter], ...]:
    """Smallest size of each effect that this log would have shown, by family and place; where it tells of none, none.

    The effect's charged energy has to pay STOP and ln n for its size. Of a vector: along the axis that is seen best.
    What the model's tolerances, as they were stated, would take is no gap: this log may have them narrower, beside an
    effect they would not be.
    """
    evidence = pool.evidence.unpinned()
    evidence = evidence.rescaled({kind: max(x, 1.0) for kind, x in evidence.scales.items()})
    smallest = (_smallest(pool, evidence, entry) for entry in pool.entries)
    return tuple(
        (entry.family.name, entry.place, x)
        for entry, x in zip(pool.entries, smallest, strict=True)
        if x is not None
    )


def _smallest(pool: Pool, evidence: Evidence, entry: Entry) -> Parameter | None:
    family, place = entry.family, entry.place
    block = entry.blocks[len(entry.blocks) // 2].charged_as(evidence)
    price = STOP + np.log(evidence.rows)
    if family.whole is not None:
        # A delay does in proportion to what it is while it is small; a limit that is low does much.
        least, most = (
            float(end(entry.blocks, key=lambda b: b.shape).plain.gram[0, 0]) for end in (min, max)
        )
        energy = float(block.gram[0, 0])
        if len(block.shape) != 1 or not 0.0 < least < most:
            return None
        size = block.shape[0] * np.sqrt(price / energy)
        return next(iter(family.reported(pool.context, place, (size,), np.zeros(0)).values()))
    units = family.sized(pool.context, place, UNIT)
    best, most = None, 0.0
    for axis, unit in enumerate(units):
        weights = family.weights(pool.context, place, unit)
        if len(weights) != block.count:
            return None
        energy = float(weights @ block.gram @ weights)
        if energy > most:
            size = UNIT * float(np.sqrt(price / energy))
            best, most = family.sized(pool.context, place, size)[axis], energy
    if best is None:
        return None
    every = list(family.reported(pool.context, place, block.shape, best).values())
    return max(every[:3], key=lambda p: abs(p.value)) if len(units) > 1 else every[0]


# Small enough for what is not linear in its size.
UNIT = 1e-3
