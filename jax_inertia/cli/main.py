"""The command `jax-inertia`: parse, call, print.

A command is a module with `add_parser(subparsers)`, which sets `run` (namespace → exit status) as a default of its
parser. Modules that do the work are imported by `run` alone, so that `--help` is quick.
"""

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import NoReturn

from jax_inertia.cli import (
    compare,
    diagnose,
    estimate,
    fleet,
    replay,
    suggest_motion,
    watch,
)
from jax_inertia.cli.conversion import command as convert
from jax_inertia.cli.demo import command as demo_command
from jax_inertia.text.remedies import of_command, usable

_COMMANDS = (
    convert,
    diagnose,
    replay,
    estimate,
    suggest_motion,
    fleet,
    watch,
    compare,
    demo_command,
)


_EPILOG = """
start with:
  jax-inertia demo

exit status: 0 if the command did its work, whatever it found; 2 for a log, model or option that it cannot use (one
line on stderr); 130 after Ctrl-C. If it is not 0, no file is half written. With --json, stdout holds JSON and nothing
else; warnings and progress go to stderr (a bar on a terminal, else a line for each stage).
"""


class _Parser(argparse.ArgumentParser):
    """An `ArgumentParser` whose errors are one line, which points to the help of the command that they are about."""

    def parse_known_args(self, args=None, namespace=None):  # pyright: ignore[reportIncompatibleMethodOverride]
        # What a command's parser does not know it would hand to the main parser, whose help does not have it either.
        known, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return known, unknown

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"jax-inertia: error: {message} (see {self.prog} --help)\n")


class _PrintCompletion(argparse.Action):
    """Print the completion script for a shell, by shtab, and end."""

    def __call__(self, parser, namespace, values, option_string=None) -> None:
        try:
            import shtab
        except ImportError:
            parser.error(f"{option_string} needs shtab: pip install shtab")
        for action in _actions(parser):
            if action.type is Path:
                folder = action.metavar == "DIR"
                action.complete = shtab.DIRECTORY if folder else shtab.FILE  # pyright: ignore
        print(shtab.complete(parser, shell=str(values)))
        parser.exit()


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Every argument, those of the commands included."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from _actions(command)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status: 0, 2 for bad input (one line on stderr), 130 for Ctrl-C."""
    try:
        try:
            return _run(arguments)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        # Who read our output (head, less) has gone; files were written before. Python flushes once more at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _run(arguments: Sequence[str] | None) -> int:
    parser = _Parser(
        prog="jax-inertia",
        description="What a robot's model lacks, and what its bodies weigh, from logs of its motion.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {version('jax-inertia')}")
    completion_help = "print a completion script for bash, zsh or tcsh, and end"
    shells = ("bash", "zsh", "tcsh")
    parser.add_argument(
        "--print-completion", action=_PrintCompletion, choices=shells, help=completion_help
    )
    cache_help = (
        "compile everything anew: neither read nor write compiled programs in the user's cache folder (at most 512 MB; "
        "JAX_INERTIA_CACHE=off does the same for every command, JAX_INERTIA_CACHE=DIR uses another folder)"
    )
    parser.add_argument("--no-cache", action="store_true", help=cache_help)
    subparsers = parser.add_subparsers(
        title="commands", required=True, metavar="COMMAND", dest="command"
    )
    for command in _COMMANDS:
        command.add_parser(subparsers)
    args = parser.parse_args(arguments)
    with of_command(args.command, subparsers.choices):
        return _done(args)


def _done(args: argparse.Namespace) -> int:
    """The command's exit status, once it has run."""
    from jax_inertia.cli.console import end_with_input, in_utf_8, one_line, warnings_as_lines
    from jax_inertia.cli.running.compiled import keep_compiled
    from jax_inertia.cli.running.stages import interruptible
    from jax_inertia.model.file_safety import includes_below

    in_utf_8()
    end_with_input()

    # XLA complains of its own compilation cache in hundreds of lines that no user can act on; read once, at its import.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    try:
        with interruptible():
            import jax

            # Logs last minutes and covariances span twelve decades: single precision is for the library's users to
            # choose.
            jax.config.update("jax_enable_x64", True)
            if not args.no_cache:
                keep_compiled()
            with warnings_as_lines(), includes_below(getattr(args, "include_root", None)):
                return args.run(args)
    except BrokenPipeError:
        raise
    except KeyboardInterrupt as stopped:
        print(f"jax-inertia: interrupted; {str(stopped) or 'nothing was written'}", file=sys.stderr)
        return 130
    except (ValueError, OSError) as error:
        print(f"jax-inertia: error: {usable(one_line(error))}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
