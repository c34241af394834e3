"""Writing MJCF elements from numbers."""

import xml.etree.ElementTree as ET
from collections.abc import Iterable

Attribute = str | int | float | Iterable[int | float]


def element(parent: ET.Element, tag: str, **values: Attribute) -> ET.Element:
    """Add a child with these attributes; numbers are written so that they read back unchanged."""
    return ET.SubElement(parent, tag, {key: _text(value) for key, value in values.items()})


def _text(value: Attribute) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, int | float):
        return repr(value)
    return " ".join(repr(number) for number in value)
