"""What the commands share: one-line messages, and output that appears whole or not at all."""

import _thread
import contextlib
import glob
import io
import os
import shutil
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

from jax_inertia.fleet.running import ENDS_WITH_INPUT, GRACE
from jax_inertia.logs.atomic_files import held
from jax_inertia.text.remedies import usable


def in_utf_8() -> None:
    """Write UTF-8 to files and pipes whatever the locale says; on a terminal, a mark for what it cannot show."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(encoding=None if stream.isatty() else "utf-8", errors="replace")


def end_with_input() -> None:
    """Be interrupted when the standard input ends, where the environment asks for it: who started this has gone."""
    if not os.environ.pop(ENDS_WITH_INPUT, ""):
        return

    def wait() -> None:
        with contextlib.suppress(OSError):
            while os.read(0, 4096):
                pass
        _thread.interrupt_main()
        time.sleep(GRACE)
        os._exit(130)

    threading.Thread(target=wait, daemon=True).start()


def warn(message: str) -> None:
    """One line on stderr."""
    print(f"jax-inertia: warning: {usable(one_line(message))}", file=sys.stderr)


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
def output_folder(out: Path, of: str = "report", products: Sequence[str] = ()) -> Iterator[Path]:
    """A temporary folder inside `out` whose files move up to `out` at the end, if all went well.

    Made before the work starts, so that a place that cannot be written is known at once. One run at a time writes one
    thing (`of`) there, so that no report is of two; what one that was killed has left is removed, and at the end what
    an earlier run has left of the `products` that this one did not make. Whoever is killed leaves the files of the
    earlier run, or of this one, or no JSON. Raises ValueError for a place that cannot be
    written, or where another run is writing.
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
            new = sorted(part.iterdir(), key=lambda file: (file.suffix == ".json", file.name))
            names, told = {f.name for f in new}, {f.name for f in new if f.suffix == ".json"}
            # JSON says what the other files are: the earlier run's goes first and this one's comes last, so that it is
            # never among files of two runs.
            for name in sorted({*products} - names | told, key=lambda x: not x.endswith(".json")):
                (out / name).unlink(missing_ok=True)
            for file in new:
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
