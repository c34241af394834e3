"""Processes that end together: none outlives the one that started it."""

import contextlib
import subprocess
import threading
from collections.abc import Iterator, Mapping, Sequence

GRACE = 5.0
"""Seconds that a process has to end by itself."""
ENDS_WITH_INPUT = "JAX_INERTIA_ENDS_WITH_INPUT"
"""Set in the environment of a command that ends when its standard input does: when who started it dies."""


class Running:
    """The processes that run now, so that all end together."""

    def __init__(self) -> None:
        self.ended = False
        self._lock = threading.Lock()
        self._processes: set[subprocess.Popen[str]] = set()

    @contextlib.contextmanager
    def one(
        self, command: Sequence[str], environment: Mapping[str, str]
    ) -> Iterator[subprocess.Popen[str]]:
        """A process that ends when this one does, however that ends: its standard input is open for as long."""
        with self._lock:
            # Of a session of its own: Ctrl-C at the terminal reaches it once, through its input.
            process = subprocess.Popen(
                command,
                env={**environment, ENDS_WITH_INPUT: "1"},
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                encoding="utf-8",
                errors="replace",
                start_new_session=True,
            )
            self._processes.add(process)
            if self.ended:
                process.kill()
        try:
            with process:
                yield process
        finally:
            with self._lock:
                self._processes.discard(process)

    def end(self) -> None:
        """End every process, and those that begin from now on."""
        with self._lock:
            self.ended = True
            for process in self._processes:
                if process.stdin is not None:
                    process.stdin.close()
        for process in list(self._processes):
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(GRACE)
            process.kill()
