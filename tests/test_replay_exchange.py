"""Effects that are exchanged once others are there: whose numbers are where afterwards."""

import numpy as np

from jax_inertia.replay.fitting.errors import Weights
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.search import exchange
from jax_inertia.replay.search.candidates import Candidate
from jax_inertia.replay.search.exchange import _with
from jax_inertia.replay.search.odd import Odd, Search, _without_stiffness
from jax_inertia.replay.simulation.plant import Plant

NONE = np.zeros(0)


def candidate(family: str, count: int) -> Candidate:
    numbers = tuple(Parameter(f"{family}_{k}", 0, 0.0, 1.0, -9.0, 9.0) for k in range(count))
    return Candidate(family, numbers, ())


def fitted(*of: Candidate) -> Fit:
    table = tuple(p for c in of for p in c.parameters)
    n = len(table)
    weights = Weights(np.ones(1), np.ones(1))
    return Fit(table, np.arange(n) + 1.0, np.eye(n), np.eye(n), 9.0, NONE, NONE, weights)


def test_an_exchanged_effect_is_last_and_all_others_keep_their_numbers():
    own, load, lag, force = (
        candidate(f, k) for f, k in [("own", 2), ("load", 4), ("lag", 1), ("force", 3)]
    )
    found = fitted(own, load, lag)
    first = Odd(load, (2, 3, 4, 5), (lag, force))
    search = Search(found, (first, Odd(lag, (6,), ())), (), (force, own))
    new = _with(search, first, force, fitted(own, lag, force))
    for o in new.odd:
        assert tuple(new.found.table[k] for k in o.rows) == o.candidate.parameters
    assert [o.candidate for o in new.odd] == [force, lag]
    assert new.odd[0].rivals == (load, lag)
    assert new.pool == (own, load)


def test_a_second_exchange_finds_its_effect_where_the_first_left_it(monkeypatch):
    own, load, lag, play, force, bias = (
        candidate(f, k)
        for f, k in [("own", 2), ("load", 4), ("lag", 1), ("play", 1), ("force", 3), ("bias", 2)]
    )
    odd = (
        Odd(load, (2, 3, 4, 5), (force,)),
        Odd(lag, (6,), (bias,)),
        Odd(play, (7,), ()),
    )
    search = Search(fitted(own, load, lag, play), odd, (), ())

    def instead(plant, found, o, rival, records, floor):
        rest = [p for k, p in enumerate(found.table) if k not in o.rows]
        return fitted(Candidate("rest", tuple(rest), ()), rival)

    monkeypatch.setattr(exchange, "Unseen", lambda plant, records, floor: None)
    monkeypatch.setattr(exchange, "_instead", instead)
    monkeypatch.setattr(exchange, "_likelier", lambda *of: True)
    plant = Plant.__new__(Plant)
    new = exchange.exchanged(plant, search, (), (), NONE, lambda text: None)
    assert [o.candidate for o in new.odd] == [force, bias, play]
    for o in new.odd:
        assert tuple(new.found.table[k] for k in o.rows) == o.candidate.parameters


def test_a_spring_without_stiffness_is_a_torque_where_both_are_as_good():
    spring, bias = candidate("joint_spring", 2), candidate("torque_bias", 1)
    for short, wanted in ((3.0, bias), (30.0, spring)):
        fits = {spring: (100.0, fitted(spring)), bias: (100.0 - short, fitted(bias))}
        assert _without_stiffness(spring, fits) == wanted
