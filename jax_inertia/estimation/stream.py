"""A log of any length through the filter, chunk by chunk, in bounded memory and with one answer whatever the chunks.

    stream = Stream(estimator, window=16)
    for part in stream.run(chunks):            # an iterator of `Log`s, each any number of samples, in order
        print(part.time[-1], part.trace.estimate.pi[-1, 0, 0])

Signals go the paper's way (sec. III-D), which needs no future: accelerations are differences over a window of samples,
every other channel its mean over the same window (`differences.aligned_differences`). Windows follow one another
without overlap, so each sample counts once and neighbours carry separate news: 16 periods at 333 Hz is an observation
every 48 ms. They are filtered in blocks of one size, cut by their place in the stream and not by the chunks; what does
not fill a block waits. So the numbers do not depend, to the last bit, on how the log was cut, and a state that
`checkpoint` has saved and restored goes on as if nothing had happened.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.estimation.inertial_filter import Estimator, State, Trace
from jax_inertia.logs.log import Log, LogError
from jax_inertia.logs.schema import CHANNELS
from jax_inertia.model.robot import Robot
from jax_inertia.preflight.mended import mended, unmeasured
from jax_inertia.preflight.preflight import (
    POSITIONS,
    Preflight,
    Severity,
    preflight,
    require_usable,
)
from jax_inertia.signals.differences import Observation, aligned_differences
from jax_inertia.signals.generalised_motion import generalised
from jax_inertia.text.closest_names import listed

LONGEST_LOOK = 48.0
"""Of a log that is watched so many seconds are looked at, at most [s]."""


class StreamState(eqx.Module):
    """What is carried from chunk to chunk: the filter's state, and the samples that wait."""

    filter: State
    last: Float[np.ndarray, ""]
    """Time of the last observation that was filtered [s]; NaN before the first."""
    waiting: Log | None
    """Fewer samples than fill a block; None before the first chunk."""
    first: Log | None = None
    """The first seconds, kept until they have been looked at (`Stream.look`)."""
    looked: bool = eqx.field(static=True, default=True)
    """Whether they have been."""


class Part(eqx.Module):
    """A stretch of the stream, filtered."""

    time: Float[np.ndarray, " T"]
    trace: Trace


