"""Table II's elbow with the exact filter: accelerations over one tick instead of three, and their noise told.

Short windows make an extended filter deaf: it takes the noise of neighbouring differences for independent. The exact
filter knows that they cancel, and so needs no window; what is left of the lag is a tick.
"""

import dataclasses
import json
import sys
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.paper import brain as paper_brain
from benchmarks.paper import elbow
from benchmarks.paper.brain import Brain, measurement_noise
from benchmarks.paper.loop import rms, summary
from benchmarks.paper.plant import PER_TICK, TICK, Sensors
from jax_inertia.estimation.exact_memory import ExactState, make_exact_estimator
from jax_inertia.estimation.priors import Load

SENSORS = Sensors(window=PER_TICK)
DRIFT = float(sys.argv[4]) if len(sys.argv) > 4 else 30.0


class _Seen(eqx.Module):
    """What a brain reads of a step."""

    nis: Any
    accepted: Any


class _Step(eqx.Module):
    innovation: _Seen


class ExactBrain(Brain):
    """The brain with the exact filter in the place of the extended one."""

    def follow(self, state: ExactState, x):
        running, step = self.estimator.step(state, self.observation(x), TICK)
        running = jax.tree.map(lambda a, b: jnp.where(x.on > 0, a, b), running, state)
        pi = self.estimator.chart.to_pi(running.belief.mean.reshape(-1, 10))
        return running, _Step(_Seen(step.nis, step.weight > 0.5)), pi


def make_brain(model, settings, sensors, refer, **options) -> Brain:
    """`brain.make_brain`, with the exact filter."""
    made = paper_brain.make_brain(model, settings, sensors, refer, **options)
    noise = measurement_noise(made.robot, model.key_qpos[0], sensors, settings.model_error)
    # Base rows have no torque of their own, and no noise but the ground's: a floor keeps R regular.
    estimator = make_exact_estimator(
        made.robot,
        settings.bodies,
        noise=noise.plus(1e-2 * jnp.eye(made.robot.nv)),
        sigma_v=jnp.asarray(sensors.velocity()),
        prior=Load(4.0, 0.15),
        drift=Load(DRIFT, 0.3),
    )
    fields = {f.name: getattr(made, f.name) for f in dataclasses.fields(made)}
    return ExactBrain(**{**fields, "estimator": estimator})


def main() -> None:
    """python -m benchmarks.online.quick_elbow FIRST SEEDS OUT"""
    jax.config.update("jax_enable_x64", True)
    seeds = int(sys.argv[1]) + np.arange(int(sys.argv[2]))
    elbow.make_brain = make_brain
    found = elbow.run(seeds, (1,), sensors=SENSORS)
    on = found.time >= elbow.SETTLE
    out = {
        "rmse_rad": summary(rms(found.series["error"][on])),
        "lag_s": summary(elbow.lag(found, 0)),
        "mass_rmse_kg": summary(rms((found.series["mass"] - found.series["true"])[on])),
        "unphysical": int(found.unphysical.sum()),
        "fell": int(np.isfinite(found.fell).sum()),
    }
    with open(sys.argv[3], "w") as file:
        json.dump(out, file)
    print(out)


if __name__ == "__main__":
    main()
