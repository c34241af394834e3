"""What is being done, while it is being done: a bar on a terminal, else a line for each stage, both on stderr."""

import contextlib
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from jax_inertia.text.progress import Stage, share_of, shared

QUIET = 2.0
"""Lines of stages wait for so long: a command that ends or fails before prints none [s]."""
EVERY = 10.0
"""A stage of many steps prints a line no more often than this [s]."""


class _Interrupts:
    """Ctrl-C, where it was pressed."""

    pressed = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.pressed = True
        raise KeyboardInterrupt


_interrupts = _Interrupts()


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """While the block runs, Ctrl-C ends it at the next stage at the latest.

    Python raises KeyboardInterrupt wherever it is: in a callback, of JAX's garbage collection say, it is swallowed and
    shown as a traceback.
    """
    usual = threading.current_thread() is threading.main_thread() and (
        signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )
    if not usual:
        yield
        return
    _interrupts.pressed = False
    signal.signal(signal.SIGINT, _interrupts)
    shown, sys.unraisablehook = sys.unraisablehook, _unless_keyboard
    try:
        yield
    finally:
        sys.unraisablehook = shown
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _unless_keyboard(unraisable: "sys.UnraisableHookArgs") -> None:
    if not issubclass(unraisable.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)


def _unless_interrupted(show: Callable[[str], None]) -> Callable[[str], None]:
    def one(stage: str) -> None:
        if _interrupts.pressed:
            raise KeyboardInterrupt
        show(stage)

    return one


@contextlib.contextmanager
def stages() -> Iterator[Callable[[str], None]]:
    """A callback that shows each stage that it is given, while the block runs.

    On a terminal: one bar with the share that is done, the stage, the time so far and the time left. Elsewhere one
    line for each stage, from `QUIET` seconds on.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield shared(_unless_interrupted(_Lines()))
        return
    columns = (
        SpinnerColumn(),
        BarColumn(bar_width=20),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}{task.description}"),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        bar = _Bar(progress, progress.add_task("starting", total=1.0, left=""))
        yield shared(_unless_interrupted(bar))


class _Bar:
    def __init__(self, progress: Progress, task: TaskID) -> None:
        self.progress, self.task, self.began = progress, task, time.monotonic()

    def __call__(self, stage: str) -> None:
        share = stage.share if isinstance(stage, Stage) else 0.0
        left = left_text(time.monotonic() - self.began, share)
        self.progress.update(self.task, completed=share, description=stage, left=left)


class _Lines:
    def __init__(self) -> None:
        self.began, self.printed, self.share = time.monotonic(), 0.0, -1.0
        self.held: list[str] = []

    def __call__(self, stage: str) -> None:
        now, share = time.monotonic(), stage.share if isinstance(stage, Stage) else 0.0
        new = share_of(stage) is not None and share > self.share
        if not new and now - self.printed < EVERY:
            return
        self.printed, self.share = now, share
        elapsed = now - self.began
        left = left_text(elapsed, share)
        self.held.append(f"{elapsed:6.0f} s {100 * share:3.0f} %  {left}{stage}")
        if elapsed >= QUIET:
            print("\n".join(self.held), file=sys.stderr, flush=True)
            self.held.clear()


def left_text(elapsed: float, share: float) -> str:
    """The time left, if the rest goes as fast as the share that is done; nothing while that says little."""
    if share < 0.1:
        return ""
    left = elapsed * (1.0 - share) / share
    return f"about {left:.0f} s left: " if left < 100 else f"about {left / 60:.0f} min left: "