class Stream(eqx.Module):
    """Filter settings and the window; immutable.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation.inertial_filter import make_estimator
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> from jax_inertia.estimation.stream import Stream
    >>> ekf = make_estimator(load_model(double_pendulum()), ["lower"], sigma_tau=0.1)
    >>> chunks = swing().between(0.0, 2.0), swing().between(2.01, 4.0)
    >>> sum(len(part.time) for part in Stream(ekf, window=8, block=16).run(chunks))  # 399 periods
    49
    """

    estimator: Estimator
    window: int = eqx.field(static=True, default=16)
    """Periods of the log that make one observation."""
    block: int = eqx.field(static=True, default=64)
    """Observations that are filtered in one call."""
    look: float = eqx.field(static=True, default=3.0)
    """The log's first seconds, on which all is checked that `estimate` checks on a whole log; zero: nothing is."""

    def __check_init__(self) -> None:
        if self.window < 1 or self.block < 1:
            raise ValueError(f"window {self.window}, block {self.block}; each is one at least")
        if not 0 <= self.look < float("inf"):
            raise ValueError(f"look is {self.look}; it is so many seconds, zero or more")

    def start(self, state: State | None = None) -> StreamState:
        """State before the first chunk, from the filter's own start where none is given."""
        state = self.estimator.initial() if state is None else state
        return StreamState(state, np.asarray(np.nan), None, None, self.look == 0)

    def feed(self, state: StreamState, chunk: Log) -> tuple[StreamState, Part | None]:
        """Take the next chunk; None while it does not fill a block.

        Raises LogError for a chunk that does not fit the robot, holds torques in another unit than N m, lacks
        velocities, has other channels than the one before, or begins no later than that one ended; and once the first
        seconds have come where they are not of this robot and in its units, as `estimate` does (`looked_at`). Torques
        that nobody measured are masked (`preflight.mended`).
        """
        based = chunk.base_pos is not None
        if chunk.qvel is None or (based and None in (chunk.base_linvel, chunk.base_angvel)):
            raise LogError(
                "a stream needs measured velocities: qvel, and of a floating base base_linvel and base_angvel"
            )
        require_usable(chunk, self.estimator.robot, of_many=True)
        chunk, _ = unmeasured(chunk)
        if not state.looked:
            state = self._look(state, chunk)
        return self._advance(state, joined(state.waiting, chunk), whole_blocks=True)

    def _look(self, state: StreamState, chunk: Log) -> StreamState:
        """With the chunk among the first seconds, which are looked at when there are enough."""
        first = joined(state.first, chunk)
        if first.duration < self.look:
            return dataclasses.replace(state, first=first)
        looked_at(first, self.estimator.robot)
        return dataclasses.replace(state, first=None, looked=True)

    def finish(self, state: StreamState) -> tuple[StreamState, Part | None]:
        """Filter what waits; less than one window is left over. Raises LogError before the first chunk."""
        if state.waiting is None:
            raise LogError("the stream has had no chunk yet")
        return self._advance(state, state.waiting, whole_blocks=False)

    def run(self, chunks: Iterable[Log], state: StreamState | None = None) -> Iterator[Part]:
        """All that the chunks give, part by part, with what waits at the end.

        Raises LogError as `feed` does, and at the end where a joint was never measured: what came is the prior's.
        """
        anew, measured = state is None, np.zeros((), bool)
        state = self.start() if state is None else state
        names: tuple[str, ...] = ()
        for chunk in chunks:
            names, measured = chunk.joint_names, measured | _measured(chunk)
            state, part = self.feed(state, chunk)
            if part is not None:
                yield part
        _, part = self.finish(state)
        if part is not None:
            yield part
        if anew and not measured.all():
            lost = listed([n for n, one in zip(names, measured, strict=True) if not one])
            raise LogError(
                f"no sample of {lost} has position, velocity and torque all finite; log them, or leave the joints out"
            )

    def _advance(
        self, state: StreamState, log: Log, *, whole_blocks: bool
    ) -> tuple[StreamState, Part | None]:
        count = (len(log.time) - 1) // self.window
        if whole_blocks:
            count = count // self.block * self.block
        carried, last, parts = state.filter, float(state.last), []
        for first in range(0, count, self.block):
            number = min(self.block, count - first)
            rows = slice(first * self.window, (first + number) * self.window + 1)
            piece = _rows(log, rows)
            observation = self.observed(piece)
            time = np.asarray(observation.motion.time)
            before = 2.0 * float(piece.time[0]) - time[0] if np.isnan(last) else last
            dt = np.diff(time, prepend=before)
            full, dt = jax.tree.map(lambda x: _padded(x, self.block), (observation, dt))
            used = np.arange(self.block) < number
            carried, trace = _filter(self.estimator, carried, full, dt=dt, used=jnp.asarray(used))
            trace = jax.tree.map(lambda x, n=number: np.asarray(x)[:n], trace)
            parts.append(Part(time, trace))
            last = float(time[-1])
        # The last sample of a window is the first of the next.
        left = _rows(log, slice(count * self.window, None))
        part = jax.tree.map(lambda *x: np.concatenate(x), *parts) if parts else None
        return (
            dataclasses.replace(state, filter=carried, last=np.asarray(last), waiting=left),
            part,
        )

    def observed(self, log: Log) -> Observation:
        """One observation for each window of a log, as the filter gets them."""
        motion = dataclasses.replace(generalised(log, self.estimator.robot), notes=())
        return jax.tree.map(lambda x: x[:: self.window], aligned_differences(motion, self.window))


