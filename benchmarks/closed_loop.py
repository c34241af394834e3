"""Robots a second of `likelihood.batch`: many logs of position-controlled robots in one call, compiling apart.

    python benchmarks/closed_loop.py --robots 16 --seconds 4 --machine leg

Every robot has gains, friction and a delay of its own, simulated by MuJoCo C (`worlds/targets/machines.py`); from
`--simulated` of them on, logs repeat with other noise of the encoders.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.worlds.targets import machines as cases
from jax_inertia.likelihood import batch
from jax_inertia.likelihood.linearised import joints_of
from jax_inertia.model.load import load_model


def logs_of(machine: cases.Machine, robots: int, simulated: int, seconds: float):
    """(logs, kp of each over the one that is stated, friction beyond the model's)."""
    rng, n = np.random.default_rng(0), len(machine.joints)
    few = min(robots, simulated)
    kp, dry = rng.uniform(0.8, 1.2, (few, n)), rng.uniform(0.0, 0.3, (few, n))
    dry *= machine.kp / 28.0
    runs = [
        cases.simulated(machine, cases.Hidden(friction=dry[b], kp=kp[b], delay=0.01), seconds, b)
        for b in range(few)
    ]
    told = np.array([cases.targets(machine, seconds, b) for b in range(few)])
    at = np.arange(robots) % few
    q = np.array([r["qpos"] for r in runs])[at]
    again = (at != np.arange(robots))[:, None, None]
    q = q + cases.COUNT / np.sqrt(12.0) * again * rng.normal(size=q.shape)
    gains = (np.tile(x, (robots, 1)) for x in (machine.kp, machine.kd))
    return batch.Logs(q, told[at], *gains), kp[at], dry[at]


def main() -> None:
    """Print a table."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--simulated", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--machine", choices=cases.MACHINES, default="leg")
    parser.add_argument("--double", action="store_true", help="float64")
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", args.double)
    machine = cases.MACHINES[args.machine]()
    logs, kp, dry = logs_of(machine, args.robots, args.simulated, args.seconds)
    robot = load_model(mujoco.MjModel.from_xml_string(machine.xml))
    joints = joints_of(robot, machine.joints)
    assert joints is not None
    numbers = batch.ordinary(robot, joints, machine.kp, machine.kd, logs.q[0])
    dtype = jnp.float64 if args.double else jnp.float32
    logs = jax.tree.map(lambda x: jnp.asarray(x, dtype), logs)
    settings = {
        "period": 1.0 / machine.log_hz, "stamps": 0.02 * np.arange(logs.target.shape[1]), "joints": joints,
        "numbers": numbers, "stiffest": 80.0,
    }  # fmt: skip
    walls = []
    for _ in range(3):
        begin = time.perf_counter()
        found = jax.block_until_ready(batch.fitted(robot, logs, **settings))
        walls.append(time.perf_counter() - begin)
    run = min(walls[1:])
    where = {(n.family, n.joint): k for k, n in enumerate(numbers)}
    theta = np.asarray(found.theta)
    of = lambda family: theta[:, [where[family, j] for j in range(len(machine.joints))]]  # noqa: E731
    device = jax.devices()[0]
    print(f"{device.platform} {device.device_kind}, {dtype.__name__}: {args.robots} logs of {machine.name}, "
          f"{len(machine.joints)} joints, {args.seconds:g} s, {len(numbers)} numbers each")  # fmt: skip
    print(
        f"compile and first run {walls[0]:.1f} s, run {run:.3f} s: {args.robots / run:.1f} robots a second"
    )
    print(f"kp off by (median, 90 %) {np.percentile(abs(of('kp_scale') + 1 - kp), [50, 90]).round(4)}, "
          f"friction [N m] {np.percentile(abs(of('coulomb_friction') - dry), [50, 90]).round(4)}, "
          f"delay [ms] {1e3 * np.median(abs(theta[:, where['target_delay', -1]] - 0.01)):.2f}")  # fmt: skip
    print(
        f"replay error to first order [mrad] {1e3 * np.median(found.before):.2f} -> {1e3 * np.median(found.after):.2f}"
    )


if __name__ == "__main__":
    main()
