"""Annotations of the package checked at run time, on the first calls of a function in every test.

A check costs some twenty microseconds, which loops over samples and effects pay a hundred thousand times for the same
shapes: a third of what a diagnosis takes.
"""

import collections
import functools
import types

import jaxtyping

OFTEN = 20
"""Calls of a function that are checked in one test."""

calls: collections.Counter[int] = collections.Counter()


def install() -> None:
    """Before anything imports the package, so that every annotation in it is checked."""
    # The import hook decorates with whatever stands at this name.
    jaxtyping.jaxtyped = functools.partial(_jaxtyped, jaxtyping.jaxtyped)
    jaxtyping.install_import_hook("jax_inertia", "beartype.beartype")


def _jaxtyped(decorator, fn=None, *, typechecker):
    if fn is None:
        return functools.partial(_jaxtyped, decorator, typechecker=typechecker)
    checked = decorator(fn, typechecker=typechecker)
    if not isinstance(fn, types.FunctionType):  # a class, whose __init__ is checked, or a property
        return checked
    key = id(checked)

    @functools.wraps(fn)
    def at_first(*args, **kwargs):
        __tracebackhide__ = True
        calls[key] += 1
        return (checked if calls[key] <= OFTEN else fn)(*args, **kwargs)

    return at_first
