"""Published schemas of what commands print: each is sound, documented, and refuses what is not of its kind."""

import json
import re
from pathlib import Path

import jsonschema
import pytest
from schemas import SCHEMAS, validated

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("name", sorted(SCHEMAS))
def test_a_schema_is_sound_and_versioned(name):
    schema = json.loads(SCHEMAS[name].read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["properties"]["schema"] == {"const": 1}
    assert "schema" in schema["required"]
    assert schema["$id"] == f"urn:jax-inertia:{name}:1"
    with pytest.raises(jsonschema.ValidationError):
        validated(name, {})
    with pytest.raises(jsonschema.ValidationError):
        validated(name, dict.fromkeys(schema["required"]) | {"schema": 2})


def test_the_page_lists_every_schema():
    page = (ROOT / "docs" / "json.md").read_text()
    listed = set(re.findall(r"cli/schemas/([\w-]+)-1\.schema\.json", page))
    assert listed == set(SCHEMAS)


def test_every_schema_is_held_against_a_command_s_output():
    tests = "".join(p.read_text() for p in Path(__file__).parent.glob("test_*.py"))
    assert {n for n in SCHEMAS if f'validated("{n}"' not in tests} == set()
