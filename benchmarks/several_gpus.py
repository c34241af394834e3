"""The filter step sharded over 1, 2, 4 ... devices of one host: as many robots on each, so time should not grow.

    python -m benchmarks.several_gpus [--robots 65536] [--out benchmarks/results/several_gpus.json]

The batch axis alone is sharded (`jax.sharding`), and nothing is exchanged; what is lost is the host's time to dispatch.
"""

import argparse
import json
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from benchmarks.harness import fleet
from jax_inertia.maths.fused_update import FusedSquareRoot

STEPS, ROUNDS = 20, 5


def measured(devices: int, robots: int) -> dict:
    """Rate of a chain of filter steps, each fed with the result of the one before."""
    robot = fleet.humanoid_robot("float32")
    filter_ = fleet.estimator(robot, form=FusedSquareRoot())
    mesh = Mesh(np.array(jax.devices()[:devices]), ("robots",))
    sharding = NamedSharding(mesh, PartitionSpec("robots"))
    count = robots * devices

    def spread(x):
        return jax.device_put(np.resize(np.asarray(x), (count, *x.shape[1:])), sharding)

    seen = jax.tree.map(spread, fleet.observations(robot, 4096))
    state = jax.tree.map(lambda x: spread(np.asarray(x)[None]), filter_.initial())
    step = jax.jit(
        jax.shard_map(
            jax.vmap(lambda s, x: filter_.step(s, x, 1 / fleet.RATE)[0]),
            mesh=mesh,
            in_specs=PartitionSpec("robots"),
            out_specs=PartitionSpec("robots"),
            check_vma=False,
        ),
        donate_argnums=0,
    )
    start = time.perf_counter()
    state = jax.block_until_ready(step(state, seen))
    compile_s = time.perf_counter() - start
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        for _ in range(STEPS):
            state = step(state, seen)
        jax.block_until_ready(state)
        times.append((time.perf_counter() - start) / STEPS)
    return {
        "per_s": count / float(np.median(times)),
        "call_ms": 1e3 * float(np.median(times)),
        "compile_s": compile_s,
        "finite": float(jnp.mean(jnp.isfinite(state.belief.mean).all(axis=-1))),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robots", type=int, default=65_536, help="on each device")
    parser.add_argument("--out", type=Path, help="JSON file")
    args = parser.parse_args()
    every, found = len(jax.devices()), {"device": jax.devices()[0].device_kind}
    devices = 1
    while devices <= every:
        found[str(devices)] = row = measured(devices, args.robots)
        share = row["per_s"] / devices / found["1"]["per_s"]
        print(f"{devices} devices: {row['per_s']:.3g} steps/s, {share:.0%} of {devices} × one")
        devices *= 2
    if args.out:
        args.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
