"""What commands print as JSON against the published schemas."""

import json
from pathlib import Path
from typing import Any

import jsonschema

import jax_inertia

FOLDER = Path(jax_inertia.__file__).parent / "cli" / "schemas"
SCHEMAS = {path.name.removesuffix("-1.schema.json"): path for path in FOLDER.glob("*.json")}


def validated(name: str, printed: str | dict[str, Any]) -> dict[str, Any]:
    """What was printed, as Python has it, if it keeps to the schema of that name."""
    value = json.loads(printed) if isinstance(printed, str) else printed
    schema = json.loads(SCHEMAS[name].read_text())
    jsonschema.Draft202012Validator(schema).validate(value)
    return value
