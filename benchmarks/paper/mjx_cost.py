"""What a fleet costs on one accelerator: `python -m benchmarks.paper.mjx_cost [ROBOTS ...]`; prints one JSON line each.

The humanoid walks in place under the whole controller, estimator included; plant in MJX, two steps of 1.5 ms a tick,
all in float32.
"""

import json
import sys
import time

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from benchmarks.paper.brain import make_brain, spread
from benchmarks.paper.mjx_loop import at_home, make_loop
from benchmarks.paper.pelvis import SETTINGS
from benchmarks.paper.plant import Sensors
from benchmarks.paper.strides import begin_at_home, flat, strolling, walk_figures
from jax_inertia.robots import HumanoidOptions, humanoid_mjcf

PER_TICK = 2  # steps of 1.5 ms


def main(robots: list[int]) -> None:
    """Time each fleet over one simulated second."""
    options = HumanoidOptions(corner_forces=True, visual=False)
    model = mujoco.MjModel.from_xml_string(humanoid_mjcf(options))
    brain = make_brain(model, SETTINGS, Sensors(), strolling)
    loop = make_loop(model, brain, PER_TICK)
    plan = begin_at_home(walk_figures(model, flat(), step=0.0, start=0.2), model)
    memory, data = brain.start(plan), at_home(model, loop)
    truth = brain.robot.pi[np.array(brain.estimator.bodies)]
    ticks = round(1.0 / (PER_TICK * model.opt.timestep))
    run = jax.jit(jax.vmap(lambda m, d: loop.run(m, d, truth, ticks)))
    for count in robots:
        fleet = spread((memory, data), count)
        started = time.monotonic()
        compiled = run.lower(*fleet).compile()
        compile_s = time.monotonic() - started
        _, _, path = jax.block_until_ready(compiled(*fleet))
        started = time.monotonic()
        jax.block_until_ready(compiled(*fleet))
        wall = time.monotonic() - started
        upright = float(jnp.mean(path[:, -1, 2] > 0.9))
        line = {
            "device": jax.devices()[0].device_kind,
            "robots": count,
            "compile_s": round(compile_s, 1),
            "wall_s_per_simulated_s": round(wall, 3),
            "robot_ticks_per_s": round(count * ticks / wall),
            "upright": upright,
        }
        print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main([int(x) for x in sys.argv[1:]] or [2048])
