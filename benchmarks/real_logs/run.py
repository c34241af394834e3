"""Real logs: what the estimator says of a UR10e, a Panda and an LWR4+. Writes RESULTS.md and figures beside itself.

    python -m benchmarks.real_logs.run

The logs are looked for in ../shared/data beside the repository, or in $JAX_INERTIA_DATA.
"""

import time
from collections.abc import Callable
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

from benchmarks.real_logs import arms, figures, report, ur10e  # noqa: E402
from benchmarks.real_logs.logs import SHARED  # noqa: E402

HERE = Path(__file__).parent


def main() -> None:
    """Run every part and write what came out."""
    if not SHARED.is_dir():
        raise SystemExit(f"{SHARED}: no such folder; set JAX_INERTIA_DATA to that of the logs")
    wall: dict[str, float] = {}

    def timed(name: str, part: Callable):
        start = time.perf_counter()
        out = part()
        wall[name] = time.perf_counter() - start
        print(f"{name}: {wall[name]:.0f} s", flush=True)
        return out

    weighings = timed("UR10e, pair, batch", ur10e.weighings)
    held_out = timed("UR10e, held-out free runs", ur10e.held_out)
    online = timed("UR10e, pair, online", ur10e.online)
    by_joint = timed("UR10e, joint by joint", ur10e.by_joint)
    by_setting = timed("UR10e, other preparations", ur10e.by_setting)
    race = timed("UR10e, charts", ur10e.chart_race)
    results = [timed(arm.name, lambda arm=arm: arms.evaluate(arm)) for arm in arms.ARMS]

    better = online[-1].variant
    last = [o for o in online if o.calibration == online[-1].calibration]
    figures.weighings(HERE / "ur10e_load.png", weighings, online, better)
    figures.online(HERE / "ur10e_online.png", last)
    text = report.render(
        weighings, held_out, online, by_joint, by_setting, race, results, wall, report.machine()
    )
    (HERE / "RESULTS.md").write_text(text)


if __name__ == "__main__":
    np.set_printoptions(precision=3, suppress=True)
    main()
