"""What counts as noise where a model misses one joint by far more than another; logs by MuJoCo C."""

import mujoco
import numpy as np
import pytest
from arm_log import ARM, simulate
from scipy import signal

from jax_inertia import load_model
from jax_inertia.gap import Verdict, diagnose, select
from jax_inertia.gap.block import Beside
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.families import LIBRARY
from jax_inertia.gap.finder import finder
from jax_inertia.gap.loudness import QUIETEST, Loudness
from jax_inertia.gap.nuisance import Tolerance
from jax_inertia.gap.search import find
from jax_inertia.gap.together import stacked
from jax_inertia.signals.torque_residual import prepare

LOUD, MEMORY, BIAS = 20.0, 0.6, 0.25


def loudness(left, floor):
    """Of samples (T, 2) on two rows."""
    evidence = object.__new__(Evidence)
    evidence.used = np.ones(left.shape, bool)
    return Loudness.of(evidence, left.ravel(), floor)


def spread(columns, draws):
    """Variance of the number fitted by least squares, against that where each sample's noise is one."""
    energy = float(np.sum(columns**2))
    fitted = np.tensordot(draws, columns, axes=2) / energy
    return float(np.var(fitted) * energy)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.7, 1.0])
def test_noise_beside_an_effect_is_the_variance_of_its_number(share):
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((400, 2)) * np.sqrt([1.0 - share, share])
    draws = rng.standard_normal((8000, 400, 2)) * [1.0, LOUD]
    loud = loudness(draws[0], np.full(2, 400.0))
    energy = np.sum(columns**2, axis=0)
    assert loud.beside(energy) == pytest.approx(spread(columns, draws), rel=0.2)


def test_what_remembers_counts_for_fewer_samples():
    rng = np.random.default_rng(2)
    steps = 3.0 * np.sqrt(1.0 - MEMORY**2) * rng.standard_normal((4000, 1000, 2))
    draws = signal.lfilter([1.0], [1.0, -MEMORY], steps, axis=1)[:, 500:]
    slow = np.ones((500, 2))
    loud = loudness(draws[0], np.full(2, 500.0))
    assert loud.beside(np.sum(slow**2, axis=0)) == pytest.approx(spread(slow, draws), rel=0.25)
    assert loud.whole == pytest.approx(np.mean(loud.rows), rel=0.2)
    assert loud.evenly.beside(np.array([1.0, 0.0])) == loud.whole
    assert loud.evenly.even
    assert not loud.even


def test_noise_taken_for_louder_than_it_is_counts_for_what_it_is():
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((500, 2))
    draws = 0.8 * rng.standard_normal((4000, 500, 2))
    quiet = loudness(draws[0], np.full(2, 500.0))
    assert quiet.quiet
    assert quiet.beside(np.sum(columns**2, axis=0)) == pytest.approx(
        spread(columns, draws), rel=0.1
    )
    # A few samples that happen to be small say nothing of their row.
    few = draws[0].copy()
    few[:, 1] *= np.arange(500) < 5
    assert loudness(few, np.array([500.0, 50.0])).rows[1] == pytest.approx(quiet.whole, rel=0.1)


def test_no_log_is_believed_to_be_without_noise():
    nothing = loudness(np.zeros((500, 2)), np.full(2, 500.0))
    assert nothing.even
    assert nothing.whole == QUIETEST
    # A row that no sample of counts says nothing.
    assert loudness(np.zeros((500, 2)), np.array([500.0, 0.0])).even


def strange(t, q, v, u):
    """A constant torque on the shoulder, and on the elbow what no library has."""
    return np.array([BIAS, 1.5 * np.sin(2.0 * v[0]) * np.cos(4.0 * q[1])])


@pytest.mark.slow
def test_a_joint_is_heard_beside_one_that_no_effect_explains():
    found = diagnose(load_model(mujoco.MjModel.from_xml_string(ARM)), simulate(strange))
    assert found.verdict is Verdict.UNKNOWN
    [bias] = [f for f in found.findings if f.place.name == "shoulder"]
    assert bias.family == "torque_bias"
    assert bias.parameters["bias"].low <= BIAS <= bias.parameters["bias"].high


@pytest.fixture(scope="module")
def biased():
    """What is found where a constant torque acts on the shoulder."""
    log = simulate(lambda t, q, v, u: np.array([BIAS, 0.0]))
    robot = load_model(mujoco.MjModel.from_xml_string(ARM))
    return find(finder(prepare(robot, log), log, Tolerance(), list(LIBRARY), 3))[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parts", "first", "taken"), [(True, -1, 0), (True, 0, 0), (False, -1, -1)]
)
def test_where_the_ways_part_the_likelier_end_is_taken(biased, monkeypatch, parts, first, taken):
    ends = two_ends(biased, monkeypatch, first, parts)
    chosen, _, misfits = select.select(biased.pool, 3, biased.noise_by_row)
    assert chosen == ends[taken]
    assert len(misfits) == len(chosen) + 1


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "taken"), [(1.0, -1), (1e-6, 0)])
def test_far_above_the_noise_the_end_that_foretells_more_is_taken(
    biased, monkeypatch, noise, taken
):
    """Whatever noise's own units say of it."""
    ends = two_ends(biased, monkeypatch, first=-1, parts=True)
    monkeypatch.setattr(select, "_likelier", lambda *_: False)
    assert select.select(biased.pool, 3, noise * biased.noise_by_row)[0] == ends[taken]


@pytest.mark.slow
@pytest.mark.parametrize("beside", ["nothing", "the cause"])
def test_what_cannot_lead_is_left_out_and_nothing_else(biased, beside):
    """No effect explains more than its columns may with any weights, so the best are fitted as among all."""
    pool, chosen = biased.pool, biased.chosen if beside == "the cause" else []
    left = Beside.of(pool.evidence, *stacked(pool, chosen))
    every = pool.best(left)
    assert all(c.gain <= left.most(c.block) * (1.0 + 1e-6) for c in every)
    best = max(c.gain for c in every)
    few = {c.key: c.gain for c in pool.best(left, share=0.3)}
    assert len(few) < len(every)
    for c in every:
        if c.gain > 0.3 * best:
            assert few[c.key] == c.gain


def two_ends(biased, monkeypatch, first: int, parts: bool) -> dict:
    """Two ways on, which end at the cause and at what is least like it, in one order or the other."""
    ends = {0: biased.chosen, -1: [biased.ranking[-1]]}

    def path(pool, chosen, max_effects, floor, *, own_rows):
        end = ends[-1 - first if own_rows else first]
        return select._Path(end, biased.ranking, [] if parts and not own_rows else None)

    monkeypatch.setattr(select, "_path", path)
    return ends
