"""The pages of docs/ name files that exist, and the figure has a place for every folder."""

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs").glob("*.md"))
# A file that a recipe's reader makes.
TO_BE_MADE = {"jax_inertia/logs/readers/NAME.py"}


def named_paths(text: str) -> set[str]:
    """Paths from the checkout's root in backticks."""
    return set(re.findall(r"`((?:jax_inertia|tests|benchmarks|docs)/[\w./]+)`", text)) - TO_BE_MADE


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_and_paths_lead_somewhere(page):
    text = page.read_text()
    links = {link for link in re.findall(r"\]\(([^)#]+)\)", text) if "://" not in link}
    assert [link for link in sorted(links) if not (page.parent / link).exists()] == []
    paths = named_paths(text)
    if not (ROOT / "jax_inertia" / "diagnosis").exists():
        paths = {path for path in paths if not path.startswith("jax_inertia/diagnosis/")}
    assert [path for path in sorted(paths) if not (ROOT / path).exists()] == []


def test_the_recipes_name_paths():
    assert len(named_paths((ROOT / "docs" / "contributing.md").read_text())) > 10


def test_the_figure_has_every_folder_and_every_arrow_points_down():
    figure = runpy.run_path(str(ROOT / "docs" / "figures" / "architecture.py"))
    modules, arrows = figure["imports"]()
    places = figure["FOLDERS"]
    assert set(modules) <= set(places)
    assert len(arrows) > 20
    upward = [(a, b) for a, b in arrows if places[b][3] >= places[a][3]]
    assert upward == []


def test_the_page_of_effects_is_what_the_registry_says():
    page = runpy.run_path(str(ROOT / "docs" / "effects.py"))["text"]()
    assert (ROOT / "docs" / "effects.md").read_text() == page, "run python docs/effects.py"
