"""Which link carries the load: MuJoCo C rollouts of three robots, a load on a link drawn at random at half time."""

import json
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.harness.results import commit
from benchmarks.online.draws import (
    RATE,
    REACH,
    WINDOW,
    ball,
    carrying,
    forces,
    noise_of_acceleration,
    noise_of_torque,
    observed,
    subject,
    trajectory,
)
from jax_inertia import load_model
from jax_inertia.estimation.online.load_bank import LoadBank, make_load_bank
from jax_inertia.estimation.priors import Load

SECONDS, CHANGE = 6.0, 3.0
FIRST = 1000
"""The first seed that is scored; those below 100 were looked at while the bank was built."""
SHOCKS = 8
"""Of 20 ms each, at times drawn at random."""


def bank_of(who) -> LoadBank:
    """The bank of a subject's links, told its sensors' noise."""
    return make_load_bank(
        load_model(who.model),
        who.links,
        sigma_tau=jnp.asarray(noise_of_torque(who)),
        sigma_a=float(noise_of_acceleration(who)),
        load=Load(who.load, REACH),
    )


def rollout(who, seed: int, *, shocks: bool = False, loads: int = 1):
    """(observation, candidate that changes) of one seed."""
    rng = np.random.default_rng([seed, 3])
    chosen = sorted(rng.choice(len(who.links), size=loads, replace=False))
    put = {who.links[i]: ball(who, who.links[i], rng, least=0.4) for i in chosen}
    path = trajectory(who, SECONDS, rng)
    k = round(CHANGE * RATE)
    force = np.concatenate(
        [
            forces(who.model, path, slice(0, k)),
            forces(carrying(who.model, put), path, slice(k, None)),
        ]
    )
    if shocks:
        # An impact that no sensor of force sees: on all rows, a hundred times their noise.
        for _ in range(SHOCKS):
            at = rng.integers(0, len(force) - 10)
            size = 100.0 * np.array(noise_of_torque(who)) * rng.normal(size=force.shape[1])
            force[at : at + 10] += size
    return observed(who, path, force, rng), tuple(int(i) for i in chosen)


@eqx.filter_jit
def follow(bank: LoadBank, log):
    def one(state, x):
        state, seen = bank.step(state, x, WINDOW / RATE)
        return state, seen

    return jax.lax.scan(one, bank.initial(), log)[1]


def scored(bank: LoadBank, who, seeds, **kind) -> dict:
    """How often the right links, and no others, were opened within a second, and how often any before."""
    right = false = 0
    rows = []
    for seed in seeds:
        log, chosen = rollout(who, seed, **kind)
        seen = follow(bank, jax.tree.map(jnp.asarray, log))
        time, opened = np.asarray(log.motion.time), np.asarray(seen.opened)
        at = np.flatnonzero(opened >= 0)
        false += int(np.sum(time[at] < CHANGE))
        soon = {
            i for k in at if CHANGE <= time[k] <= CHANGE + 1.0 for i in bank.candidates[opened[k]]
        }
        right += sorted(soon) == list(chosen)
        first = [float(time[k]) - CHANGE for k in at if time[k] >= CHANGE]
        rows.append(
            {
                "seed": int(seed),
                "true": list(chosen),
                "opened": [
                    [round(float(time[k]), 3), list(bank.candidates[opened[k]])] for k in at
                ],
                "after_s": round(first[0], 3) if first else None,
            }
        )
    return {"right": int(right), "false": false, "seeds": len(rows), "rollouts": rows}


KINDS: dict[str, dict] = {"calm": {}, "shocks": {"shocks": True}, "two_loads": {"loads": 2}}


def main() -> None:
    """python -m benchmarks.online.links ROBOT KIND SEEDS OUT"""
    jax.config.update("jax_enable_x64", True)
    name, kind, seeds, out = (
        sys.argv[1],
        sys.argv[2],
        FIRST + np.arange(int(sys.argv[3])),
        sys.argv[4],
    )
    who = subject(name)
    found = {
        "commit": commit(),
        "robot": name,
        "kind": kind,
        **scored(bank_of(who), who, seeds, **KINDS[kind]),
    }
    with open(out, "w") as file:
        json.dump(found, file)
    print(name, kind, found["right"], found["false"])


if __name__ == "__main__":
    main()
