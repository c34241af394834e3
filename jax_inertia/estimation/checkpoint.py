"""A filter's state in a file, so that it goes on after a restart bit for bit.

    save_state("state.npz", estimator, state)
    state = load_state("state.npz", estimator)

and `save_stream`, `load_stream` for a `Stream`, with the samples that wait. An .npz of plain numbers and text, no
pickles. Numbers mean nothing without what they were made with (the mean of another chart has the same shape, and that
of a robot with another gripper looks the same), so the file carries a digest of every field of robot, chart and
settings, to the last bit, and the state of another filter is refused in one line that says which differs.
"""

import dataclasses
import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jax_inertia.estimation.inertial_filter import Estimator, State
from jax_inertia.estimation.stream import Stream, StreamState
from jax_inertia.logs.atomic_files import whole_file
from jax_inertia.logs.log import Log
from jax_inertia.logs.npz import LogError, read_npz
from jax_inertia.logs.schema import SHAPES, TEXTS, TorqueKind, TorqueUnit, check_structure
from jax_inertia.maths import kalman
from jax_inertia.text.closest_names import listed

_VERSION = "jax-inertia state 2"
_MOST_BYTES = 1 << 30
_LONGEST = 1000  # characters of a message that quotes a file: a decision
_FILTER = ("mean", "covariance", "bias", "rejected_for")
_DIGESTS = "digests"
# Covariances of a filter in single precision are symmetric and positive to some hundred roundings.
_ROUNDINGS = 1000.0
# Nothing that a robot moves is so many times as heavy as it is.
_HEAVIEST = 1e4


class StateError(ValueError):
    """A file whose state cannot be gone on with; the message is one line: what, and what would be right."""


def save_state(path: str | os.PathLike[str], estimator: Estimator, state: State) -> None:
    """Write a state of `estimator`, whole or not at all; ValueError for a name that does not end in .npz.

    >>> import tempfile
    >>> from pathlib import Path
    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation.inertial_filter import make_estimator
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> from jax_inertia.estimation.checkpoint import load_state, save_state
    >>> path = Path(tempfile.mkdtemp()) / "state.npz"
    >>> ekf = make_estimator(load_model(double_pendulum()), ["lower"], sigma_tau=0.1)
    >>> save_state(path, ekf, ekf.initial())
    >>> bool((load_state(path, ekf).belief.mean == ekf.initial().belief.mean).all())
    True
    """
    _write(Path(path), _settings(estimator), _arrays(state), estimator)


def load_state(path: str | os.PathLike[str], estimator: Estimator) -> State:
    """Read a state back, to the last bit.

    Raises StateError for a file that is not sound, of another version or filter (bodies, joints, chart, precision; a
    number of the robot or a setting), or with a covariance that is none.

    >>> import tempfile
    >>> from pathlib import Path
    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation.inertial_filter import make_estimator
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> from jax_inertia.estimation.checkpoint import load_state, save_state
    >>> path = Path(tempfile.mkdtemp()) / "state.npz"
    >>> ekf = make_estimator(load_model(double_pendulum()), ["lower"], sigma_tau=0.1)
    >>> save_state(path, ekf, ekf.initial())
    >>> bool((load_state(path, ekf).belief.mean == ekf.initial().belief.mean).all())
    True
    """
    return _state(Path(path), _read(Path(path), _settings(estimator), _FILTER), estimator)


def save_stream(path: str | os.PathLike[str], stream: Stream, state: StreamState) -> None:
    """Write a stream's state, with the samples that wait; as `save_state`.

    >>> import tempfile
    >>> from pathlib import Path
    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation.inertial_filter import make_estimator
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> from jax_inertia.estimation.checkpoint import load_stream, save_stream
    >>> from jax_inertia.estimation.stream import Stream
    >>> path = Path(tempfile.mkdtemp()) / "state.npz"
    >>> ekf = make_estimator(load_model(double_pendulum()), ["lower"], sigma_tau=0.1)
    >>> stream = Stream(ekf)
    >>> state, _ = stream.feed(stream.start(), swing(seconds=0.5))
    >>> save_stream(path, stream, state)
    >>> len(load_stream(path, stream).waiting.time)
    50
    """
    arrays = _arrays(state.filter) | {"last": np.asarray(state.last)}
    if (log := state.waiting) is not None:
        arrays |= {
            name: np.asarray(value) for name in SHAPES if (value := getattr(log, name)) is not None
        }
        texts = (
            *(log.joint_names, log.contact_bodies),
            *(log.imu_body, str(log.tau_kind), log.tau_unit_text),
        )
        # An empty list of names has no text type of its own.
        arrays |= {n: np.asarray(t, np.str_) for n, t in zip(TEXTS, texts, strict=True)}
    _write(Path(path), _stream_settings(stream), arrays, stream.estimator)


