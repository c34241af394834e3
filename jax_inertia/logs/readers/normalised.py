"""Positions that are not in radians: LeRobot's, in degrees or normalised to ±100 of the motors' calibrated ranges.

The calibration is a JSON object with one entry a motor: range_min and range_max [counts], drive_mode. Normalised are
positions q = ±200 (counts − range_min) / (range_max − range_min) ∓ 100, and of grippers from 0 to 100; the middle of a
range, of a gripper its lower end, is taken as the joint's zero.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.plain_file import read_plain
from jax_inertia.logs.readers.options import Contents, Options
from jax_inertia.text.closest_names import suggestion

COUNTS = 4096
"""Of one turn: the encoders of the servos that LeRobot calibrates have 12 bits."""

_MOST = 1 << 20
_TWO_TURNS = 4.0 * np.pi
_POSITIONS = ("qpos", "qpos_target")


def seen_to(contents: Contents, options: Options) -> None:
    """Scale normalised positions by the calibration where one is given, in place; `LogError` where one is needed.

    A dataset does not say its unit. More than two turns in radians are degrees or normalised, and which of them nobody
    can tell from the numbers.
    """
    arrays = contents.arrays
    if options.calibration is not None:
        if options.degrees:
            raise LogError("positions are in degrees or normalised: give degrees or calibration")
        _scale(contents, _read(options.calibration))
        return
    stated = options.degrees or contents.in_radians
    with np.errstate(invalid="ignore"):
        far = np.nanmax(np.abs(arrays["qpos"]), initial=0.0)
    if stated or not far > _TWO_TURNS:
        return
    within = " (within ±100: perhaps normalised to the calibrated ranges)" if far <= 100.5 else ""
    raise LogError(
        f"positions go to {far:.4g}, which is not rad{within}; give --degrees, or for normalised positions "
        "--calibration FILE, the JSON file of the motors' ranges"
    )


def _scale(contents: Contents, motors: Mapping[str, tuple[float, float]]) -> None:
    arrays = contents.arrays
    joints = arrays["joint_names"].tolist()
    if lacking := [name for name in joints if name not in motors]:
        raise LogError(
            f"the calibration has no motor {lacking[0][:60]!r}; {suggestion(lacking[0], list(motors))}"
        )
    if np.nanmax(np.abs(arrays["qpos"]), initial=0.0) > 100.5:
        raise LogError("positions go beyond ±100: they are not normalised; leave out calibration")
    # [rad] of a hundred, and its sign.
    gain = np.array([motors[name][0] * motors[name][1] for name in joints]) / 100.0
    for name in (*_POSITIONS, "qvel"):
        if name in arrays:
            arrays[name] = arrays[name] * gain
    contents.in_radians = True
    contents.notes = [
        *contents.notes,
        "normalised positions were scaled by the calibrated ranges, 4096 counts a turn; zero is a range's middle (of a "
        "gripper its lower end), which need not be the model's",
    ]


def _read(path: str | os.PathLike[str]) -> dict[str, tuple[float, float]]:
    """Half of each motor's range [rad], the whole of a gripper's, and its sign, by name."""
    name = os.path.basename(os.fspath(path))
    try:
        found: Any = json.loads(read_plain(Path(path), _MOST))
        if not isinstance(found, dict):
            raise ValueError("no JSON object")
        out = {}
        for motor, entry in found.items():
            low, high = float(entry["range_min"]), float(entry["range_max"])
            if not 0.0 < high - low <= COUNTS:
                raise ValueError(f"the range of {motor[:60]!r} is from {low:g} to {high:g} counts")
            size = (high - low) * 2.0 * np.pi / COUNTS
            is_gripper = "gripper" in motor.lower()
            out[motor] = (
                size if is_gripper else 0.5 * size,
                -1.0 if entry.get("drive_mode") else 1.0,
            )
    except OSError as error:
        raise LogError(f"calibration {name}: {error.strerror or error}") from None
    except (
        *(ValueError, KeyError, TypeError, AttributeError),
        *(RecursionError, OverflowError),
    ) as error:
        reason = " ".join(str(error).split())[:150]
        raise LogError(
            f"calibration {name}: {reason}; expected an object for each motor with range_min and range_max"
        ) from None
    return out
