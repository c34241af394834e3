"""Which link took up a load: the bank against MuJoCo C rollouts, and what it must leave alone."""

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.online import draws, links
from jax_inertia import load_model
from jax_inertia.estimation.online.load_bank import make_load_bank
from jax_inertia.estimation.priors import Load
from jax_inertia.maths.sample_weight import mixture


def test_a_mixture_counts_noise_in_full_and_a_shock_by_its_size():
    rows = jnp.asarray(5.0)
    squares = np.array([1.0, 5.0, 15.0, 500.0, 5e4, 5e6])
    weights = np.array([float(mixture(jnp.asarray(x), rows)[1]) for x in squares])
    assert np.all(np.diff(weights) <= 0)
    assert weights[1] > 0.99
    # Ten, a hundred, a thousand times the noise: 1/κ² of it.
    np.testing.assert_allclose(weights[3:], [1e-2, 1e-4, 1e-6], rtol=0.1)
    # One sample that no noise explains costs as much as a load, not as much as its square.
    lost = float(mixture(jnp.asarray(0.0), rows)[0] - mixture(jnp.asarray(5e4), rows)[0])
    assert 20.0 < lost < 50.0


def test_candidates_are_sets_of_the_links():
    who = draws.subject("small")
    robot = load_model(who.model)
    args = {"sigma_tau": 0.1, "load": Load(1.0)}
    bank = make_load_bank(
        robot, ["upper", "hand"], candidates=[["hand"], ["hand", "upper"]], **args
    )
    assert bank.candidates == ((1,), (0, 1))
    with pytest.raises(ValueError, match=r"candidate \['upper'\] is no set of the links"):
        make_load_bank(robot, ["hand"], candidates=[["upper"]], **args)
    with pytest.raises(ValueError, match="threshold is"):
        make_load_bank(robot, ["hand"], threshold=1.5, **args)


@pytest.fixture(scope="module")
def small():
    """The two-joint arm, both links watched: (subject, bank, its run)."""
    who = draws.subject("small")
    who = draws.Subject(**{**vars(who), "links": ("upper", "hand")})
    bank = links.bank_of(who)
    return who, bank, lambda log: links.follow(bank, jax.tree.map(jnp.asarray, log))


@pytest.mark.slow
@pytest.mark.parametrize("shocks", [False, True])
def test_the_hand_s_load_is_the_hand_s(small, shocks):
    who, bank, run = small
    rng = np.random.default_rng(5)
    path = draws.trajectory(who, 3.0, rng)
    load = draws.Ball(1.2, np.array([0.05, 0.02, -0.2]), 0.05)
    half = round(1.5 * draws.RATE)
    force = np.concatenate(
        [
            draws.forces(who.model, path, slice(0, half)),
            draws.forces(draws.carrying(who.model, {"hand": load}), path, slice(half, None)),
        ]
    )
    if shocks:
        for at in (200, 420, 600, 1100):
            force[at : at + 10] += rng.normal(size=2) * 30.0
    seen = run(draws.observed(who, path, force, rng))
    opened, time = np.asarray(seen.opened), np.arange(len(seen.opened)) * draws.WINDOW / draws.RATE
    [first, *_] = np.flatnonzero(opened >= 0)
    assert 1.5 < time[first] < 2.5
    assert bank.candidates[opened[first]] == (1,)
    mass = np.asarray(seen.pi)[..., 0] - np.asarray(bank.estimator.robot.pi)[:, 0]
    # Two joints see mass and first moment together: the mass alone is known to a quarter.
    assert mass[-1, 1] == pytest.approx(1.2, abs=0.3)
    assert np.abs(mass[:first]).max() < 0.05  # both rest before,
    assert np.abs(mass[:, 0]).max() < 0.05  # and the upper arm always
    np.testing.assert_allclose(seen.probability.sum(axis=1), 1.0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["arm", "humanoid", "quadruped"])
@pytest.mark.parametrize(
    "kind", [{"shocks": False}, {"shocks": True}, {"shocks": False, "loads": 2}]
)
def test_links_of_three_robots(name, kind):
    who = draws.subject(name)
    found = links.scored(links.bank_of(who), who, range(100, 108), **kind)
    assert found["right"] >= 6
    assert found["false"] == 0


@pytest.mark.slow
def test_a_bank_of_many_robots_is_each_of_them(small):
    who, bank, _ = small
    rng = np.random.default_rng(1)
    path = draws.trajectory(who, 0.2, rng)
    log = draws.observed(who, path, draws.forces(who.model, path), rng)
    two = jax.tree.map(lambda x: jnp.stack([jnp.asarray(x), jnp.asarray(x)]), log)
    assert isinstance(who.model, mujoco.MjModel)

    def run(one):
        return jax.lax.scan(lambda s, x: bank.step(s, x, 0.016), bank.initial(), one)[1]

    every = eqx.filter_jit(jax.vmap(run))(two)
    alone = eqx.filter_jit(run)(jax.tree.map(jnp.asarray, log))
    np.testing.assert_allclose(every.probability[1], alone.probability, atol=1e-9)
