"""The messages of ROS 1 bags, MCAP files and ROS 2 sqlite3 bags, in the order they lie there.

Every file is read once from front to back. Its own index is not used: an index can send a reader over the same chunk
without end, and a file that was not closed properly has none. Compressed chunks are unfolded within a bound.
"""

import bz2
import contextlib
import dataclasses
import io
import re
import sqlite3
import struct
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.readers.messages.plain import PLAIN, ros_kind
from jax_inertia.logs.readers.options import required

# `ros2 bag record --compression-mode file`.
_PACKED = ".zstd"
_MOST_RECORD = 1 << 28
_MOST_RATIO, _ALWAYS_ALLOWED = 100, 1 << 30
_MOST_STEPS = 1_000_000


class Message(NamedTuple):
    """One message as it was recorded."""

    topic: str
    kind: str
    """Its type, as in ROS 2: package/msg/Name."""
    encoding: str
    """`cdr` (ROS 2), `ros1`, `json` or `protobuf`."""
    received_ns: int
    data: bytes
    schema: tuple[str, bytes] = ("", b"")
    """Name and descriptors of its type, of messages that are not ROS's."""


class _Unfolding:
    """How much compressed data may unfold to, by the size of the file that holds it."""

    def __init__(self, path: Path) -> None:
        self.left = max(_ALWAYS_ALLOWED, _MOST_RATIO * path.stat().st_size)

    def bytes_of(self, data: bytes, compression: str, size: int) -> bytes:
        """Unfold a chunk that is declared to hold `size` bytes."""
        if compression in ("", "none"):
            return data
        if size > min(_MOST_RECORD, self.left):
            raise LogError(
                f"a chunk of {len(data)} bytes unfolds to {size}; at most {min(_MOST_RECORD, self.left)} make sense"
            )
        self.left -= size
        if compression == "lz4":
            frame = required("lz4.frame", "lz4 bags")
            out = frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        elif compression == "bz2":
            out = bz2.BZ2Decompressor().decompress(data, max_length=size + 1)
        elif compression == "zstd":
            zstd = required("zstandard", "zstd bags")
            with zstd.ZstdDecompressor().stream_reader(io.BytesIO(data)) as stream:
                out = stream.read(size + 1)
        else:
            raise LogError(f"compression {compression[:20]!r} is not known; expected lz4 or zstd")
        if len(out) != size:
            raise LogError("a chunk does not unfold to the size it declares: damaged or forged")
        return out


def ros2_name(kind: str) -> str:
    """A message type as ROS 2 spells it."""
    package, _, name = kind.partition("/")
    return f"{package}/msg/{name}" if name and "/" not in name else kind


def kind_of(path: Path) -> str:
    """The ending of a bag's file, less that of a compression of the file as a whole."""
    name = path.name.lower()
    return Path(name.removesuffix(_PACKED)).suffix


@contextlib.contextmanager
def _unpacked(path: Path) -> Iterator[Path]:
    """The file; one that was compressed as a whole, unfolded to a temporary one, within bounds."""
    if not path.name.lower().endswith(_PACKED):
        yield path
        return
    zstd = required("zstandard", "zstd bags")
    left = _Unfolding(path).left
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / path.name[: -len(_PACKED)]
        unfold = zstd.ZstdDecompressor().stream_reader
        with open(path, "rb") as packed, open(whole, "xb") as out, unfold(packed) as stream:
            while block := stream.read(1 << 20):
                left -= len(block)
                if left < 0:
                    raise LogError("unfolds to more than makes sense")
                out.write(block)
        yield whole


def messages(path: Path) -> Iterator[Message]:
    """All messages of one file; `LogError` for one that is damaged."""
    read = {".bag": _bag, ".mcap": _mcap, ".db3": _db3}[kind_of(path)]
    try:
        with _unpacked(path) as whole:
            yield from read(whole)
    except LogError:
        raise
    except MemoryError:
        raise LogError("needs more memory than there is") from None
    except Exception as error:
        # Damaged files make the libraries raise nearly anything.
        text = " ".join(str(error).split())[:200]
        name = type(error).__name__
        raise LogError(
            f"not a sound {path.suffix} file ({text or name}): truncated, or not closed when it was recorded?"
        ) from None


# --- ROS 1 -------------------------------------------------------------------------------------------------------


def _bag(path: Path) -> Iterator[Message]:
    """Format 2.0 (wiki.ros.org/Bags/Format/2.0): records of a header, fields name=value, and data."""
    unfolding, connections = _Unfolding(path), {}
    with open(path, "rb") as file:
        if file.read(13) != b"#ROSBAG V2.0\n":
            raise LogError("not a ROS 1 bag of format 2.0")
        for header, data in _records(file):
            op = header.get("op")
            if op == b"\x05":
                (size,) = struct.unpack("<I", header["size"])
                chunk = unfolding.bytes_of(data, header["compression"].decode(), size)
                for inner, content in _records(io.BytesIO(chunk)):
                    yield from _ros1_message(inner, content, connections)
            else:
                yield from _ros1_message(header, data, connections)


