"""Docstrings, comments and messages speak the field's standard terms; words that were given up do not come back."""

import ast
import io
import re
import tokenize
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "jax_inertia"
# Pattern: what to say instead (docs/glossary.md).
RETIRED = {
    r"what (is|was) left(?! out)": "residual, remainder",
    r"missing torque": "torque residual",
    r"beside": "given, with; compared with; next to",
    r"told": "stated, identified; commanded, position target",
    r"loud|louder|loudness": "variance ratio",
    r"charged": "marginalised",
    r"outsiders?": "generic alternative",
    r"strain|strains|strained": "prior violation",
}
# Of effects, words on the report's page are older than this table.
OLD = (PACKAGE / "diagnosis/effects",)
FILES = [
    path
    for path in sorted(PACKAGE.rglob("*.*"))
    if path.suffix in (".py", ".html") and not set(OLD) & set(path.parents)
]


def texts(source: str) -> list[tuple[int, str]]:
    """(line, text) of every string and comment of Python; a page is all text."""
    if source.startswith(("<", "{%")):
        return list(enumerate(source.splitlines(), 1))
    found = [
        (node.lineno, node.value)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    found += [(t.start[0], t.string) for t in tokens if t.type == tokenize.COMMENT]
    # Names of code, in backticks, are no words; words are not broken by the end of a line.
    return [(line, " ".join(re.sub("`[^`]*`", "", text).split())) for line, text in found]


def retired(source: str) -> list[str]:
    return [
        f"line {line}: {hit.group()!r}, better: {better}"
        for line, text in texts(source)
        for pattern, better in RETIRED.items()
        for hit in re.finditer(rf"\b({pattern})\b", text, re.IGNORECASE)
    ]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_retired_words_do_not_come_back(path):
    assert retired(path.read_text()) == []


def test_the_rule_can_fail():
    assert retired('x = 1  # What is\nf"""the missing\ntorque of {x}"""')
    assert not retired('"""Rows left out; see `told`."""\nbeside = 1')
