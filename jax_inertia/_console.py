"""What the commands share: progress on the terminal, and output that appears whole or not at all."""

import contextlib
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn


@contextlib.contextmanager
def stages() -> Iterator[Callable[[str], None]]:
    """Say what is being done, with the time it has taken, while the block runs; silent where nobody watches."""
    console = Console(stderr=True)
    columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
    watched = console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=not watched) as progress:
        task = progress.add_task("starting", total=None)
        yield lambda text: progress.reset(task, description=text, total=None)


def warn(message: str) -> None:
    """One line on stderr."""
    print(f"jax-inertia: warning: {one_line(message)}", file=sys.stderr)


def one_line(message: object) -> str:
    """A message without line breaks, and without what moves a terminal's cursor: names come from files."""
    text = " ".join(str(message).split())
    return "".join(c if c.isprintable() else "?" for c in text)


@contextlib.contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Show the package's own warnings as one line each, and others as Python does."""
    from jax_inertia.mjcf import ModelWarning

    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(message, category, *rest, **more):
            if issubclass(category, ModelWarning):
                warn(str(message))
            else:
                usual(message, category, *rest, **more)

        warnings.simplefilter("always", ModelWarning)
        warnings.showwarning = show
        yield


def folder_for(log: Path) -> Path:
    """Where the results of a log go when nothing is said: out/<its name>, and never above out."""
    return Path("out") / (log.stem.strip(". ") or "log")


@contextlib.contextmanager
def output_folder(out: Path) -> Iterator[Path]:
    """A temporary folder inside `out` whose files move up to `out` at the end, if all went well.

    Made before the work starts, so that a place that cannot be written is known at once. Raises ValueError then.
    """
    made = [p for p in (out, *out.parents) if not p.exists()]
    try:
        out.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=".part-", dir=out))
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise ValueError(
            f"cannot write to {out}: {reason}; give another folder with --out"
        ) from None
    try:
        yield part
        for file in sorted(part.iterdir()):
            os.replace(file, out / file.name)
    finally:
        shutil.rmtree(part, ignore_errors=True)
        for folder in made:
            # Only what is still empty: an unfinished run leaves no trace.
            with contextlib.suppress(OSError):
                folder.rmdir()
