"""Policies trained in MJX by evolution strategies: one network, one task, simulators that differ.

Salimans et al. 2017 (arXiv:1703.03864): mirrored perturbations, ranks of returns, Adam. No gradient passes the
simulator, so dry friction needs no smoothing, and a generation is one batch of rollouts.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.example_libraries.optimizers import adam
from mujoco import mjx

from benchmarks.policy.arm import PERIOD, SECONDS, STEPS, tip, wanted

HIDDEN, MOST = 32, 0.4  # units, rad by which a target may be off the motion that is wanted
SPREAD, RATE = 0.05, 0.02  # of perturbations, of Adam
_AHEAD = np.array([1, 3])  # periods
_SHAPES = ((17, HIDDEN), (HIDDEN,), (HIDDEN, 3), (3,))
SIZE = sum(int(np.prod(s)) for s in _SHAPES)
_BACK = 4
"""Periods by which a target can be late at most."""


class Simulator(NamedTuple):
    """What a policy is trained in."""

    name: str
    model: mujoco.MjModel
    randomised: Callable[[Any, jax.Array], tuple[Any, Any]]
    """(mjx.Model, keys) → (model with one draw for each key, in_axes), as trainers of MuJoCo Playground ask for."""
    delays: Callable[[jax.Array, float], jax.Array]
    """(keys, step) → by how many steps targets come late (keys, joints)."""


def act(weights, q, v, motion, k, xp=np):
    """The targets of period k [rad], of where the arm is and where it is wanted now and soon."""
    parts, start = [], 0
    for shape in _SHAPES:
        size = int(np.prod(shape))
        parts.append(weights[start : start + size].reshape(shape))
        start += size
    into, bias, out, offset = parts
    now = motion[k]
    seen = [10.0 * (now - q), 0.3 * v]
    seen += [5.0 * (motion[k + a] - now) for a in _AHEAD]
    pitch = now[1] + now[2]
    seen.append(
        xp.stack([xp.cos(now[1]), xp.sin(now[1]), xp.cos(pitch), xp.sin(pitch), 1.0 + 0.0 * pitch])
    )
    hidden = xp.tanh(xp.concatenate(seen) @ into + bias)
    return now + MOST * xp.tanh(hidden @ out + offset)


def _drives(model: mujoco.MjModel) -> np.ndarray:
    """Actuators of the three joints: a corrected model may have others."""
    at_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    return np.array(
        [np.flatnonzero(at_joint & (model.actuator_trnid[:, 0] == j))[0] for j in range(3)]
    )


def error(model, drives, late, motion, weights) -> jax.Array:
    """Distance of the hand from where it is wanted, mean over one motion [m]."""
    data = mjx.make_data(model).replace(qpos=motion[0])

    def period(carry, k):
        data, before, sent = carry
        v = (data.qpos - before) / PERIOD
        sent = jnp.roll(sent, 1, axis=0).at[0].set(act(weights, data.qpos, v, motion, k, jnp))
        before = data.qpos
        for i in range(STEPS):
            back = jnp.clip(-((i - late) // STEPS), 0, _BACK - 1)
            ctrl = data.ctrl.at[drives].set(sent[back, jnp.arange(3)])
            data = mjx.step(model, data.replace(ctrl=ctrl))
        return (data, before, sent), jnp.linalg.norm(tip(data.qpos, jnp) - tip(motion[k + 1], jnp))

    start = data, motion[0], jnp.repeat(motion[:1], _BACK, axis=0)
    off = jax.lax.scan(period, start, jnp.arange(round(SECONDS / PERIOD)))[1]
    return jnp.mean(jnp.nan_to_num(off, nan=1.0))


def trained(
    simulator: Simulator, *, seeds: int, generations: int, pairs: int, motions: int
) -> tuple[np.ndarray, np.ndarray]:
    """Weights of each seed (S, `SIZE`), and the error in its own simulator after each generation (S, G) [m]."""
    model = mjx.put_model(simulator.model)
    drives = _drives(simulator.model)
    begin, update, weights_of = adam(RATE)

    def generation(key, state, targets):
        of_draw, of_delay, of_noise = jax.random.split(key, 3)
        drawn, axes = simulator.randomised(model, jax.random.split(of_draw, motions))
        late = simulator.delays(jax.random.split(of_delay, motions), PERIOD / STEPS)
        weights = weights_of(state)
        noise = jax.random.normal(of_noise, (pairs, SIZE))
        every = jnp.concatenate([weights + SPREAD * noise, weights - SPREAD * noise, weights[None]])
        runs = jax.vmap(error, in_axes=(axes, None, 0, 0, None))
        errors = jax.vmap(lambda w: jnp.mean(runs(drawn, drives, late, targets, w)))(every)
        ranks = jnp.argsort(jnp.argsort(errors[:-1])) / (2 * pairs - 1.0) - 0.5
        slope = (ranks[:pairs] - ranks[pairs:]) @ noise / (pairs * SPREAD)
        return errors[-1], slope

    @jax.jit
    @partial(jax.vmap, in_axes=(0, 0, None, 0))
    def one(key, state, step, targets):
        at, slope = generation(key, state, targets)
        return at, update(step, slope, state)

    keys = jax.random.split(jax.random.key(0), seeds)
    draws = [np.random.default_rng(1000 + s) for s in range(seeds)]
    starts = 0.1 * jax.vmap(lambda k: jax.random.normal(k, (SIZE,)))(keys)
    # From targets that are the motion itself: the last layer adds nothing yet.
    state = jax.vmap(begin)(starts.at[:, -(3 * HIDDEN + 3) :].set(0.0))
    history = []
    for step in range(generations):
        keys = jax.vmap(partial(jax.random.fold_in, data=step))(keys)
        targets = jnp.asarray(
            np.stack([[wanted(r) for _ in range(motions)] for r in draws]), jnp.float32
        )
        at, state = one(keys, state, step, targets)
        history.append(np.asarray(at))
    return np.asarray(jax.vmap(weights_of)(state)), np.stack(history, axis=1)
