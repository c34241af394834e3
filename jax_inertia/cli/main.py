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
    convert,
    diagnose,
    estimate,
    fleet,
    replay,
    suggest_motion,
    watch,
)
from jax_inertia.cli.demo import command as demo_command

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

exit status: 0 where the work was done, whatever it found; 2 for a log, model or option that cannot be used (one line
on stderr); 130 after Ctrl-C. Where it is not 0, nothing is left half written. With --json stdout holds JSON and nothing
else; warnings and progress go to stderr.
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
            parser.error(f"{option_string} needs shtab: pip install 'jax-inertia[completion]'")
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
        description="Masses, centres of mass and inertias of a robot's bodies from its logs, never unphysical.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {version('jax-inertia')}")
    completion_help = "print a completion script for bash, zsh or tcsh, and end"
    shells = ("bash", "zsh", "tcsh")
    parser.add_argument(
        "--print-completion", action=_PrintCompletion, choices=shells, help=completion_help
    )
    subparsers = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for command in _COMMANDS:
        command.add_parser(subparsers)
    args = parser.parse_args(arguments)
    from jax_inertia.cli.console import one_line, warnings_as_lines

    try:
        import jax

        # Logs last minutes and covariances span twelve decades: single precision is for the library's users to choose.
        jax.config.update("jax_enable_x64", True)
        with warnings_as_lines():
            return args.run(args)
    except BrokenPipeError:
        raise
    except KeyboardInterrupt:
        print("jax-inertia: interrupted; nothing was written", file=sys.stderr)
        return 130
    except (ValueError, OSError) as error:
        print(f"jax-inertia: error: {one_line(error)}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