def load_stream(path: str | os.PathLike[str], stream: Stream) -> StreamState:
    """Read a stream's state back, to the last bit; raises StateError as `load_state` does, and for another window.

    >>> import tempfile
    >>> from pathlib import Path
    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation.inertial_filter import make_estimator
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> from jax_inertia.estimation.checkpoint import load_stream, save_stream
    >>> from jax_inertia.estimation.stream import Stream
    >>> path = Path(tempfile.mkdtemp()) / "state.npz"
    >>> ekf = make_estimator(load_model(double_pendulum()), ["lower"], sigma_tau=0.1)
    >>> stream = Stream(ekf)
    >>> state, _ = stream.feed(stream.start(), swing(seconds=0.5))
    >>> save_stream(path, stream, state)
    >>> len(load_stream(path, stream).waiting.time)
    50
    """
    path = Path(path)
    arrays = _read(path, _stream_settings(stream), (*_FILTER, "last"), (*SHAPES, *TEXTS))
    state = _state(path, arrays, stream.estimator)
    if arrays["last"].shape:
        raise StateError(f"{path}: 'last' has shape {arrays['last'].shape}; it is one number")
    waiting = None
    if "time" in arrays:
        try:
            waiting = _log(arrays)
        except ValueError as error:
            # Names from the file may be of any length.
            raise StateError(
                f"{path}: the samples that wait are no log: {str(error)[:_LONGEST]}"
            ) from None
    return StreamState(state, arrays["last"], waiting)


def _log(arrays: dict[str, np.ndarray]) -> Log:
    numbers = {name: arrays[name] for name in SHAPES if name in arrays}
    if texts := [name for name, x in numbers.items() if x.dtype.kind != "f"]:
        raise LogError(f"{', '.join(texts)} holds text")
    if missing := [name for name in ("qpos", "tau", *TEXTS) if name not in arrays]:
        raise LogError(f"{', '.join(missing)} is missing")
    listed = ("joint_names", "contact_bodies")
    if odd := [name for name in TEXTS if arrays[name].ndim != (name in listed)]:
        raise LogError(f"{', '.join(odd)} is no list of names, or no text")
    unit = str(arrays["tau_unit"])
    fields = {
        "joint_names": tuple(arrays["joint_names"].tolist()),
        "contact_bodies": tuple(arrays["contact_bodies"].tolist()),
        "imu_body": str(arrays["imu_body"]),
        "tau_kind": TorqueKind(str(arrays["tau_kind"])),
        "tau_unit": TorqueUnit.parse(unit),
        "tau_unit_text": unit,
        **numbers,
    }
    check_structure(fields)
    return Log(**fields)


def _settings(estimator: Estimator) -> dict[str, str]:
    """What a state must agree with, in words."""
    robot = estimator.robot
    return {
        "version": _VERSION,
        "bodies": ", ".join(robot.body_names[i] for i in estimator.bodies),
        "joints": ", ".join(robot.joint_names),
        "chart": type(estimator.chart).__name__,
        "precision": str(estimator.prior.mean.dtype),
    }


def _digests(estimator: Estimator) -> dict[str, str]:
    """A digest of each field of the filter, and of its robot, by name."""
    fields = {f.name: getattr(estimator, f.name) for f in dataclasses.fields(estimator)}
    robot = fields.pop("robot")
    fields |= {f"robot.{f.name}": getattr(robot, f.name) for f in dataclasses.fields(robot)}
    return {name: _digest(value) for name, value in fields.items()}


def _digest(value: object) -> str:
    seen = hashlib.sha256()
    for piece in _pieces(value):
        # Lengths first, so that no two values have the same pieces in a row.
        seen.update(len(piece).to_bytes(8, "little") + piece)
    return seen.hexdigest()[:16]


