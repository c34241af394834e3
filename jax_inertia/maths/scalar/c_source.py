"""A function as a file of C: its scalar operations one after the other, without a loop, a branch or an allocation.

For a control loop that has no Python: it takes the same time at every call, and needs nothing but C's mathematics.
What a function is made of comes from `trace`; arguments and results are structures of numbers, one field for
each array.
"""

import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jax_inertia.maths.scalar.program import Node, Program
from jax_inertia.maths.scalar.trace import one_thread, traced

_OPERATORS = {"add": "+", "sub": "-", "mul": "*", "div": "/", "and": "&&", "or": "||"}
_OPERATORS |= {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
_FUNCTIONS = {name: name for name in ("exp", "log", "sin", "cos", "tanh", "sqrt")}
_FUNCTIONS |= {"abs": "fabs", "is_finite": "isfinite"}
_LOGICAL = {"eq", "ne", "lt", "le", "gt", "ge", "and", "or", "not", "is_finite"}


class Structure(NamedTuple):
    """A tree of arrays, which is one structure of C."""

    name: str
    tree: Any

    def fields(self) -> list[tuple[str, Any]]:
        """Each array with its name: the last word of its path in the tree, or all words where two end alike."""
        leaves = jax.tree.leaves_with_path(self.tree)
        words = [
            re.findall(r"\w+", jax.tree_util.keystr(path)) or [self.name] for path, _ in leaves
        ]
        last = [path[-1] for path in words]
        names = [
            x if last.count(x) == 1 and x.isidentifier() else "_".join(path)
            for x, path in zip(last, words, strict=True)
        ]
        return [(name, leaf) for name, (_, leaf) in zip(names, leaves, strict=True)]

    def declared(self, prefix: str) -> str:
        """Its type, `PREFIX_NAME`."""
        arrays = (f"  double {name}{_index(np.shape(x))};\n" for name, x in self.fields())
        return f"typedef struct {{\n{''.join(arrays)}}} {prefix}_{self.name};\n"

    def initialised(self) -> str:
        """Its numbers as an initialiser."""
        return "{" + ", ".join(_braced(np.asarray(x)) for _, x in self.fields()) + "}"


class Source(NamedTuple):
    """The texts of NAME.h and NAME.c."""

    header: str
    code: str


def c_source(
    name: str,
    function: Callable[..., tuple],
    arguments: Sequence[Structure],
    results: Sequence[str],
    *,
    start: str = "",
) -> Source:
    """C of `function(*arguments) -> results`: void NAME(const NAME_ARGUMENT *, ..., NAME_RESULT *, ...).

    Everything is double; truth values are 0 and 1. A result that is called as an argument replaces it. `start` names an
    argument whose numbers are written out as the constant NAME_start. Raises NotImplementedError for a function with an
    operation that has no scalar form (`trace.traced`).

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.scalar.c_source import Structure, c_source
    >>> made = c_source("twice", lambda x: (2.0 * x,), [Structure("given", jnp.ones(2))], ["found"])
    >>> made.header.splitlines()[-5]
    'void twice(const twice_given *given, twice_found *found);'
    """
    program, shapes = _program(function, [x.tree for x in arguments])
    made = [Structure(x, tree) for x, tree in zip(results, shapes, strict=True)]
    types = {x.name: x for x in [*made, *arguments]}
    const = {x.name: "" if x.name in results else "const " for x in types.values()}
    order = [*(x.name for x in arguments), *(x for x in results if x not in _names(arguments))]
    call = ", ".join(f"{const[x]}{name}_{x} *{x}" for x in order)
    first = f"const {name}_{start} {name}_start"
    header = [f"#ifndef {name.upper()}_H", f"#define {name.upper()}_H"]
    header += ["#ifdef __cplusplus", 'extern "C" {', "#endif"]
    header += [types[x].declared(name) for x in order]
    header += [f"extern {first};"] if start else []
    header += [f"void {name}({call});", "#ifdef __cplusplus", "}", "#endif", "#endif"]
    code = ["#include <math.h>", f'#include "{name}.h"', ""]
    code += [f"{first} = {types[start].initialised()};"] if start else []
    code += [
        f"void {name}({call}) {{",
        *_statements(program, _places(arguments), _places(made)),
        "}",
    ]
    return Source("\n".join(header) + "\n", "\n".join(code) + "\n")


def _names(structures: Sequence[Structure]) -> list[str]:
    return [x.name for x in structures]


def _places(structures: Sequence[Structure]) -> list[str]:
    """Where each array of some structures is."""
    return [f"{x.name}->{field}" for x in structures for field, _ in x.fields()]


def _program(function: Callable[..., tuple], trees: Sequence[Any]) -> tuple[Program, tuple]:
    """The scalar operations of a function of trees, and the shapes of its results."""
    shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(np.shape(x), np.asarray(x).dtype), trees)
    before = one_thread.set(True)
    closed, out = jax.make_jaxpr(function, return_shape=True)(*shapes)
    one_thread.reset(before)
    jaxpr = closed.jaxpr
    flat = jaxpr.replace(constvars=[], invars=[*jaxpr.invars, *jaxpr.constvars])
    return traced(flat, [*jax.tree.leaves(shapes), *closed.consts]), out


def _statements(program: Program, given: list[str], found: list[str]) -> list[str]:
    """One for each operation, then what the results are."""
    names: dict[int, str] = {}
    lines = []
    for number, node in enumerate(program.ordered()):
        kind = "int" if node.name in _LOGICAL else "double"
        lines.append(f"  const {kind} v{number} = {_expression(node, names, given)};")
        names[id(node)] = f"v{number}"
    for place, output in zip(found, program.outputs, strict=True):
        for at in np.ndindex(output.shape):
            lines.append(f"  {place}{_index(at)} = {_text(output[at], names)};")
    return lines


def _expression(node: Node, names: dict[int, str], given: list[str]) -> str:
    if node.name == "input":
        array, at = node.args
        return f"{given[array]}{_index(at)}"
    args = [_text(x, names) for x in node.args]
    if node.name in _OPERATORS:
        return f"{args[0]} {_OPERATORS[node.name]} {args[1]}"
    if node.name in _FUNCTIONS:
        return f"{_FUNCTIONS[node.name]}({args[0]})"
    match node.name:
        case "select_n":
            return f"{args[0]} ? {args[2]} : {args[1]}"
        case "neg":
            return f"-{args[0]}"
        case "not":
            return f"!{args[0]}"
        case "rsqrt":
            return f"1.0 / sqrt({args[0]})"
        case "max" | "min":  # as jax: what is not a number stays so
            less = "<" if node.name == "max" else ">"
            return f"{args[0]} {less} {args[1]} || {args[1]} != {args[1]} ? {args[1]} : {args[0]}"
    raise NotImplementedError(f"no C of {node.name}")


def _text(x: Any, names: dict[int, str]) -> str:
    """A value: of an operation by its name, and a number in as many digits as it takes."""
    if isinstance(x, Node):
        return names[id(x)]
    number = float(x)
    if np.isfinite(number):
        return f"({number!r})" if number < 0 else repr(number)
    return "NAN" if np.isnan(number) else "INFINITY" if number > 0 else "(-INFINITY)"


def _index(at: Sequence[int]) -> str:
    return "".join(f"[{k}]" for k in at)


def _braced(x: Any) -> str:
    """Numbers of an array of any shape, or of one entry."""
    if np.ndim(x) == 0:
        return _text(x, {})
    return "{" + ", ".join(_braced(part) for part in x) + "}"
