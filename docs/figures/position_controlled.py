"""Draw targets, robot, nominal and corrected model: `python docs/figures/position_controlled.py`."""

import runpy
from pathlib import Path

from jax_inertia.replay.output.figures import replays
from jax_inertia.replay.pipeline import diagnose

ROOT = Path(__file__).parents[2]


def main() -> None:
    made = runpy.run_path(str(ROOT / "tests" / "test_replay.py"))
    logs = [made["without_torque"](made["run"](delay=0.02, kp=(1.0, 0.7), seed=k)) for k in (0, 1)]
    found = diagnose([logs[0]], made["arm"], test_log=logs[1])
    replays(found.names, found.replayed).savefig(
        Path(__file__).with_suffix(".svg"), metadata={"Date": None}
    )


if __name__ == "__main__":
    main()
