"""The tests themselves: each can fail."""

import ast
from pathlib import Path

import pytest

FILES = sorted(Path(__file__).parent.glob("test_*.py"))
HELPERS = (
    "def inner(x):\n    assert x\n\ndef outer(x):\n    inner(x)\n\ndef run(x):\n    return x\n"
)


def checks(function: ast.FunctionDef, helpers: set[str]) -> bool:
    """Whether it asserts, expects an error or a warning, or calls NumPy's `assert_...` or a helper."""
    for node in ast.walk(function):
        if isinstance(node, ast.Assert):
            return True
        if not isinstance(node, ast.Call):
            continue
        name = getattr(node.func, "attr", "")
        if name.startswith("assert_") or name in ("raises", "warns"):
            return True
        if isinstance(node.func, ast.Name) and node.func.id in helpers:
            return True
    return False


def without_assertion(source: str) -> list[str]:
    """Tests of a file that neither assert nor call a function of the file that does."""
    functions = [x for x in ast.walk(ast.parse(source)) if isinstance(x, ast.FunctionDef)]
    helpers: set[str] = set()
    while more := {f.name for f in functions if checks(f, helpers)} - helpers:
        helpers |= more
    return [f.name for f in functions if f.name.startswith("test_") and f.name not in helpers]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_test_asserts(path):
    assert without_assertion(path.read_text()) == []


@pytest.mark.parametrize(
    ("body", "asserts"),
    [
        ("run(1)", False),
        ("one.outer(1)", False),
        ("assert run(1) == 1", True),
        ("np.testing.assert_allclose(run(1), 1.0)", True),
        ("with pytest.raises(ValueError): run(1)", True),
        ("outer(1)", True),
    ],
)
def test_a_test_without_assertion_is_seen(body, asserts):
    found = without_assertion(f"{HELPERS}\ndef test_one():\n    {body}\n")
    assert found == ([] if asserts else ["test_one"])
