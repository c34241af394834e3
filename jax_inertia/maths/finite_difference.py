"""Derivatives from differences, and what must be continuous before it is differenced."""

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view

# Periods that differ by less than this share of their mean are alike: rounded stamps.
_ALIKE = 1e-3


def centred_slopes(
    time: Float[np.ndarray, "T"], slopes: Float[np.ndarray, "S *c"]
) -> Float[np.ndarray, "T *c"]:
    """Mean slopes over the S = T − 1 intervals between stamps, turned into derivatives at the
    stamps.

    With s_k = (x_k − x_{k−1}) / h_k, where the six periods about a stamp are alike, the central
    difference of sixth order,
        ẋ_k = (37 (s_k + s_{k+1}) − 8 (s_{k−1} + s_{k+2}) + s_{k−2} + s_{k+3}) / 60,
    elsewhere ẋ_k = (h_{k+1} s_k + h_k s_{k+1}) / (h_k + h_{k+1}), second order. The ends are
    extrapolated. The second order alone would lose (ω h)² / 6 of a motion of angular rate ω.
    """
    h = np.diff(time).reshape((-1,) + (1,) * (slopes.ndim - 1))
    if len(h) == 1:
        return np.concatenate([slopes, slopes])
    inner = (h[1:] * slopes[:-1] + h[:-1] * slopes[1:]) / (h[1:] + h[:-1])
    first = slopes[:1] + (slopes[:1] - slopes[1:2]) * h[:1] / (h[:1] + h[1:2])
    last = slopes[-1:] + (slopes[-1:] - slopes[-2:-1]) * h[-1:] / (h[-1:] + h[-2:-1])
    out = np.concatenate([first, inner, last])
    count = len(h) - 5
    if count < 1:
        return out
    if np.ptp(h) < _ALIKE * h.mean():
        # As slices: a grid's columns come here by the thousand.
        ahead = [slopes[k : k + count] for k in range(6)]
        at = slice(3, 3 + count)
    else:
        periods = sliding_window_view(h.ravel(), 6)
        alike = np.flatnonzero(np.ptp(periods, axis=1) < _ALIKE * periods.mean(axis=1))
        ahead = [slopes[alike + k] for k in range(6)]
        at = alike + 3
    near, further, furthest = (ahead[2 - k] + ahead[3 + k] for k in range(3))
    out[at] = (37 * near - 8 * further + furthest) / 60
    return out


def derivative(
    time: Float[np.ndarray, "T"], x: Float[np.ndarray, "T *c"]
) -> Float[np.ndarray, "T *c"]:
    """Derivative of samples at their stamps, from their slopes between them (`centred_slopes`)."""
    return centred_slopes(
        time, np.diff(x, axis=0) / np.diff(time).reshape((-1,) + (1,) * (x.ndim - 1))
    )


def continuous_signs(quat: Float[np.ndarray, "T 4"]) -> Float[np.ndarray, "T 4"]:
    """Choose the sign of each quaternion that is nearer to the one before: q and −q are one
    rotation.
    """
    flips = np.where(np.sum(quat[1:] * quat[:-1], axis=1) < 0, -1.0, 1.0)
    return quat * np.concatenate([[1.0], np.cumprod(flips)])[:, None]
