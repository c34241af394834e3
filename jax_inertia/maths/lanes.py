"""Functions of one sample that a GPU computes one sample a thread, everything in between in its registers.

XLA makes many kernels of a filter's dynamics and sends some hundred times the bytes through memory that go in and come
out. Here all is one kernel (Pallas, Mosaic GPU: Hopper and later): arrays have the samples last, contiguous, and each
of a block's 128 threads has one of them.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer, eval_jaxpr
from jax.custom_batching import custom_vmap
from jax.experimental import pallas as pl
from jax.experimental.pallas import mosaic_gpu as gpu
from jax.extend.core import ClosedJaxpr, Jaxpr
from jaxtyping import Array, Float

from jax_inertia.maths.scalar.trace import one_thread, traced

LANES = 128
"""Samples to a block: Mosaic's threads are groups of so many."""
CAPABILITY = 9.0
"""Of the first GPUs that Mosaic compiles for."""


def available() -> bool:
    """Whether every GPU here can run such kernels; true where there is none, for programs that are exported."""
    if jax.default_backend() != "gpu":
        return True
    return all(float(d.compute_capability) >= CAPABILITY for d in jax.devices("gpu"))


def lane_kernel(
    name: str,
    body: Callable[..., None],
    shapes: Sequence[tuple[int, ...]],
    arrays: Sequence[Float[Array, "... n"]],
    shared: Sequence[Float[Array, "..."]] = (),
) -> list[Float[Array, "... n"]]:
    """`body(*arrays, *shared, *results)` for n ≥ 128 samples; `shapes` are the results', without their last axis.

    Each of its arguments is a function of an index: an array's gives the entry for 128 samples, one's that all share a
    number, and a result's takes the entry before the index. The last block repeats samples of the one before it.
    """
    count = arrays[0].shape[-1]
    out = [jax.ShapeDtypeStruct((*shape, count), jnp.float32) for shape in shapes]
    wide = len(arrays)

    def program(*refs: Any) -> None:
        first = jnp.minimum(jax.lax.axis_index("block") * LANES, count - LANES)
        at = pl.ds(first, LANES)

        def of_samples(ref: Any) -> Callable:
            return lambda *index: ref[(*index, at)]

        def of_all(ref: Any) -> Callable:
            return lambda *index: ref[index or (0,)]

        def result(ref: Any) -> Callable:
            def store(value: Any, *index: Any) -> None:
                ref[(*index, at)] = jnp.broadcast_to(value, (LANES,))

            return store

        last = wide + len(shared)
        body(
            *map(of_samples, refs[:wide]),
            *map(of_all, refs[wide:last]),
            *map(result, refs[last:]),
        )

    program.__name__ = name  # what a profiler shows
    results: dict[str, Any] = {"out_shape" if jax.__version_info__ < (0, 11) else "out_type": out}
    run = gpu.kernel(
        program,
        grid=(-(-count // LANES),),
        grid_names=("block",),
        compiler_params=gpu.CompilerParams(
            lowering_semantics=gpu.LoweringSemantics.Lane,
            unsafe_no_auto_barriers=True,  # no thread reads what another one writes
        ),
        **results,
    )
    return list(run(*arrays, *(jnp.atleast_1d(x) for x in shared)))


def in_lanes(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, which a `vmap` of at least 128 samples on a GPU hands to one kernel.

    It maps trees of arrays to such, all float32 (booleans may be among them) for the kernel, without loops or
    factorisations; of a `cond` both branches are computed. Numbers known where it is traced, closed over or not, are
    folded in, and all that they make needless falls away. Elsewhere it is what it was. A batch over several devices
    has to be split by `jax.shard_map` with `check_vma=False`: XLA does not split a kernel. Not differentiable.
    """

    def wrapped(*args: Any) -> Any:
        usual, shapes = jax.make_jaxpr(function, return_shape=True)(*args)
        before = one_thread.set(True)
        straight = jax.make_jaxpr(function)(*args)
        one_thread.reset(before)
        name = getattr(function, "__name__", "function")
        out = _called(name, usual, straight, jax.tree.leaves(args))
        return jax.tree.unflatten(jax.tree.structure(shapes), out)

    return wrapped


def _called(
    name: str, usual: ClosedJaxpr, straight: ClosedJaxpr, args: Sequence[Any]
) -> list[Array]:
    """A function of these arguments, traced as it is and for one thread."""
    leaves = [*usual.consts, *straight.consts, *args]
    first, second = len(usual.consts), len(usual.consts) + len(straight.consts)
    moving = [k for k, x in enumerate(leaves) if isinstance(x, Tracer)]

    def plain(*values: Array) -> list[Array]:
        given = dict(enumerate(leaves)) | dict(zip(moving, values, strict=True))
        every = list(given.values())
        return eval_jaxpr(usual.jaxpr, every[:first], *every[second:])

    call = custom_vmap(plain)

    @call.def_vmap
    def rule(size: int, batched: list[bool], *values: Array) -> tuple[list[Array], list[bool]]:
        many = jax.vmap(plain, [0 if on else None for on in batched], axis_size=size)
        dtypes = [jnp.dtype(x.aval.dtype) for x in usual.jaxpr.outvars]
        numbers = {*dtypes, *(jnp.dtype(x.dtype) for x in values)} - {jnp.dtype(bool)}
        every = [True] * len(dtypes)
        if numbers != {jnp.dtype(jnp.float32)} or size < LANES or not available():
            return many(*values), every

        def kernel(*values: Array) -> list[Array]:
            inputs = dict(zip(moving, zip(values, batched, strict=True), strict=True))
            out = _in_kernel(
                name, straight.jaxpr, [inputs.get(k, leaves[k]) for k in range(first, len(leaves))]
            )
            pairs = zip(out, dtypes, strict=True)
            return [x != 0 if dtype.kind == "b" else x for x, dtype in pairs]

        return jax.lax.platform_dependent(*values, cuda=kernel, default=many), every

    return call(*(leaves[k] for k in moving))


def _in_kernel(name: str, jaxpr: Jaxpr, args: Sequence[Any]) -> list[Array]:
    """The results for numbers that are known and inputs: pairs of an array and whether every sample has its own."""

    def of_one(x: Any) -> Any:
        if not isinstance(x, tuple):
            return x
        return jax.ShapeDtypeStruct(x[0].shape[1:] if x[1] else x[0].shape, x[0].dtype)

    program = traced(jaxpr, [of_one(x) for x in args])
    used = program.used()
    wide, shared = [k for k in used if args[k][1]], [k for k in used if not args[k][1]]

    def body(*refs: Callable) -> None:
        loads = dict(zip([*wide, *shared], refs, strict=False))
        results = refs[len(loads) :]
        for k, at, value in program.run(lambda k, at: loads[k](*at)):
            logical = jnp.result_type(value).kind == "b"
            results[k](jnp.where(value, 1.0, 0.0) if logical else value, *at)

    out = lane_kernel(
        name,
        body,
        [x.shape for x in program.outputs],
        [jnp.moveaxis(args[k][0].astype(jnp.float32), 0, -1) for k in wide],
        [args[k][0].astype(jnp.float32) for k in shared],
    )
    return [jnp.moveaxis(x, -1, 0) for x in out]
