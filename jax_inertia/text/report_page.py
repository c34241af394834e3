"""Reports as HTML: one file each, in which nothing is fetched and nothing runs; every name in it is escaped."""

from importlib.metadata import version
from typing import Any

import jinja2


def rendered(
    package: str, filters: dict[str, Any], *, template: str = "report.html", **values: Any
) -> str:
    """A template of a package, filled with `values`; `report.html` extends `page.html`, which has the style sheet."""
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader(
            [jinja2.PackageLoader(package), jinja2.PackageLoader("jax_inertia.text")]
        ),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= filters
    page = environment.get_template(template).render(version=version("jax-inertia"), **values)
    # A wide table scrolls in a box of its own, so that headings and text stay; by the keyboard too.
    box = '<div class="scroll" tabindex="0">'
    return page.replace("<table>", f"{box}<table>").replace("</table>", "</table></div>")


def with_section(page: str, section: str) -> str:
    """A page with one more section at its end, before the line that says what wrote it."""
    before, end, after = page.rpartition('<p class="soft">jax-inertia')
    return f"{before}{section}\n{end}{after}"
