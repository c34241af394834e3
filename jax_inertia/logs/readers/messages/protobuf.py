"""Protocol buffers messages by the descriptors that come along with them, without generated code.

Format: protobuf.dev/programming-guides/encoding; descriptors: google/protobuf/descriptor.proto. The package `protobuf`
would make classes from what a file brings along; here its descriptors are data.
"""

import dataclasses
import struct
from collections.abc import Iterator, Mapping
from typing import Any

_DEEPEST, _MOST_FIELDS = 20, 100_000
_DOUBLE, _FLOAT, _STRING, _MESSAGE, _BYTES = 1, 2, 9, 11, 12
_FIXED = {_DOUBLE: "<d", _FLOAT: "<f", 6: "<Q", 7: "<I", 15: "<i", 16: "<q"}
_SIGNED, _ZIGZAG, _VARINT = (3, 5, 14), (17, 18), (3, 4, 5, 8, 13, 14, 17, 18)
_REPEATED = 3


@dataclasses.dataclass(frozen=True)
class _Field:
    name: str
    type: int
    repeated: bool
    message: str
    """Full name of its type, of fields that hold a message."""
    has_default: bool
    """It is left out where it is zero (proto3 without `optional`)."""


Types = Mapping[str, Mapping[int, _Field]]


def types_of(descriptors: bytes) -> Types:
    """Fields by number of every message type in a serialised FileDescriptorSet; ValueError where it is damaged."""
    out: dict[str, dict[int, _Field]] = {}
    for number, file in _fields(descriptors):
        if number == 1:
            parts = list(_fields(_bytes(file)))
            package = next((_text(v) for n, v in parts if n == 2), "")
            plain = any(n == 12 and _text(v) == "proto3" for n, v in parts)
            for kind in (v for n, v in parts if n == 4):
                _add_type(out, package, _bytes(kind), plain, 0)
    return out


def decoded(types: Types, name: str, data: bytes, depth: int = 0) -> dict[str, Any]:
    """One message as a dictionary: numbers, texts, bytes, lists and dictionaries by field name.

    Raises ValueError where the data is damaged, its type is not among `types`, or messages lie too deep.
    """
    if name not in types:
        raise ValueError(f"no descriptor of the message type {name[:60]!r}")
    if depth > _DEEPEST:
        raise ValueError("messages lie in each other too deep")
    own, out = types[name], {}
    for field in own.values():
        if field.repeated:
            out[field.name] = []
        elif field.has_default:
            out[field.name] = "" if field.type == _STRING else 0
    for number, raw in _fields(data):
        if (field := own.get(number)) is None:
            continue
        # Numbers packed together come with a length; a single one of a fixed width has none.
        packed = field.repeated and field.type in (*_FIXED, *_VARINT)
        if packed and isinstance(raw, bytes) and not isinstance(raw, _Raw):
            out[field.name] += _packed(field.type, raw)
            continue
        value = (
            decoded(types, field.message, _bytes(raw), depth + 1)
            if field.type == _MESSAGE
            else _value(field.type, raw)
        )
        if field.repeated:
            out[field.name].append(value)
        else:
            out[field.name] = value
    return out


def _add_type(
    out: dict[str, dict[int, _Field]], scope: str, data: bytes, plain: bool, depth: int
) -> None:
    parts = list(_fields(data))
    name = ".".join(
        part for part in (scope, next((_text(v) for n, v in parts if n == 1), "")) if part
    )
    if depth > _DEEPEST or len(out) > _MOST_FIELDS:
        raise ValueError("more message types than make sense")
    out[name] = {}
    for number, value in parts:
        if number == 2:
            said = dict(_fields(_bytes(value)))
            kind, label = int(said.get(5, 0)), int(said.get(4, 1))
            has_default = plain and not said.get(17) and kind not in (_MESSAGE, _BYTES)
            out[name][int(said.get(3, 0))] = _Field(
                _text(said.get(1, b"")),
                kind,
                label == _REPEATED,
                _text(said.get(6, b"")).lstrip("."),
                has_default and label != _REPEATED,
            )
        elif number == 3:
            _add_type(out, name, _bytes(value), plain, depth + 1)


# --- wire format -------------------------------------------------------------------------------------------------


class _Raw(bytes):
    """Four or eight bytes of a fixed width, as against bytes of a length that they state."""


def _fields(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """(field number, value) as they come: whole numbers, or bytes."""
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        number, wire = tag >> 3, tag & 7
        if wire == 0:
            value, at = _varint(data, at)
            yield number, value
            continue
        if wire == 2:
            size, at = _varint(data, at)
        elif wire in (1, 5):
            size = 8 if wire == 1 else 4
        else:
            raise ValueError("a message of protocol buffers is damaged")
        if at + size > len(data):
            raise ValueError("a message of protocol buffers is cut off")
        part = data[at : at + size]
        yield number, part if wire == 2 else _Raw(part)
        at += size


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            raise ValueError("a message of protocol buffers is cut off")
        byte = data[at]
        value, at = value | (byte & 0x7F) << shift, at + 1
        if byte < 0x80:
            return value, at
    raise ValueError("a message of protocol buffers is damaged")


def _packed(kind: int, raw: bytes) -> list[float]:
    if kind in _FIXED:
        return [value for (value,) in struct.iter_unpack(_FIXED[kind], raw)]
    out, at = [], 0
    while at < len(raw):
        value, at = _varint(raw, at)
        out.append(_value(kind, value))
    return out


def _value(kind: int, raw: int | bytes) -> Any:
    if kind in _FIXED and isinstance(raw, bytes) and len(raw) == struct.calcsize(_FIXED[kind]):
        return struct.unpack(_FIXED[kind], raw)[0]
    if kind == _STRING:
        return _text(raw)
    if isinstance(raw, int) and kind in _VARINT:
        if kind in _ZIGZAG:
            return (raw >> 1) ^ -(raw & 1)
        # Negative numbers are written as their two's complement of 64 bits.
        return raw - (1 << 64) if kind in _SIGNED and raw >= 1 << 63 else raw
    if kind == _BYTES:
        return _bytes(raw)
    raise ValueError("a field of protocol buffers is not what its descriptor says")


def _bytes(raw: int | bytes) -> bytes:
    if not isinstance(raw, bytes):
        raise ValueError("a field of protocol buffers is not what its descriptor says")
    return raw


def _text(raw: int | bytes) -> str:
    return _bytes(raw).decode("utf-8")
