"""Every public function shows how it is used, and what it shows is so.

The examples stand by themselves: nothing is in scope but what they import. A few compile for half a minute and are of
functions that have tests of their own: they are `slow`.
"""

import doctest
import importlib
import inspect

import jax
import pytest

import jax_inertia

MODULES = (
    *(
        "estimation.batch_fit",
        "maths.innovation_tests",
        "dynamics.rigid_body",
        "estimation.inertial_filter",
        "estimation.identifiability",
        "maths.inertial_parameters",
        "maths.kalman",
        "maths.precision",
    ),
    *(
        "maths.least_squares",
        "logs.log",
        "logs.log_files",
        "estimation.log_filter",
        "model.load",
        "estimation.physical_estimate",
        "preflight.preflight",
        "robots.pendulum",
    ),
    *(
        "estimation.checkpoint",
        "estimation.stream",
        "estimation.suggest.excitation",
        "diagnosis.entry",
    ),
)
MADE_BY_HAND = {jax_inertia.Log, jax_inertia.Robot, jax_inertia.Stream}
SLOW = {
    f"jax_inertia.{name}"
    for name in (
        "estimation.batch_fit.fit",
        "diagnosis.entry.diagnose",
        "diagnosis.entry.with_drives",
        "estimation.log_filter.residual_noise",
        "estimation.suggest.excitation.suggest_motion",
    )
}


def public_functions() -> dict[str, object]:
    """What `jax_inertia` exports and the functions without an underscore of its public modules; classes that are made
    by hand.
    """
    found = {}
    for name in jax_inertia.__all__:
        thing = getattr(jax_inertia, name)
        if not inspect.isclass(thing) or thing in MADE_BY_HAND:
            found[f"{thing.__module__}.{thing.__name__}"] = thing
    for name in MODULES:
        module = importlib.import_module(f"jax_inertia.{name}")
        for thing in vars(module).values():
            own = inspect.isfunction(thing) and thing.__module__ == module.__name__
            if own and not thing.__name__.startswith("_"):
                found[f"{thing.__module__}.{thing.__name__}"] = thing
    return found


FUNCTIONS = public_functions()
EXAMPLES = {
    name: test
    for name, thing in FUNCTIONS.items()
    for test in doctest.DocTestFinder(recurse=False).find(thing, name, globs={})
    if test.examples
}


def test_every_public_function_has_an_example():
    assert len(FUNCTIONS) > 60
    assert sorted(set(FUNCTIONS) - set(EXAMPLES)) == []


@pytest.fixture(autouse=True)
def quickly():
    """Compiling is what these spend their time on."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)


@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=[pytest.mark.slow] * (x in SLOW)) for x in EXAMPLES]
)
def test_an_example_is_so(name):
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    failed, tried = runner.run(EXAMPLES[name], out=said.append)
    assert tried > 0
    assert failed == 0, "".join(said)
