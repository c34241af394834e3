"""Which of two searches of one log stands: the one that needs less, where it has an effect that the other lacks."""

from types import SimpleNamespace

import pytest

from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.gap.outcome import Search

WRIST, ELBOW = Place("joint", "wrist", 4), Place("joint", "elbow", 2)


def effect(family, place, price=20.0):
    return SimpleNamespace(
        family=SimpleNamespace(name=family), place=place, price=lambda rows: price
    )


def search(misfit, *chosen, granted=()):
    """What the comparison reads of a search."""
    out = object.__new__(Search)
    for name, value in {
        "pool": SimpleNamespace(evidence=SimpleNamespace(rows=1000)),
        "chosen": list(chosen),
        "misfits": [9e3, misfit],
        "strains": [SimpleNamespace(energy=x) for x in granted],
    }.items():
        object.__setattr__(out, name, value)
    return out


BENT = search(1000.0, effect("payload", ELBOW), granted=(300.0, 50.0))


@pytest.mark.parametrize(
    ("other", "stands"),
    [
        (search(1100.0, effect("payload", ELBOW), effect("torque_gain", WRIST)), True),
        # What it leaves more is as much as what the model was granted.
        (search(1360.0, effect("payload", ELBOW), effect("torque_gain", WRIST)), False),
        (search(1300.0, effect("payload", ELBOW), effect("torque_gain", WRIST, 80.0)), False),
        # Nothing new, however little it needs; the same effect elsewhere is new.
        (search(900.0, effect("payload", ELBOW)), False),
        (search(900.0), False),
        (search(900.0, effect("payload", WRIST)), True),
    ],
)
def test_an_effect_stands_for_numbers_that_are_bent_where_the_log_needs_less(other, stands):
    assert other.instead_of(BENT) is stands