def _pieces(value: object) -> Iterator[bytes]:
    """All that a value is made of: types and arrays to the last bit, functions by their names."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        yield type(value).__qualname__.encode()
        for field in dataclasses.fields(value):
            yield field.name.encode()
            yield from _pieces(getattr(value, field.name))
    elif isinstance(value, tuple | list):
        yield f"{len(value)} values".encode()
        for one in value:
            yield from _pieces(one)
    elif isinstance(value, np.ndarray | jax.Array):
        array = np.asarray(value)
        yield f"{array.dtype} {array.shape}".encode()
        yield array.tobytes()
    elif callable(value):
        yield getattr(value, "__qualname__", type(value).__qualname__).encode()
    else:
        yield repr(value).encode()


def _stream_settings(stream: Stream) -> dict[str, str]:
    sizes = {"window": str(stream.window), "block": str(stream.block)}
    return _settings(stream.estimator) | sizes


def _arrays(state: State) -> dict[str, np.ndarray]:
    values = (state.belief.mean, state.belief.covariance, state.bias, state.rejected_for)
    return dict(zip(_FILTER, (np.asarray(x) for x in values), strict=True))


def _write(
    path: Path, settings: dict[str, str], arrays: dict[str, np.ndarray], estimator: Estimator
) -> None:
    if path.suffix.lower() != ".npz":
        raise ValueError(f"cannot write {path}: a state is written as .npz")
    digests = {_DIGESTS: json.dumps(_digests(estimator))}
    texts = {name: np.array(text) for name, text in (settings | digests).items()}
    with whole_file(path) as file:
        np.savez(file, allow_pickle=False, **texts, **arrays)


def _read(
    path: Path, settings: dict[str, str], needed: Sequence[str], others: Sequence[str] = ()
) -> dict[str, np.ndarray]:
    """The arrays of a file made with these settings."""
    try:
        arrays, _ = read_npz(path, (*settings, _DIGESTS, *needed, *others), _MOST_BYTES)
    except (LogError, OSError) as error:
        raise StateError(f"{path}: {error}") from None
    if missing := [name for name in (*settings, _DIGESTS, *needed) if name not in arrays]:
        raise StateError(f"{path}: {', '.join(missing)} is missing; it is no state of this kind")
    for name, wanted in settings.items():
        found = str(arrays[name])[:200]
        if found != wanted:
            raise StateError(f"{path}: its {name} is {found!r}, this filter's is {wanted!r}")
    return arrays


def _require_same(path: Path, said: str, estimator: Estimator) -> None:
    """StateError that names the fields in which the file's filter differs from this one."""
    try:
        found = json.loads(said)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise StateError(f"{path}: digests are unreadable; it is no state of this kind")
    own = _digests(estimator)
    if other := [name for name in own if found.get(name) != own[name]]:
        whose = "robot" if all(name.startswith("robot.") for name in other) else "filter"
        raise StateError(
            f"{path}: the state is of another {whose}: {listed(other, 6)} "
            f"{'differs' if len(other) == 1 else 'differ'}; start anew, or make the {whose} as it was"
        )


def _require_bodies(path: Path, mean: jax.Array, estimator: Estimator) -> None:
    """StateError for numbers that overflow as inertial parameters, or are those of no body that a robot could carry."""
    pi = np.asarray(estimator.chart.to_pi(mean.reshape(len(estimator.bodies), -1)), float)
    whole = max(float(np.asarray(estimator.robot.pi)[:, 0].sum()), 1e-9)
    for index, one in zip(estimator.bodies, pi, strict=True):
        if not np.all(np.isfinite(one)) or abs(one[0]) > _HEAVIEST * whole:
            raise StateError(
                f"{path}: the mass of {estimator.robot.body_names[index]!r} is {one[0]:.3g} kg, of a robot of "
                f"{whole:.3g} kg; start anew, or from an earlier state"
            )


def _require_covariance(path: Path, p: np.ndarray, eps: float) -> None:
    """StateError for a matrix that is not symmetric and positive semidefinite, to rounding."""
    variance = np.diagonal(p)
    scale = np.sqrt(np.where(variance > 0, variance, 1.0))
    # No number at all, and so not symmetric, where an entry is beyond what its variances allow.
    with np.errstate(over="ignore", invalid="ignore"):
        correlation = p / scale / scale[:, None]
        tolerance = _ROUNDINGS * eps
        symmetric = bool(np.all(np.abs(correlation - correlation.T) <= tolerance))
    if not symmetric or np.linalg.eigvalsh(correlation)[0] < -tolerance * len(p):
        what = "positive semidefinite" if symmetric else "symmetric"
        raise StateError(f"{path}: covariance is not {what}; start anew, or from an earlier state")


def _state(path: Path, arrays: dict[str, np.ndarray], estimator: Estimator) -> State:
    like = _arrays(estimator.initial())
    for name, value in like.items():
        if arrays[name].shape != value.shape or arrays[name].dtype.kind != "f":
            raise StateError(f"{path}: {name} has shape {arrays[name].shape}, not {value.shape}")
        if not np.all(np.isfinite(arrays[name])):
            raise StateError(f"{path}: {name} is not finite; start anew, or from an earlier state")
    _require_same(path, str(arrays[_DIGESTS]), estimator)
    eps = float(jnp.finfo(estimator.prior.mean.dtype).eps)
    _require_covariance(path, arrays["covariance"], eps)
    # Read as float64, which holds every float32 exactly.
    mean, covariance, bias, waited = (jnp.asarray(arrays[n], like[n].dtype) for n in _FILTER)
    _require_bodies(path, mean, estimator)
    return State(kalman.Belief(mean, covariance), bias, waited)
