"""Numbers as reports print them: no digit that the interval does not leave."""

import pytest

from jax_inertia.text.words import interval, plus_minus


@pytest.mark.parametrize(
    ("value", "low", "high", "as_interval", "as_half"),
    [
        (0.8984, 0.8263, 0.9705, "0.898 [0.826, 0.971]", "0.898 ± 0.072"),
        (3.2e-06, -0.0013, 0.0013, "0.0000 [-0.0013, 0.0013]", "0.0000 ± 0.0013"),
        (-3.2e-06, -0.0013, 0.0013, "0.0000 [-0.0013, 0.0013]", "0.0000 ± 0.0013"),
        (12.04, 10.7, 13.3, "12.0 [10.7, 13.3]", "12.0 ± 1.3"),
        (1234.0, 1100.0, 1368.0, "1234 [1100, 1368]", "1234 ± 134"),
        # Nothing is known of it but the value: a bound, or a number that was held.
        (0.001, 0.001, 0.001, "0.001", "0.001"),
        (0.5, float("-inf"), float("inf"), "0.5", "0.5"),
        # Too fine for decimals.
        (4.01e-7, 3.94e-7, 4.08e-7, "4e-07 [3.9e-07, 4.1e-07]", "4e-07 ± 7e-09"),
    ],
)
def test_digits_are_those_that_the_interval_leaves(value, low, high, as_interval, as_half):
    assert interval(value, low, high) == as_interval
    assert plus_minus(value, low, high) == as_half