def looked_at(first: Log, robot: Robot, only: Sequence[str] = ()) -> Preflight:
    """What there is to say of a stream's first seconds, the gravest first; LogError where they cannot be used.

    `only` names the checks whose errors count; all do where it is empty.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation.stream import looked_at
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> found = looked_at(swing(), load_model(double_pendulum()))
    >>> found.findings, found.confirmed
    ((), True)
    """
    log, left_out = mended(first, kinds=robot.joint_kinds)
    if log.qvel is None and first.qvel is not None:
        raise LogError(
            f"{left_out[-1].message.partition(';')[0]}; a stream needs velocities: correct them, or estimate from the "
            "whole log, which can do without"
        )
    found = preflight(log, robot)
    counted = (one for one in found.findings if not only or one.check in only)
    Preflight(tuple(counted)).raise_for_errors()
    kept = (one for one in found.findings if one.severity is not Severity.NOTE)
    return Preflight((*left_out, *kept), found.confirmed)


def looked_at_again(first: Log, chunks: Iterable[Log], robot: Robot) -> Iterator[Log]:
    """The chunks that follow a stream's first seconds, looked at until the torque confirms the units of positions.

    A slow motion does not show it at once: all that has come is looked at each time it is twice as long, up to
    `LONGEST_LOOK`. Raises LogError as `looked_at` does, of units and order alone.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation.stream import looked_at_again
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> first, rest = swing().between(0.0, 1.0), swing().between(1.01, 3.9)
    >>> [len(chunk.time) for chunk in looked_at_again(first, [rest], load_model(double_pendulum()))]
    [290]
    """
    due = 2.0 * first.duration
    seen: Log | None = first
    for chunk in chunks:
        if seen is not None:
            seen = joined(seen, chunk)
            if seen.duration >= due:
                found = looked_at(seen, robot, POSITIONS)
                due *= 2.0
                seen = None if found.confirmed or due > LONGEST_LOOK else seen
        yield chunk


def _rows(log: Log, rows: slice) -> Log:
    return log.map_channels(lambda x: np.asarray(x)[rows], time=np.asarray(log.time)[rows])


def _measured(chunk: Log) -> Bool[np.ndarray, " n"]:
    """Of which joints a chunk has a whole sample."""
    channels = (chunk.qpos, chunk.tau, *(() if chunk.qvel is None else (chunk.qvel,)))
    return np.all([np.isfinite(np.asarray(x)) for x in channels], axis=0).any(axis=0)


def joined(waiting: Log | None, chunk: Log) -> Log:
    """Two logs that follow one another as one; raises LogError where they do not, or are not of one log.

    >>> from jax_inertia.estimation.stream import joined
    >>> from jax_inertia.robots.pendulum import swing
    >>> float(joined(swing().between(0.0, 1.0), swing().between(1.01, 2.0)).duration)
    2.0
    """
    chunk = dataclasses.replace(chunk, notes=())
    if waiting is None:
        return _rows(chunk, slice(None))
    if not chunk.time[0] > waiting.time[-1]:
        raise LogError(
            f"a chunk begins at {chunk.time[0]:.6f} s, the one before ended at {waiting.time[-1]:.6f} s; "
            "chunks follow one another"
        )
    one, other = (jax.tree.structure(x) for x in (waiting, chunk))
    if one != other:
        raise LogError(
            "a chunk has other joints, contacts, units or channels than the one before; all chunks are of one log"
        )
    # What has no time axis (noise of a sensor) is that of the first chunk.
    return dataclasses.replace(
        waiting,
        time=np.concatenate([waiting.time, chunk.time]),
        **{
            name: np.concatenate([getattr(waiting, name), value])
            for name, value in _channels(chunk).items()
        },
    )


def _channels(log: Log) -> dict[str, np.ndarray]:
    return {
        name: np.asarray(value) for name in CHANNELS if (value := getattr(log, name)) is not None
    }


def _padded(x: np.ndarray, size: int) -> np.ndarray:
    """The last entry again and again, up to one size: compiled once."""
    return np.asarray(x)[np.minimum(np.arange(size), len(x) - 1)]


_filter = eqx.filter_jit(Estimator.run)