def _records(file: io.BufferedIOBase) -> Iterator[tuple[dict[str, bytes], bytes]]:
    while start := file.read(4):
        header = _fields(_exactly(file, struct.unpack("<I", start)[0]))
        (size,) = struct.unpack("<I", _exactly(file, 4))
        yield header, _exactly(file, size)


def _exactly(file: io.BufferedIOBase, size: int) -> bytes:
    if size > _MOST_RECORD:
        raise LogError(f"a record declares {size} bytes; at most {_MOST_RECORD} make sense")
    data = file.read(size)
    if len(data) != size:
        raise LogError("the file ends within a record: truncated?")
    return data


def _fields(header: bytes) -> dict[str, bytes]:
    out, at = {}, 0
    while at < len(header):
        (size,) = struct.unpack_from("<I", header, at)
        name, sep, value = header[at + 4 : at + 4 + size].partition(b"=")
        if not sep:
            raise LogError("a record's header has a field without a value: damaged?")
        out[name.decode()] = value
        at += 4 + size
    return out


def _ros1_message(
    header: Mapping[str, bytes], data: bytes, connections: dict[bytes, tuple[str, str]]
) -> Iterator[Message]:
    op = header.get("op")
    if op == b"\x07":
        kind = _fields(data)["type"].decode()
        connections[header["conn"]] = header["topic"].decode(), ros2_name(kind)
    elif op == b"\x02":
        seconds, nanoseconds = struct.unpack("<II", header["time"])
        topic, kind = connections[header["conn"]]
        yield Message(topic, kind, "ros1", seconds * 10**9 + nanoseconds, data)


# --- MCAP --------------------------------------------------------------------------------------------------------


def _mcap(path: Path) -> Iterator[Message]:
    stream = required("mcap.stream_reader", "MCAP")
    records = required("mcap.records", "MCAP")
    unfolding, schemas, channels = _Unfolding(path), {}, {}

    def flat(reader: Any) -> Iterator[Any]:
        for record in reader.records:
            if isinstance(record, records.Chunk):
                raw = unfolding.bytes_of(record.data, record.compression, record.uncompressed_size)
                plain = dataclasses.replace(record, compression="", data=raw)
                yield from stream.breakup_chunk(plain, validate_crc=True)
            else:
                yield record

    with open(path, "rb") as file:
        reader = stream.StreamReader(file, emit_chunks=True, record_size_limit=_MOST_RECORD)
        for record in flat(reader):
            if isinstance(record, records.Schema):
                schemas[record.id] = record.name, bytes(record.data)
            elif isinstance(record, records.Channel):
                schema = schemas.get(record.schema_id, ("", b""))
                plain = record.message_encoding in PLAIN
                kind = ros_kind(schema[0]) if plain else ros2_name(schema[0])
                its = schema if plain else ("", b"")
                channels[record.id] = record.topic, kind, record.message_encoding, its
            elif isinstance(record, records.Message):
                topic, kind, encoding, schema = channels[record.channel_id]
                yield Message(topic, kind, encoding, record.log_time, record.data, schema)


# --- ROS 2, sqlite3 ----------------------------------------------------------------------------------------------


def _db3(path: Path) -> Iterator[Message]:
    # `immutable` keeps SQLite from looking for, or writing, files next to it.
    database = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    try:
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MOST_RECORD)
        database.execute("PRAGMA trusted_schema = OFF")
        _plain_tables(database)
        size = max(path.stat().st_size, 1 << 20)
        # A row takes a few dozen steps; what takes more steps than bytes is not reading the file.
        ticks = iter(range(8 * size // _MOST_STEPS + 100))
        database.set_progress_handler(lambda: next(ticks, None) is None, _MOST_STEPS)
        topics = {
            number: (str(name), ros2_name(str(kind)), str(encoding))
            for number, name, kind, encoding in database.execute(
                "SELECT id, name, type, serialization_format FROM topics"
            )
        }
        rows = database.execute("SELECT topic_id, timestamp, data FROM messages")
        for number, received, data in rows:
            if number not in topics or not isinstance(data, bytes) or not isinstance(received, int):
                raise LogError("a row of its table messages is not a message: damaged?")
            if data[:4] == b"\x28\xb5\x2f\xfd":
                raise LogError(
                    "its messages are compressed one by one; write them plain with: ros2 bag convert"
                )
            yield Message(*topics[number], received, data)
    finally:
        database.close()


def _plain_tables(database: sqlite3.Connection) -> None:
    """Refuse what is no plain table: a view or a computed column can run for ever."""
    found = {}
    for name, kind, text in database.execute(
        "SELECT name, type, sql FROM sqlite_master WHERE name IN ('topics', 'messages')"
    ):
        found[name] = kind == "table" and not re.search(r"\b(AS|VIRTUAL)\b", text or "", re.I)
    if found != {"topics": True, "messages": True}:
        raise LogError("a database without the plain tables topics and messages: not a ROS 2 bag")
