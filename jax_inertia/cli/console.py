"""What the commands share: progress on the terminal, and output that appears whole or not at all."""

import contextlib
import glob
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from jax_inertia.logs.atomic_files import held


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
    """Show warnings of the package and of MuJoCo as one line each.

    Others, of NumPy's and SciPy's arithmetic, are for who works on the package: shown where Python is asked to (-W).
    """
    from jax_inertia.model.load import ModelWarning
    from jax_inertia.model.mujoco_warnings import mujoco_warnings

    with warnings.catch_warnings(), mujoco_warnings(warn):
        usual = warnings.showwarning

        def show(message, category, *rest, **more):
            if issubclass(category, ModelWarning):
                warn(str(message))
            elif sys.warnoptions:
                usual(message, category, *rest, **more)

        warnings.simplefilter("always", ModelWarning)
        warnings.showwarning = show
        yield


def folder_for(log: Path) -> Path:
    """Where the results of a log go when nothing is said: out/<its name>, and never above out."""
    return Path("out") / (log.stem.strip(". ") or "log")


@contextlib.contextmanager
def output_folder(out: Path, of: str = "report") -> Iterator[Path]:
    """A temporary folder inside `out` whose files move up to `out` at the end, if all went well.

    Made before the work starts, so that a place that cannot be written is known at once. One run at a time writes one
    thing (`of`) there, so that no report is of two; what one that was killed has left is removed. Raises ValueError
    for a place that cannot be written, or where another run is writing.
    """
    made = [p for p in (out, *out.parents) if not p.exists()]
    try:
        with contextlib.ExitStack() as stack:
            try:
                out.mkdir(parents=True, exist_ok=True)
                alone = stack.enter_context(_alone(out / f".part-{of}.lock"))
                part = Path(tempfile.mkdtemp(prefix=f".part-{of}-", dir=out))
            except OSError as error:
                reason = error.strerror or type(error).__name__
                raise ValueError(
                    f"cannot write to {out}: {reason}; give another folder with --out"
                ) from None
            stack.callback(shutil.rmtree, part, ignore_errors=True)
            if alone is False:
                raise ValueError(
                    f"cannot write to {out}: another run is writing there; wait for it, or give another folder with "
                    "--out"
                )
            for orphan in out.glob(f".part-{glob.escape(of)}-????????"):
                # Who made it and still lived would hold the lock.
                # By name: mkdtemp gives an absolute path from Python 3.12 on, a glob what it was asked.
                if alone and orphan.name != part.name:
                    shutil.rmtree(orphan, ignore_errors=True)
            yield part
            for file in sorted(part.iterdir()):
                os.replace(file, out / file.name)
    finally:
        for folder in made:
            # Only what is still empty: an unfinished run leaves no trace.
            with contextlib.suppress(OSError):
                folder.rmdir()


@contextlib.contextmanager
def _alone(lock: Path) -> Iterator[bool | None]:
    """Whether no other process is in such a block with the same file, which is gone afterwards; None if unknown."""
    while True:
        with open(lock, "ab") as file:
            alone = held(file)
            # The one before may have removed the file between its opening and its lock.
            if alone and not _is_still(file.fileno(), lock):
                continue
            try:
                yield alone
            finally:
                if alone is not False:
                    lock.unlink(missing_ok=True)
            return


def _is_still(opened: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(opened), path.stat())
    except OSError:
        return False
