"""A function of small arrays as the list of scalar operations that it comes to, known numbers folded in.

For a kernel in which every thread computes one sample in its registers: there, arrays of three numbers are three
registers, moving them about costs nothing, and what is multiplied by a known zero need not be computed at all (nor is
it NaN where that is). A function is written once, for arrays, and stays the reference for what is made of it here.
"""

import contextvars
import itertools
import operator
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal


AHEAD = 300
"""Operations before it is needed at which an input is read: memory takes as long."""
one_thread = contextvars.ContextVar("one_thread", default=False)
"""Whether what is traced is for one thread: then what takes fewer operations is better, even where all wait for all."""


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



_OPERATIONS: dict[str, Callable] = {
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
    """The scalar operations of a function: `traced` makes one, `run` evaluates it."""

    outputs: list[np.ndarray] = field(default_factory=list)
    """Nodes and known numbers, in the shapes of the function's results."""
    _known: dict[tuple, Node] = field(default_factory=dict)

    def node(self, name: str, *args: Any) -> Any:
        """The node of this operation, or its result where that is known."""
        if not any(isinstance(x, Node) for x in args):
            return np.asarray(_OPERATIONS[name](*(np.asarray(x) for x in args)))[()]
        short = _shortened(name, args)
        if short is None:
            key = (name, *(id(x) if isinstance(x, Node) else x for x in args))
            short = self._known.setdefault(key, Node(name, args))
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
                value = _OPERATIONS[node.name](*args)
            values[id(node)] = value
            for k, at in wanted.get(id(node), ()):
                yield k, at, value


def traced(jaxpr: Jaxpr, args: Sequence[Any]) -> Program:
    """The program of a traced function of its constants and arguments.

    A `jax.ShapeDtypeStruct` stands for an input, a boolean being a number that is not zero; everything else is known.
    Raises NotImplementedError for a primitive that is not known here: loops, factorisations.
    """
    program = Program()
    values = []
    for k, x in enumerate(args):
        if isinstance(x, jax.ShapeDtypeStruct):
            value = np.empty(x.shape, object)
            for at in np.ndindex(x.shape):
                value[at] = Node("input", (k, at))
                if x.dtype == bool:
                    value[at] = program.node("ne", value[at], np.float32(0.0))
        else:
            value = _numbers(x)
        values.append(value)
    with jax.ensure_compile_time_eval():  # of what is known
        program.outputs = _evaluated(program, jaxpr, values)
    return program


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


def _numbers(x: Any) -> np.ndarray:
    """Known numbers as an array of objects."""
    x = np.asarray(x)
    out = np.empty(x.shape, object)
    for at in np.ndindex(x.shape):
        out[at] = x[at]
    return out


def _evaluated(program: Program, jaxpr: Jaxpr, values: list[np.ndarray]) -> list[np.ndarray]:
    """Results for constants and arguments."""
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], values, strict=True))
    for eqn in jaxpr.eqns:
        args = [_numbers(x.val) if isinstance(x, Literal) else known[x] for x in eqn.invars]
        name = eqn.primitive.name
        if name == "cond":
            out = _both(program, eqn.params["branches"], *args)
        elif name in _CALLS:
            out = _inner(program, eqn.params[_CALLS[name]], args)
        elif name in _OPERATIONS:
            out = [program.map(name, *args)]
        elif name in _RULES:
            params = eqn.params
            if name == "convert_element_type":
                params = {**params, "was": np.dtype(eqn.invars[0].aval.dtype)}
            out = _RULES[name](program, *args, **params)
            out = out if isinstance(out, list) else [out]
        else:
            raise NotImplementedError(f"no scalar form of {name}")
        known |= dict(zip(eqn.outvars, out, strict=True))
    return [_numbers(x.val) if isinstance(x, Literal) else known[x] for x in jaxpr.outvars]


def _inner(program: Program, closed: ClosedJaxpr, args: list[np.ndarray]) -> list[np.ndarray]:
    return _evaluated(program, closed.jaxpr, [*map(_numbers, closed.consts), *args])


def _both(program: Program, branches: Sequence[ClosedJaxpr], which: np.ndarray, *args: np.ndarray):
    """Of two branches: each thread may take another one, so both are computed."""
    no, yes = (_inner(program, branch, list(args)) for branch in branches)
    return [program.map("select_n", which, x, y) for x, y in zip(no, yes, strict=True)]


def _converted(program, x, *, new_dtype, was, **__):
    new = np.dtype(new_dtype)
    if was == bool and new != bool:
        return program.map("select_n", x, new.type(0), new.type(1))
    if was != bool and new == bool:
        return program.map("ne", x, was.type(0))
    out = x.copy()
    for at in np.ndindex(x.shape):
        if not isinstance(x[at], Node):
            out[at] = new.type(x[at])
    return out


