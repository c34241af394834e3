"""The filter's step for a controller without Python: a file of C, or a program of StableHLO.

    ji.write_c_step("hand_filter.c", estimator, observation)       # and hand_filter.h, for any C or C++ compiler
    program = ji.export_step(estimator, observation)               # jax.export: program.serialize()

Both are made of `estimator.step` in the form `Elementary`, which calls no library, for observations with the arrays of
the one given (its numbers are not used).
"""

import dataclasses
import functools
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import export
from jaxtyping import Array, Bool, Float

from jax_inertia.estimation.inertial_filter import Estimator, State, Step
from jax_inertia.estimation.joint_terms import FoundTerms
from jax_inertia.estimation.physical_estimate import Estimate
from jax_inertia.logs.atomic_files import whole_file
from jax_inertia.maths import kalman, kalman_forms
from jax_inertia.maths.scalar.c_source import Structure, c_source
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.generalised_motion import Motion


class Sample(NamedTuple):
    """What a control loop measures between two steps."""

    observation: Observation
    dt: Float[Array, ""]
    """Since the sample before [s]."""


class Found(NamedTuple):
    """What a control loop gets of one sample."""

    estimate: Estimate
    innovation: kalman.Innovation
    threshold: Float[Array, ""]
    """γ of the gate."""
    reopened: Bool[Array, ""]
    joints: FoundTerms | None
    """Friction and offsets, where they are estimated."""


def _stepped(estimator: Estimator, state: State, sample: Sample) -> tuple[State, Found]:
    estimator = eqx.tree_at(lambda e: e.form, estimator, kalman_forms.Elementary())
    after, step = estimator.step(state, sample.observation, sample.dt)
    estimate, joints = estimator.estimate(step.belief), estimator.joint_terms(step.belief)
    return after, Found(estimate, step.innovation, step.threshold, step.reopened, joints)


def write_c_step(
    path: str | os.PathLike[str], estimator: Estimator, observation: Observation
) -> None:
    """Write `estimator.step` for one observation as C: PATH.c and PATH.h, which declares

        void NAME(NAME_state *state, const NAME_sample *sample, NAME_found *found);

    with NAME the file's and NAME_start the state before the first sample. Compile with -O1 and without -ffast-math, by
    which what is not finite would no longer be found. A call allocates nothing and takes the same operations whatever
    the sample. Raises ValueError for a name that is none in C.

    >>> import tempfile
    >>> from pathlib import Path
    >>> import jax
    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation.online.exported_step import write_c_step
    >>> from jax_inertia.estimation.inertial_filter import make_estimator
    >>> from jax_inertia.estimation.log_filter import observe
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> first = jax.tree.map(lambda x: x[0], observe(swing(), robot))
    >>> path = Path(tempfile.mkdtemp()) / "lower.c"
    >>> write_c_step(path, make_estimator(robot, ["lower"], sigma_tau=0.1, paper=True), first)
    >>> "double com[1][3];" in path.with_suffix(".h").read_text()
    True
    """
    path = Path(path)
    if path.suffix != ".c" or not path.stem.isidentifier():
        raise ValueError(f"{path.name} is no name for a file of C; give one such as hand_filter.c")
    arguments = [
        Structure("state", estimator.initial()),
        Structure("sample", Sample(observation, jnp.zeros(()))),
    ]
    source = c_source(
        path.stem,
        lambda state, sample: _stepped(estimator, state, sample),
        arguments,
        ["state", "found"],
        start="state",
    )
    for suffix, text in ((".h", source.header), (".c", source.code)):
        with whole_file(path.with_suffix(suffix)) as file:
            file.write(text.encode())


def export_step(estimator: Estimator, observation: Observation) -> export.Exported:
    """`estimator.step` for one observation as a program of StableHLO without custom calls, of (state, Sample).

    What it is called with and gives (State, Found) may be serialised with it (`Exported.serialize`): their types are
    registered for `jax.export` here.

    >>> import jax
    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation.online.exported_step import export_step
    >>> from jax_inertia.estimation.inertial_filter import make_estimator
    >>> from jax_inertia.estimation.log_filter import observe
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> first = jax.tree.map(lambda x: x[0], observe(swing(), robot))
    >>> ekf = make_estimator(robot, ["lower"], sigma_tau=0.1, paper=True)
    >>> program = export_step(ekf, first)
    >>> "custom_call" in program.mlir_module()
    False
    """
    register_for_export()
    arguments = estimator.initial(), Sample(observation, jnp.zeros((), estimator.robot.pi.dtype))
    shapes = jax.tree.map(
        lambda x: jax.ShapeDtypeStruct(jnp.shape(x), jnp.asarray(x).dtype), arguments
    )
    program = jax.jit(lambda state, sample: _stepped(estimator, state, sample))
    return export.export(program)(*shapes)


_MODULES = (
    State,
    Step,
    Observation,
    Motion,
    Estimate,
    FoundTerms,
    kalman.Belief,
    kalman.Innovation,
)
_TUPLES = (Sample, Found)


@functools.cache
def register_for_export() -> None:
    """Let `jax.export` serialise programs that take or give a filter's state, samples and results."""
    for kind in _TUPLES:
        export.register_namedtuple_serialization(
            kind, serialized_name=f"jax_inertia.{kind.__name__}"
        )
    for kind in _MODULES:
        export.register_pytree_node_serialization(
            kind,
            serialized_name=f"jax_inertia.{kind.__name__}",
            serialize_auxdata=functools.partial(_static_text, kind),
            deserialize_auxdata=bytes,
            from_children=functools.partial(_with_static, kind),
        )


def _fields(kind: type, *, static: bool) -> list[str]:
    return [x.name for x in dataclasses.fields(kind) if x.metadata.get("static", False) is static]


def _static_text(kind: type, auxdata: Any) -> bytes:
    """The static fields of a module as JSON: they are names and numbers."""
    leaf = jax.tree.structure(0)
    children = [leaf] * len(_fields(kind, static=False))
    registry = jax.tree_util.default_registry
    node = jax.tree_util.PyTreeDef.from_node_data_and_children(registry, (kind, auxdata), children)
    one = jax.tree.unflatten(node, children)
    return json.dumps({name: getattr(one, name) for name in _fields(kind, static=True)}).encode()


def _with_static(kind: type, aux_data: Any, children: Sequence[Any]) -> Any:
    """A module around children that need not be arrays."""
    known = {name: tuple(value) for name, value in json.loads(aux_data).items()}
    one = object.__new__(kind)
    for name, value in {
        **dict(zip(_fields(kind, static=False), children, strict=True)),
        **known,
    }.items():
        object.__setattr__(one, name, value)
    return one
