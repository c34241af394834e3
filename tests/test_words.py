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
# In pages for users and in what commands print, beyond the above.
FOR_USERS = {
    r"said": "stated; the message reports",
    r"asked": "requested; checked",
    r"owe[ds]?": "depends on",
    r"foretell|foretold": "predicted",
    r"parts? them": "distinguishes them",
    r"is told|are told": "is reported; is determined",
    r"mend(s|ed)?": "corrected",
    r"in vain": "without effect",
}
DOCS = PACKAGE.parent / "docs"
NAMES = """index start_arm start_policy start_jax diagnose estimate report json motion fleet live
    logs log_meets_model faq limits conventions extending floating_base position_controlled training whole_robot"""
PAGES = [DOCS.parent / "README.md", *(DOCS / f"{name}.md" for name in NAMES.split())]
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


def hits(found: list[tuple[int, str]], words: dict[str, str]) -> list[str]:
    return [
        f"line {line}: {hit.group()!r}, better: {better}"
        for line, text in found
        for pattern, better in words.items()
        for hit in re.finditer(rf"\b({pattern})\b", text, re.IGNORECASE)
    ]


def retired(source: str) -> list[str]:
    return hits(texts(source), RETIRED)


def prose(page: str) -> list[tuple[int, str]]:
    """A page's paragraphs without code and quoted outputs, which are the tool's own words."""
    page = re.sub(r"```.*?```|`[^`]*`", lambda m: "\n" * m[0].count("\n"), page, flags=re.DOTALL)
    page = re.sub(r"^    .*$", "", page, flags=re.MULTILINE)
    return [(1, " ".join(page.split()))]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_retired_words_do_not_come_back(path):
    assert retired(path.read_text()) == []


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_pages_for_users_speak_plainly(path):
    found = hits(prose(path.read_text()), RETIRED | FOR_USERS)
    assert found == []


def test_the_rule_for_pages_can_fail():
    assert hits(prose("What the log\nis told, and `said`."), FOR_USERS)
    assert not hits(prose("It is `said`.\n\n    as the tool said\n"), FOR_USERS)


def printed(source: str) -> list[tuple[int, str]]:
    """Strings of a module that are not docstrings: errors, notes, help."""
    tree = ast.parse(source)
    documented = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    return [
        (node.lineno, " ".join(re.sub("`[^`]*`", "", node.value).split()))
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and id(node) not in documented
        and " " in node.value
    ]


@pytest.mark.parametrize(
    "path",
    [p for p in FILES if p.suffix == ".py"],
    ids=lambda path: path.relative_to(PACKAGE).as_posix(),
)
def test_what_commands_print_is_plain(path):
    assert hits(printed(path.read_text()), FOR_USERS) == []


def test_the_rule_can_fail():
    assert retired('x = 1  # What is\nf"""the missing\ntorque of {x}"""')
    assert not retired('"""Rows left out; see `told`."""\nbeside = 1')
