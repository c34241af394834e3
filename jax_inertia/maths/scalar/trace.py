"""From a traced function to its scalar program: the rules of JAX's primitives, known numbers folded in."""

import contextvars
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from jax_inertia.maths.scalar.program import OPERATIONS, Node, Program, numbers

one_thread = contextvars.ContextVar("one_thread", default=False)
"""Whether what is traced is for one thread: then what takes fewer operations is better, even where all wait for all."""


def traced(jaxpr: Jaxpr, args: Sequence[Any]) -> Program:
    """The program of a traced function of its constants and arguments.

    A `jax.ShapeDtypeStruct` stands for an input, a boolean being a number that is not zero; everything else is known.
    Loops of a known length are unrolled. Raises NotImplementedError for a primitive that is not known here: loops until
    a condition holds, QR factorisations, sorting.
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
            value = numbers(x)
        values.append(value)
    with jax.ensure_compile_time_eval():  # of what is known
        program.outputs = _evaluated(program, jaxpr, values)
    return program


def _evaluated(program: Program, jaxpr: Jaxpr, values: list[np.ndarray]) -> list[np.ndarray]:
    """Results for constants and arguments."""
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], values, strict=True))
    for eqn in jaxpr.eqns:
        args = [numbers(x.val) if isinstance(x, Literal) else known[x] for x in eqn.invars]
        name = eqn.primitive.name
        if name == "cond":
            out = _both(program, eqn.params["branches"], *args)
        elif name in _CALLS:
            out = _inner(program, eqn.params[_CALLS[name]], args)
        elif name in OPERATIONS:
            out = [program.map(name, *args)]
        elif name in _RULES:
            params = eqn.params
            if name == "convert_element_type":
                before: Any = eqn.invars[0].aval
                params = {**params, "was": np.dtype(before.dtype)}
            out = _RULES[name](program, *args, **params)
            out = out if isinstance(out, list) else [out]
        else:
            raise NotImplementedError(f"no scalar form of {name}")
        known |= dict(zip(eqn.outvars, out, strict=True))
    return [numbers(x.val) if isinstance(x, Literal) else known[x] for x in jaxpr.outvars]


def _inner(program: Program, closed: ClosedJaxpr, args: list[np.ndarray]) -> list[np.ndarray]:
    return _evaluated(program, closed.jaxpr, [*map(numbers, closed.consts), *args])


def _both(program: Program, branches: Sequence[ClosedJaxpr], which: np.ndarray, *args: np.ndarray):
    """Of two branches, where it is not known which: each thread may take another one, so both are computed."""
    if not isinstance(which[()], Node):
        return _inner(program, branches[int(which[()])], list(args))
    no, yes = (_inner(program, branch, list(args)) for branch in branches)
    return [program.map("select_n", which, x, y) for x, y in zip(no, yes, strict=True)]


def _converted(program, x, *, new_dtype, was, **__):
    new = np.dtype(new_dtype)
    if was.kind == "b" != new.kind:
        return program.map("select_n", x, new.type(0), new.type(1))
    if new.kind == "b" != was.kind:
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
    picked = lax.gather(places, indices.astype(np.int32), dimension_numbers, slice_sizes, mode=mode)
    return x.ravel()[np.asarray(picked)]


def _power(program, x, *, y):
    if y < 0:
        return program.map("div", np.float32(1.0), _power(program, x, y=-y))
    out = x
    for _ in range(y - 1):
        out = program.map("mul", out, x)
    return out


def _reduced(name, empty):
    def rule(program, x, *, axes, **_):
        x = np.moveaxis(x, axes, range(len(axes)))
        x = x.reshape(-1, *x.shape[len(axes) :])
        if not len(x):
            return np.full(x.shape[1:], empty, object)
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


def _unrolled(program, *args, jaxpr, length, reverse, num_consts, num_carry, **_):
    """A loop of a known length (`lax.scan`, and `fori_loop` between known bounds), one step after the other."""
    constants, carry = args[:num_consts], list(args[num_consts : num_consts + num_carry])
    steps: list[list[np.ndarray]] = []
    for k in reversed(range(length)) if reverse else range(length):
        sliced = [x[k] for x in args[num_consts + num_carry :]]
        out = _inner(program, jaxpr, [*constants, *carry, *sliced])
        carry = out[:num_carry]
        steps.append(out[num_carry:])
    if reverse:
        steps.reverse()
    return [*carry, *(np.stack(each) for each in zip(*steps, strict=True))]


def _cholesky(program, a, **_):
    """L of A = L Lᵀ from the lower triangle of A, column by column; NaN where A is not positive."""
    out = np.full(a.shape, np.float32(0.0), object)
    for at in np.ndindex(a.shape[:-2]):
        own, given = out[at], a[at]
        for j in range(len(own)):
            for i in range(j, len(own)):
                products = program.map("mul", own[i, :j], own[j, :j]) if j else ()
                left = program.node("sub", given[i, j], program.total(products))
                own[i, j] = (
                    program.node("sqrt", left) if i == j else program.node("div", left, own[j, j])
                )
    return out


def _triangular_solve(program, a, b, *, left_side, lower, transpose_a, unit_diagonal, **_):
    """X of A X = B (or X A = B) by substitution."""
    if transpose_a:
        a, lower = np.swapaxes(a, -1, -2), not lower
    if not left_side:  # X A = B is Aᵀ Xᵀ = Bᵀ
        turned = np.swapaxes(a, -1, -2), np.swapaxes(b, -1, -2)
        way = {"left_side": True, "lower": not lower, "transpose_a": False}
        return np.swapaxes(
            _triangular_solve(program, *turned, **way, unit_diagonal=unit_diagonal), -1, -2
        )
    out = b.copy()
    n = a.shape[-1]
    for at in np.ndindex(b.shape[:-2]):
        own, given = out[at], a[at]
        for i in range(n) if lower else reversed(range(n)):
            before = slice(0, i) if lower else slice(i + 1, n)
            for k in range(own.shape[1]):
                left = own[i, k]
                if before.stop > before.start:
                    products = program.map("mul", given[i, before], own[before, k])
                    left = program.node("sub", left, program.total(products))
                own[i, k] = left if unit_diagonal else program.node("div", left, given[i, i])
    return out


def _dynamic_slice(program, x, *starts, slice_sizes):
    """Where a start is not known, of all that it may be the one that it is."""
    for axis, (start, size) in enumerate(zip(starts, slice_sizes, strict=True)):
        at, last = start[()], x.shape[axis] - size
        parts = [np.take(x, range(k, k + size), axis) for k in range(last + 1)]
        if not isinstance(at, Node):
            x = parts[int(np.clip(at, 0, last))]
            continue
        x = parts[-1]
        for k in reversed(range(last)):
            x = program.map("select_n", np.asarray(program.node("le", at, k)), x, parts[k])
    return x


def _platform(_, *, platforms, **__):
    """The branch of a CPU, and where none is for it, of every platform."""
    fits = [k for k, names in enumerate(platforms) if names is None or "cpu" in names]
    return numbers(fits[0])


def _padded(_, x, value, *, padding_config):
    if any(inner or low < 0 or high < 0 for low, high, inner in padding_config):
        raise NotImplementedError("no scalar form of padding between entries, or of less than none")
    widths = [(low, high) for low, high, _ in padding_config]
    return np.pad(x, widths, constant_values=value[()])


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
    "cholesky": _cholesky,
    "concatenate": lambda _, *x, dimension, **__: np.concatenate(x, dimension),
    "convert_element_type": _converted,
    "copy": lambda _, x, **__: x,
    "dot_general": _product,
    "dynamic_slice": _dynamic_slice,
    "gather": _gathered,
    "integer_pow": _power,
    "iota": lambda _, *, dtype, shape, dimension, **__: numbers(
        np.broadcast_to(
            np.arange(shape[dimension], dtype=dtype).reshape(
                [-1 if i == dimension else 1 for i in range(len(shape))]
            ),
            shape,
        )
    ),
    "pad": _padded,
    "platform_index": _platform,
    "optimization_barrier": lambda _, *x: list(x),
    "reduce_and": _reduced("and", np.True_),
    "reduce_max": _reduced("max", np.float32(-np.inf)),
    "reduce_min": _reduced("min", np.float32(np.inf)),
    "reduce_or": _reduced("or", np.False_),
    "reduce_sum": _reduced("add", np.float32(0.0)),
    "reshape": lambda _, x, *, new_sizes, **__: x.reshape(new_sizes),
    "rev": lambda _, x, *, dimensions: np.flip(x, dimensions),
    "scan": _unrolled,
    "slice": _sliced,
    "split": lambda _, x, *, sizes, axis: np.split(x, list(itertools.accumulate(sizes))[:-1], axis),
    "square": lambda program, x, **__: program.map("mul", x, x),
    "squeeze": lambda _, x, *, dimensions: np.squeeze(x, dimensions),
    "stack": lambda _, *x, axis=0, **__: np.stack(x, axis),
    "stop_gradient": lambda _, x: x,
    "triangular_solve": _triangular_solve,
    "transpose": lambda _, x, *, permutation: np.transpose(x, permutation),
}
"""What moves entries about or puts several together."""
