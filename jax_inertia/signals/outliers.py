"""Single samples of an encoder that cannot be: repeated while the joint moves, or struck by a glitch.

One repeated sample at 2 rad/s and 250 Hz is off by 8 mrad, a thousand times an encoder's noise, and its second
difference is a blow. Each sample is compared with the cubic through two neighbours on either side,

    r_k = q_k − (−q_{k−2} + 4 q_{k−1} + 4 q_{k+1} − q_{k+2}) / 6

and where r stands out the sample is replaced by what makes it and its neighbours fit such cubics best, if they then do.
Where another sample close by is struck as well, the two are replaced together. A corner in the motion itself (an
impact, a gear's play taken up) stays: there no sample is to blame.
"""

import numpy as np
from jaxtyping import Float
from scipy import ndimage

# In robust standard deviations of r: what stands out, and what its neighbours may be once it is replaced.
OUT, FITS = 8.0, 4.0
# Samples on either side that are looked at together, and how far apart two struck ones may be.
REACH, APART = 6, 3
_CUBIC = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6.0


def without_outliers(x: Float[np.ndarray, "T n"]) -> Float[np.ndarray, "T n"]:
    """Channels at equal periods, their isolated outliers replaced; NaN and logs below 13 samples stay."""
    out = np.array(x, float)
    if len(out) <= 2 * REACH:
        return out
    for column in out.T:
        residual = _residual(column)
        finite = np.abs(residual[np.isfinite(residual)])
        # Most residuals of a coarse encoder may be zero.
        spread = max(np.median(finite) / 0.6745, _quantum(column)) if finite.size else 0.0
        if spread <= 0:
            continue
        size = np.nan_to_num(np.abs(residual))
        peak = (size > OUT * spread) & (size >= ndimage.maximum_filter1d(size, 5))
        for k in _mendable(column, np.flatnonzero(peak[REACH:-REACH]) + REACH, FITS * spread):
            near = column[k - REACH : k + REACH + 1]
            for struck, (felt, change) in _SUSPECTS.items():
                mended = near.copy()
                mended[list(struck)] -= change @ _residual(near)[felt]
                if np.all(np.abs(_residual(mended)[felt]) < FITS * spread):
                    near[:] = mended
                    break
    return out


def _mendable(column: np.ndarray, peaks: np.ndarray, fits: float) -> np.ndarray:
    """Peaks that can be mended, and those so near to one that they may be once it is.

    A log has thousands of peaks that are motion, so all are asked at once.
    """
    windows = column[peaks[:, None] + np.arange(-REACH, REACH + 1)]
    residual = windows @ _RESIDUAL.T
    mends = np.zeros(len(peaks), bool)
    for struck, (felt, change) in _SUSPECTS.items():
        after = residual[:, felt] @ (np.eye(len(felt)) - _felt(struck)[felt] @ change).T
        mends |= np.all(np.abs(after) < fits, axis=1)
    # Windows that touch what another mends are of one group.
    group = np.cumsum(np.diff(peaks, prepend=peaks[:1]) > REACH + APART)
    return peaks[np.isin(group, group[mends])]


def _suspected(struck: tuple[int, ...]) -> tuple[np.ndarray, Float[np.ndarray, "s r"]]:
    """Whose residuals struck samples of a window are felt in, and their change from those that leaves the least."""
    effect = _felt(struck)
    felt = np.flatnonzero(np.any(effect != 0, axis=1))
    return felt, np.linalg.pinv(effect[felt])


def _residual(x: np.ndarray) -> np.ndarray:
    """r of every sample but two at either end, where it is zero (T,)."""
    out = np.zeros_like(x)
    out[2:-2] = x[2:-2] - np.convolve(x, _CUBIC, "valid")
    return out


def _quantum(x: np.ndarray) -> float:
    """The step of a coarse encoder: the smallest change between samples, where many do not change at all."""
    steps = np.abs(np.diff(x))
    still = np.mean(steps == 0.0)
    moved = steps[steps > 0]
    return float(moved.min()) if still > 0.02 and moved.size else 0.0


_RESIDUAL = np.stack([_residual(x) for x in np.eye(2 * REACH + 1)], axis=1)
"""r of a window's samples, as a matrix."""


def _felt(struck: tuple[int, ...]) -> np.ndarray:
    """Change of a window's r by each struck sample."""
    return _RESIDUAL[:, list(struck)]


_SUSPECTS = {
    struck: _suspected(struck)
    for struck in (
        (REACH,),
        *((REACH, REACH + d) for k in range(1, APART + 1) for d in (k, -k)),
        (REACH - 1, REACH + 1),
    )
}
"""Which samples of a window may be to blame: its middle, that and one close by, or those on either side of it."""
