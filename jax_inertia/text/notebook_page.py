"""What people see of an object: small pages for notebooks. Names come from files, so all text is escaped."""

import contextlib
import html
import time
from collections.abc import Iterable, Iterator, Sequence

import jax
import numpy as np
from jax.core import Tracer


def has_numbers(x: object) -> bool:
    """Whether an array holds values that can be shown: inside `jit`, and in a tree of shapes, it does not."""
    return isinstance(x, np.ndarray | jax.Array) and not isinstance(x, Tracer)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of texts, aligned to the left."""
    style = ' style="text-align:left"'
    top = "".join(f"<th{style}>{html.escape(text)}</th>" for text in head)
    body = "".join(
        "<tr>" + "".join(f"<td{style}>{html.escape(text)}</td>" for text in row) + "</tr>"
        for row in rows
    )
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def line(text: str, *, strong: bool = False) -> str:
    """A paragraph."""
    inner = html.escape(text)
    return f"<p><b>{inner}</b></p>" if strong else f"<p>{inner}</p>"


@contextlib.contextmanager
def working(what: str) -> Iterator[None]:
    """Say what takes its time while it does, and how long it took.

    >>> from jax_inertia.text.notebook_page import working
    >>> with working("adding"):
    ...     total = 1 + 1
    adding ... 0 s
    """
    print(f"{what} ...", end="", flush=True)
    start = time.perf_counter()
    yield
    print(f" {time.perf_counter() - start:.0f} s", flush=True)
