"""A diagnosis along time as MCAP with channels in JSON, which Foxglove opens: lines to plot, and events in its log."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.result import Diagnosis
from jax_inertia.logs.readers.options import required
from jax_inertia.replay.result import Diagnosis as ReplayDiagnosis

NAME = "diagnosis.mcap"
_INFO, _WARNING = 2, 3
"""Levels of `foxglove.Log`."""


class Event(NamedTuple):
    """A message with its time, a line of the log."""

    time: float
    """s."""
    level: int
    text: str


class Recording(NamedTuple):
    """Lines of joints along time."""

    time: Float[np.ndarray, " T"]
    """s."""
    joints: tuple[str, ...]
    lines: Mapping[str, Float[np.ndarray, "T n"]]
    """By topic."""
    events: Sequence[Event]


def by_torque(found: Diagnosis) -> Recording:
    """Torque of the checked run [N m, N]: measured, by the nominal model, with what was found, and what remains."""
    trace = found.trace
    measured = trace.state["tau"]
    lines = {
        "/torque/measured": measured,
        "/torque/nominal": measured + trace.before,
        "/torque/corrected": measured + trace.after,
        "/torque/residual": trace.after,
    }
    texts = [(_INFO, found.headline), *((_INFO, note) for note in found.notes)]
    start = float(trace.time[0])
    events = [Event(start, *one) for one in texts]
    for begin, end in found.when:
        text = f"the torque residual stands out from {begin:.3g} to {end:.3g} s"
        events.append(Event(max(begin, start), _WARNING, text))
    return Recording(trace.time, trace.rows, lines, events)


def by_replays(found: ReplayDiagnosis, joints: Sequence[str]) -> Recording:
    """Positions of the run that the nominal model misses most [rad, m]: targets, robot, both models, what remains."""
    r = found.replayed
    record, nominal, corrected = r.records[r.shown], r.nominal[r.shown], r.corrected[r.shown]
    lines = {
        "/position/target": record.target,
        "/position/measured": record.q,
        "/position/nominal": nominal,
        "/position/corrected": corrected,
        "/position/residual": corrected - record.q,
    }
    events = [Event(float(record.time[0]), _INFO, found.headline)]
    return Recording(record.time, tuple(joints), lines, events)


def write(path: Path, recording: Recording) -> None:
    """Write the file. Raises LogError where the package mcap is not installed.

    A message of a line is an object with a number for each joint, null where it is not finite; its time of recording is
    that of the log.
    """
    writer = required("mcap.writer", "MCAP").Writer(str(path))
    writer.start(profile="", library="jax_inertia")
    own = {name: {"type": ["number", "null"]} for name in recording.joints}
    schema = writer.register_schema(
        "jax_inertia.Joints",
        "jsonschema",
        json.dumps({"type": "object", "properties": own}).encode(),
    )
    stamps = [round(1e9 * max(float(time), 0.0)) for time in recording.time]
    for topic, values in recording.lines.items():
        channel = writer.register_channel(topic, "json", schema)
        for stamp, row in zip(stamps, np.asarray(values, float).tolist(), strict=True):
            numbers = [x if np.isfinite(x) else None for x in row]
            content = dict(zip(recording.joints, numbers, strict=True))
            writer.add_message(channel, stamp, json.dumps(content).encode(), stamp)
    schema = writer.register_schema("foxglove.Log", "jsonschema", json.dumps(_LOG).encode())
    channel = writer.register_channel("/events", "json", schema)
    for event in recording.events:
        stamp = round(1e9 * max(event.time, 0.0))
        content = {
            "timestamp": {"sec": stamp // 10**9, "nsec": stamp % 10**9},
            "level": event.level,
            "message": event.text,
            "name": "jax_inertia",
            "file": "",
            "line": 0,
        }
        writer.add_message(channel, stamp, json.dumps(content).encode(), stamp)
    writer.finish()


_LOG = {
    "type": "object",
    "properties": {
        "timestamp": {
            "type": "object",
            "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
        },
        "level": {"type": "integer"},
        "message": {"type": "string"},
        "name": {"type": "string"},
        "file": {"type": "string"},
        "line": {"type": "integer"},
    },
}
