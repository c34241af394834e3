"""Stretches of a log in which the robot touches something, of which a replay knows nothing.

A force from outside acts on every joint between its point and the base: while it lasts, these joints part from the
replay together, by far more than they err by at all other times. No law of one joint does that.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation, binary_opening

from jax_inertia.replay.checks import encoder_noise
from jax_inertia.replay.fit import Fit
from jax_inertia.replay.plant import Plant
from jax_inertia.replay.record import Record
from jax_inertia.replay.simulate import replay

_FAR = 5.0
"""Times a joint's usual error (1.4826 of the median), beyond which it is parted from the replay."""
_LEAST_ERROR = 2.0
"""Of the usual error: in steps of the encoder, or in what a joint that stands still errs by."""
_JOINTS = 3
"""Parted together, of one chain; a force on fewer is not told from a law of the joints."""
_LASTS, _AROUND = 0.3, 0.5
"""A touch lasts at least so long, and leaves so much before and after it that is not free either [s]."""
_RARE = 0.4
"""Of the log at most: what goes on for longer is how the robot is."""


def without_touches(
    plant: Plant, found: Fit, records: Sequence[Record], known: Sequence[Record] = ()
) -> list[Record]:
    """The same records, each with the samples in which the robot touches something, which do not count.

    `known`: records of the same logs, from the same first samples on, in which touches were found before.
    """
    paths = [replay(plant, found.table, found.theta[None], r)[0] for r in records]
    masks = touches([p - r.q for p, r in zip(paths, records, strict=True)], records, plant.trees)
    for mask, before in zip(masks, known, strict=bool(known)):
        if before.touched is not None:
            mask[: len(before.touched)] |= before.touched[: len(mask)]
    return [r._replace(touched=m) if m.any() else r for r, m in zip(records, masks, strict=True)]


def touches(
    errors: Sequence[Float[np.ndarray, "T n"]], records: Sequence[Record], trees: np.ndarray
) -> list[Bool[np.ndarray, " T"]]:
    """Samples of each record in which joints of a chain part from the replay together; none where it is not rare.

    `errors`: replay minus log [rad]; `trees`: the chain that each joint belongs to.
    """
    every = np.concatenate(errors)
    steps = np.max([encoder_noise(r.q) for r in records], axis=0) * np.sqrt(12.0)
    usual = 1.4826 * np.median(np.abs(every), axis=0)
    # A joint that is at rest for most of the log has no usual error of its own: that of the others.
    usual = np.maximum(usual, np.maximum(_LEAST_ERROR * steps, 0.5 * np.median(usual)))
    out = []
    for e, r in zip(errors, records, strict=True):
        far = np.abs(e) > _FAR * usual
        together = np.zeros(len(e), bool)
        for tree in np.unique(trees):
            together |= far[:, trees == tree].sum(axis=1) >= _JOINTS
        width = [max(round(s / r.period), 1) for s in (_LASTS, _AROUND)]
        lasting = binary_opening(together, np.ones(width[0]))
        out.append(binary_dilation(lasting, np.ones(2 * width[1] + 1)) & r.settled)
    share = sum(m.sum() for m in out) / max(sum(len(m) for m in out), 1)
    return out if share <= _RARE else [np.zeros(len(m), bool) for m in out]


def note(records: Sequence[Record]) -> list[str]:
    """What is to be said of them, at most one line."""
    spans = []
    for k, r in enumerate(records):
        if r.touched is None:
            continue
        edges = np.flatnonzero(np.diff(np.concatenate([[0], r.touched.astype(int), [0]])))
        of = f" of log {k + 1}" if len(records) > 1 else ""
        spans += [
            f"{r.time[a]:.1f} to {r.time[b - 1]:.1f} s{of}"
            for a, b in zip(edges[::2], edges[1::2], strict=True)
        ]
    if not spans:
        return []
    return [
        f"several joints part from the replay together ({', '.join(spans)}): does the robot touch something there? "
        "A replay knows of no contact, and the fit left these samples out; leave them out of the log"
    ]
