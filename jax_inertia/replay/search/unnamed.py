"""The alternative that has no name: something that no candidate is, whose torque goes with shapes of the motion.

    e_j = Σ_k a_k s_k(t − l_k) + rest

e is the remainder of replays without an effect, s shapes of the motion and of the targets (`remainder.shapes`) and a
constant: a few of them, taken one by one for as long as each brings its price: ln N for its number (BIC, N independent
samples) and the logarithm of how many it was chosen from. A law that is in the model leaves the sensors' noise, and no
handful of shapes does. Where much is left with an effect too, they may do as well: then nothing says that the effect is
the cause.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.maths.sample_weight import autocorrelation_time
from jax_inertia.replay.fitting.errors import likelier
from jax_inertia.replay.record import Record
from jax_inertia.replay.remainder import shapes

_MOST = 6
"""Shapes of one joint's error."""
_LATE = 0.0, 0.04
"""By which a loop passes on what moves it [s]."""


class Shapes:
    """Those of some runs, made once for all effects in whose place they are tried."""

    def __init__(self, names: Sequence[str], records: Sequence[Record]):
        self._columns = [_columns(names, j, records) for j in range(len(names))]

    def cost(
        self,
        with_it: Float[np.ndarray, "N n"],
        without: Float[np.ndarray, "N n"],
        floor: Float[np.ndarray, " n"],
        numbers: int,
    ) -> float:
        """By how much shapes in an effect's place cost more than its `numbers`, in twice nats; errors in rad."""
        tried = [_left(x, e) for x, e in zip(self._columns, without.T, strict=True)]
        left, counts = zip(*tried, strict=True)
        worse, independent = likelier(with_it, np.stack(left, axis=1), floor)
        return worse + (sum(counts) - numbers) * float(np.log(max(independent.max(), 1.0)))


def _left(
    columns: Float[np.ndarray, "k N"], error: Float[np.ndarray, " N"]
) -> tuple[Float[np.ndarray, " N"], int]:
    """What shapes leave of one joint's error, and how many there are."""
    independent = len(error) / autocorrelation_time(error)
    price = np.log(independent) + 2.0 * np.log(len(columns))
    basis, left, count = np.zeros((len(error), 0)), error, 0
    while count < _MOST:
        new = columns - (columns @ basis) @ basis.T
        size = np.linalg.norm(new, axis=1)
        along = np.divide(new @ left, size, out=np.zeros(len(new)), where=size > 1e-6)
        best = int(np.argmax(np.abs(along)))
        power = float(left @ left)
        after = power - along[best] ** 2
        if power <= 0.0 or independent * np.log(power / max(after, 1e-300)) < price:
            break
        basis = np.column_stack([basis, new[best] / size[best]])
        left = left - along[best] * basis[:, -1]
        count += 1
    return left, count


def _columns(names: Sequence[str], j: int, records: Sequence[Record]) -> Float[np.ndarray, "k N"]:
    """Each shape along all records, at each lag, and a constant, of size one."""
    out = []
    for late in _LATE:
        every = []
        for r in records:
            back = np.maximum(np.arange(len(r.time)) - round(late / r.period), 0)
            every.append(np.array([x[back][r.settled] for x in shapes(names, j, r).values()]))
        out.append(np.concatenate(every, axis=1))
    columns = np.concatenate(out)
    columns = columns - columns.mean(axis=1, keepdims=True)
    columns = np.concatenate([np.ones((1, columns.shape[1])), columns])
    size = np.linalg.norm(columns, axis=1, keepdims=True)
    return columns / np.maximum(size, 1e-300)
