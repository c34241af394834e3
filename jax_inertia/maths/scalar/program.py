"""A function of small arrays as the list of scalar operations that it comes to, known numbers folded in.

For a kernel in which every thread computes one sample in its registers: there, arrays of three numbers are three
registers, moving them about costs nothing, and what is multiplied by a known zero need not be computed at all (nor is
it NaN where that is). A function is written once, for arrays, and stays the reference for what is made of it here.
"""

import operator
from collections.abc import Callable, Container, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

AHEAD = 1000
"""Operations before it is needed at which an input is read: memory takes as long."""


@dataclass(frozen=True, eq=False, slots=True)
class Node:
    """One operation; `Program` makes no two that are the same."""

    name: str
    """Of the primitive; `input` for a number that comes from outside."""
    args: tuple
    """Nodes and known numbers; of an input: which array, and where in it."""

    @property
    def needs(self) -> list["Node"]:
        return [] if self.name == "input" else [x for x in self.args if isinstance(x, Node)]


OPERATIONS: dict[str, Callable] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "neg": operator.neg,
    "max": jnp.maximum,
    "min": jnp.minimum,
    "abs": lax.abs,
    "exp": lax.exp,
    "log": lax.log,
    "sin": lax.sin,
    "cos": lax.cos,
    "tanh": lax.tanh,
    "sqrt": lambda x: 1.0 / lax.rsqrt(x),  # a kernel has had no other before jax 0.11
    "rsqrt": lax.rsqrt,
    "eq": operator.eq,
    "ne": operator.ne,
    "lt": operator.lt,
    "le": operator.le,
    "gt": operator.gt,
    "ge": operator.ge,
    "and": operator.and_,
    "or": operator.or_,
    "not": operator.invert,
    "is_finite": lambda x: abs(x) < np.inf,
    "select_n": lambda which, *cases: jnp.where(which, cases[1], cases[0]),
}
"""What is done with arrays of the same shape, entry by entry."""


@dataclass
class Program:
    """The scalar operations of a function: `trace.traced` makes one, `run` evaluates it."""

    outputs: list[np.ndarray] = field(default_factory=list)
    """Nodes and known numbers, in the shapes of the function's results."""
    known: dict[tuple, Node] = field(default_factory=dict)
    """The node of each operation."""

    def node(self, name: str, *args: Any) -> Any:
        """The node of this operation, or its result where that is known."""
        if not any(isinstance(x, Node) for x in args):
            return np.asarray(OPERATIONS[name](*(np.asarray(x) for x in args)))[()]
        short = _shortened(name, args)
        if short is None:
            key = (name, *(id(x) if isinstance(x, Node) else x for x in args))
            short = self.known.setdefault(key, Node(name, args))
        return self.node(*short) if isinstance(short, tuple) else short

    def map(self, name: str, *arrays: Any) -> np.ndarray:
        """An operation on every entry."""
        arrays = tuple(np.broadcast_arrays(*arrays))
        out = np.empty(arrays[0].shape, object)
        for at in np.ndindex(out.shape):
            out[at] = self.node(name, *(x[at] for x in arrays))
        return out

    def total(self, terms: Iterable[Any]) -> Any:
        """The sum, from the first term on."""
        out = np.float32(0.0)
        for term in terms:
            out = self.node("add", out, term)
        return out

    def ordered(self) -> list[Node]:
        """All that the outputs need, each after what it needs itself.

        What is computed early, waits in a register: so everything is computed late. The last output sets the order,
        backwards, since joints come in the order of the tree: the tips' rows are done before those that carry them.
        Entries of other outputs follow where what they share with it has been computed. Inputs are read `AHEAD`.
        """
        ready: dict[int, int] = {}
        for k, output in enumerate(reversed(self.outputs)):
            for node in _in_order(output.ravel()[::-1], ready):
                own = len(ready) if k == 0 else -1
                ready[id(node)] = max([own, *(ready[id(x)] for x in node.needs)])
        roots = [x for output in reversed(self.outputs) for x in output.ravel()[::-1]]
        roots = [x for x in roots if isinstance(x, Node)]
        late = _in_order(sorted(roots, key=lambda x: ready[id(x)]), ())
        when = {id(x): i - AHEAD * (x.name == "input") for i, x in enumerate(late)}
        return sorted(late, key=lambda x: when[id(x)])

    def used(self) -> list[int]:
        """Which arguments the outputs need."""
        return sorted({node.args[0] for node in self.ordered() if node.name == "input"})

    def run(self, load: Callable[[int, tuple[int, ...]], Any]) -> Iterator[tuple[int, tuple, Any]]:
        """Every entry of the outputs, (output, index, value), each as soon as it is there.

        `load(k, index)` gives an entry of the k-th argument. Numbers are of whatever shape it returns.
        """
        wanted: dict[int, list] = {}
        for k, output in enumerate(self.outputs):
            for at in np.ndindex(output.shape):
                if isinstance(output[at], Node):
                    wanted.setdefault(id(output[at]), []).append((k, at))
                else:
                    yield k, at, output[at]
        values: dict[int, Any] = {}
        for node in self.ordered():
            if node.name == "input":
                value = load(*node.args)
            else:
                args = (values[id(x)] if isinstance(x, Node) else x for x in node.args)
                value = OPERATIONS[node.name](*args)
            values[id(node)] = value
            for k, at in wanted.get(id(node), ()):
                yield k, at, value


def _in_order(roots: Iterable[Any], done: Container[int]) -> list[Node]:
    """Nodes among the roots and all that they need, but for what is done, each after what it needs."""
    out: dict[int, Node] = {}
    for root in roots:
        stack = [root] if isinstance(root, Node) and id(root) not in done else []
        while stack:
            left = [x for x in stack[-1].needs if id(x) not in out and id(x) not in done]
            if left:
                stack.append(left[0])
            else:
                top = stack.pop()
                out[id(top)] = top
    return list(out.values())


def _shortened(name: str, args: tuple) -> Any:
    """A node, a number or another operation (a tuple) that comes to the same; None: there is none."""
    first = args[0]
    if name == "select_n":
        if not isinstance(first, Node):
            return args[1 + int(first)]
        return args[1] if args[1] is args[2] else None
    if name == "neg":
        return first.args[0] if first.name == "neg" else None
    if name not in ("add", "sub", "mul", "div"):
        return None
    second = args[1]
    zero, one = ([not isinstance(x, Node) and x == y for x in args] for y in (0, 1))
    if name == "add":
        return second if zero[0] else first if zero[1] else None
    if name == "sub":
        if first is second:
            return np.float32(0.0)
        return ("neg", second) if zero[0] else first if zero[1] else None
    if zero[0] or (name == "mul" and zero[1]):
        return np.float32(0.0)
    if one[1] or (name == "mul" and one[0]):
        return first if one[1] else second
    if name == "mul":
        minus = [not isinstance(x, Node) and x == -1 for x in args]
        return ("neg", second) if minus[0] else ("neg", first) if minus[1] else None
    return None


def numbers(x: Any) -> np.ndarray:
    """Known numbers as an array of objects."""
    x = np.asarray(x)
    out = np.empty(x.shape, object)
    for at in np.ndindex(x.shape):
        out[at] = x[at]
    return out
