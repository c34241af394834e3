"""Forces along axes that a log hardly tells; random linear problems."""

import numpy as np

from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.gap.block import Block
from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.families.force import ConstantForce
from jax_inertia.gap.families.joint import ViscousFriction
from jax_inertia.gap.moderate import moderated
from jax_inertia.gap.pool import Pool

ROWS = 2000
FORCE, DAMPING = np.array([12.0, -9.0, 7.0]), 0.8


def effect(family, columns, theta):
    """A linear effect with these columns in the charged metric."""
    block = object.__new__(Block)
    vars(block).update(shape=(), columns=columns)
    count = columns.shape[1]
    place = Place(family.kind, "here", 0)
    return Candidate(family, place, block, theta, np.eye(count), np.zeros(count))


def problem(sizes, seed):
    """A force told to about 1/sizes of a newton on each axis, and a damping; both as least squares has them."""
    rng = np.random.default_rng(seed)
    turned = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    columns = rng.standard_normal((ROWS, 3)) * sizes / np.sqrt(ROWS) @ turned
    damping = rng.standard_normal((ROWS, 1))
    y = columns @ FORCE + DAMPING * damping[:, 0] + rng.standard_normal(ROWS)
    theta = np.linalg.lstsq(np.hstack([columns, damping]), y, rcond=None)[0]
    pool = object.__new__(Pool)
    pool.evidence = object.__new__(Evidence)
    vars(pool.evidence).update(y=y, used=np.ones((ROWS, 1), bool))
    chosen = [
        effect(ConstantForce(), columns, theta[:3]),
        effect(ViscousFriction(), damping, theta[3:]),
    ]
    return pool, chosen, turned


def test_what_the_log_tells_stays_as_it_is():
    pool, chosen, _ = problem(sizes=np.array([30.0, 40.0, 50.0]), seed=0)
    force, damping = moderated(pool, chosen)
    # Off by a small part of their own errors of 0.02 to 0.03 N.
    np.testing.assert_allclose(force.theta, chosen[0].theta, atol=3e-3)
    np.testing.assert_allclose(damping.theta, chosen[1].theta, atol=1e-4)


def test_a_force_is_no_larger_than_the_log_tells():
    """Along an axis told to a thousand newtons least squares has hundreds of them, and none of it is known."""
    far, near = [], []
    for seed in range(20):
        pool, chosen, turned = problem(sizes=np.array([30.0, 40.0, 1e-3]), seed=seed)
        force, damping = moderated(pool, chosen)
        far.append(np.linalg.norm(chosen[0].theta - FORCE))
        near.append(np.linalg.norm(force.theta - FORCE))
        told = turned[:2]
        np.testing.assert_allclose(told @ force.theta, told @ FORCE, atol=0.15)
        np.testing.assert_allclose(damping.theta, DAMPING, atol=0.1)
    assert np.median(far) > 200.0
    assert max(near) < np.linalg.norm(FORCE)


def test_what_is_no_force_is_left_alone():
    pool, (_, damping), _ = problem(sizes=np.ones(3), seed=0)
    assert moderated(pool, [damping]) == [damping]