def _broadcast(_, x, *, shape, broadcast_dimensions, **__):
    lengths = [1] * len(shape)
    for axis, length in zip(broadcast_dimensions, x.shape, strict=True):
        lengths[axis] = length
    return np.broadcast_to(x.reshape(lengths), shape)


def _sliced(_, x, *, start_indices, limit_indices, strides):
    steps = strides or [1] * x.ndim
    return x[tuple(map(slice, start_indices, limit_indices, steps))]


def _gathered(_, x, indices, *, dimension_numbers, slice_sizes, mode, **__):
    places = np.arange(x.size, dtype=np.int32).reshape(x.shape)
    picked = lax.gather(
        places, indices.astype(np.int32), dimension_numbers, slice_sizes, mode=mode
    )
    return x.ravel()[np.asarray(picked)]


def _power(program, x, *, y):
    if y < 0:
        return program.map("div", np.float32(1.0), _power(program, x, y=-y))
    out = x
    for _ in range(y - 1):
        out = program.map("mul", out, x)
    return out


def _reduced(name):
    def rule(program, x, *, axes, **_):
        x = np.moveaxis(x, axes, range(len(axes)))
        x = x.reshape(-1, *x.shape[len(axes) :])
        out = x[:1].reshape(x.shape[1:])
        for other in x[1:]:
            out = program.map(name, out, other)
        return out

    return rule


def _product(program, a, b, *, dimension_numbers, **_):
    (over_a, over_b), (batch_a, batch_b) = dimension_numbers

    def as_matrices(x, over, batch, last):
        free = [i for i in range(x.ndim) if i not in over and i not in batch]
        order = [*batch, *over, *free] if last else [*batch, *free, *over]
        turned = np.transpose(x, order)
        n = [int(np.prod([x.shape[i] for i in axes])) for axes in (batch, over, free)]
        shape = (n[0], n[1], n[2]) if last else (n[0], n[2], n[1])
        return turned.reshape(shape), [x.shape[i] for i in free]

    left, rows = as_matrices(a, over_a, batch_a, False)
    right, columns = as_matrices(b, over_b, batch_b, True)
    out = np.empty((*left.shape[:2], right.shape[2]), object)
    for k in range(len(out)):
        if all(not isinstance(x, Node) and x in (0, 1) for x in left[k].ravel()):
            out[k] = _sums(program, left[k] == 1, right[k])
            continue
        for i, j in np.ndindex(out.shape[1:]):
            out[k, i, j] = program.total(program.map("mul", left[k, i], right[k, :, j]))
    return out.reshape([*(a.shape[i] for i in batch_a), *rows, *columns])


def _sums(program, which: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Sums of rows of x, the smaller ones used in the larger: along a tree, one addition for each node."""
    out = np.empty((len(which), x.shape[1]), object)
    done: list[tuple[np.ndarray, int]] = []
    for i in sorted(range(len(which)), key=lambda i: which[i].sum()):
        left, parts = which[i].copy(), []
        for own, k in reversed(done):
            if own.any() and not (own & ~left).any():
                parts.append(out[k])
                left &= ~own
        parts += list(x[left])
        out[i] = [program.total([part[j] for part in parts]) for j in range(x.shape[1])]
        done.append((which[i], i))
    return out


_CALLS = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "custom_vmap_call": "call",
}
"""What calls another function, and the parameter that is its trace."""
_RULES: dict[str, Callable] = {
    "broadcast_in_dim": _broadcast,
    "concatenate": lambda _, *x, dimension, **__: np.concatenate(x, dimension),
    "convert_element_type": _converted,
    "copy": lambda _, x, **__: x,
    "dot_general": _product,
    "gather": _gathered,
    "integer_pow": _power,
    "iota": lambda _, *, dtype, shape, dimension, **__: _numbers(
        np.broadcast_to(
            np.arange(shape[dimension], dtype=dtype).reshape(
                [-1 if i == dimension else 1 for i in range(len(shape))]
            ),
            shape,
        )
    ),
    "optimization_barrier": lambda _, *x: list(x),
    "reduce_and": _reduced("and"),
    "reduce_max": _reduced("max"),
    "reduce_min": _reduced("min"),
    "reduce_or": _reduced("or"),
    "reduce_sum": _reduced("add"),
    "reshape": lambda _, x, *, new_sizes, **__: x.reshape(new_sizes),
    "rev": lambda _, x, *, dimensions: np.flip(x, dimensions),
    "slice": _sliced,
    "split": lambda _, x, *, sizes, axis: np.split(x, list(itertools.accumulate(sizes))[:-1], axis),
    "square": lambda program, x, **__: program.map("mul", x, x),
    "squeeze": lambda _, x, *, dimensions: np.squeeze(x, dimensions),
    "stack": lambda _, *x, axis=0, **__: np.stack(x, axis),
    "stop_gradient": lambda _, x: x,
    "transpose": lambda _, x, *, permutation: np.transpose(x, permutation),
}
"""What moves entries about or puts several together."""
