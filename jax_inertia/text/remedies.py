"""Options that messages name: whoever reads one on a command that lacks the option learns which command has it."""

import argparse
import contextlib
import re
from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar

_NAMED = re.compile(
    r"jax-inertia (?P<command>[a-z]+(?:-[a-z]+)*)|(?P<option>(?<![\w-])--[a-z][a-z-]*)|(?P<end>[;.])(?=\s)"
)

_USUAL: ContextVar[Callable[[str], str] | None] = ContextVar("messages", default=None)


def with_commands(message: str, command: str, options: Mapping[str, frozenset[str]]) -> str:
    """The message, with the commands of each option that it names and `command` lacks.

    `options` of every command by its name. After "jax-inertia CMD" options are of that command, to the end of the
    sentence or clause.

    >>> from jax_inertia.text.remedies import with_commands
    >>> known = {"watch": frozenset(), "estimate": frozenset({"--gains"})}
    >>> with_commands("give --gains 2", "watch", known)
    'give --gains 2 (--gains is an option of jax-inertia estimate)'
    """
    of, lacking = command, {}
    for found in _NAMED.finditer(message):
        if found["command"]:
            of = found["command"]
        elif found["end"]:
            of = command
        elif found["option"] not in options.get(of, ()):
            having = [name for name, own in options.items() if found["option"] in own]
            lacking |= {found["option"]: having} if having else {}
    text = "; ".join(
        f"{option} is an option of jax-inertia {', '.join(having)}"
        for option, having in lacking.items()
    )
    return f"{message} ({text})" if text else message


@contextlib.contextmanager
def of_command(command: str, parsers: Mapping[str, argparse.ArgumentParser]) -> Iterator[None]:
    """Messages of one command (`usable`), while it runs."""
    options = {name: frozenset(one._option_string_actions) for name, one in parsers.items()}
    before = _USUAL.set(lambda message: with_commands(message, command, options))
    try:
        yield
    finally:
        _USUAL.reset(before)


def usable(message: str) -> str:
    """A message as who runs the current command can use it."""
    change = _USUAL.get()
    return message if change is None else change(message)
