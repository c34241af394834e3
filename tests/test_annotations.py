"""The check of annotations: the first calls of every test, of functions and of modules' fields."""

import annotations
import beartype
import jaxtyping
import numpy as np
import pytest
from jaxtyping import Float

import jax_inertia as ji


def test_a_function_s_first_calls_are_checked_in_every_test():
    @jaxtyping.jaxtyped(typechecker=beartype.beartype)
    def doubled(x: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        return 2.0 * x

    for _ in range(2):
        for _ in range(annotations.OFTEN):
            with pytest.raises(jaxtyping.TypeCheckError):
                doubled(np.zeros(4))
        assert doubled(np.zeros(4)).shape == (4,)
        annotations.calls.clear()


def test_the_package_is_checked():
    with pytest.raises(jaxtyping.TypeCheckError):
        ji.load_model(3.0)
    with pytest.raises(jaxtyping.TypeCheckError):
        ji.Log(time=3.0, joint_names=("a",), qpos=np.zeros((5, 1)))
