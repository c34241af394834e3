"""The bank on walking humanoids in MuJoCo C: hard touchdowns with a pick-up, and a minute without one."""

import json
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.harness.results import commit
from benchmarks.paper import gating, pelvis
from benchmarks.paper.brain import ORACLE, make_brain, measurement_noise
from benchmarks.paper.loop import Run, summary
from benchmarks.paper.plant import PER_TICK, TICK, model
from benchmarks.paper.strides import strolling
from jax_inertia.estimation.online.load_bank import LoadBank, make_load_bank
from jax_inertia.estimation.priors import Load

LINKS = ("torso_link", "left_elbow_pitch_link", "right_elbow_pitch_link")
SENSORS = gating.SENSORS
EVERY = SENSORS.window // PER_TICK  # ticks: windows that follow one another


def bank_of(brain) -> LoadBank:
    """One setting for all walks: sensors' noise and the model error of the gating experiment."""
    home = model().key_qpos[0]
    noise = measurement_noise(brain.robot, home, SENSORS, gating.SETTINGS.model_error)
    return make_load_bank(
        brain.robot,
        LINKS,
        noise=noise,
        sigma_a=jnp.asarray(SENSORS.acceleration()),
        load=Load(8.0, 0.2),
    )


@eqx.filter_jit
def _follow(bank: LoadBank, brain, x):
    def one(state, sample):
        state, seen = bank.step(state, brain.observation(sample), EVERY * TICK)
        return state, seen

    return jax.lax.scan(one, bank.initial(), x)[1]


def followed(found: Run) -> dict[str, np.ndarray]:
    """What the bank made of a run that kept its inputs: one row for every window."""
    brain = make_brain(model(), gating.SETTINGS, SENSORS, strolling)
    bank = bank_of(brain)
    x = jax.tree.map(lambda *rows: np.stack(rows, axis=1), *found.inputs[EVERY::EVERY])
    out = [
        _follow(bank, brain, jax.tree.map(lambda a, j=j: a[j], x)) for j in range(len(found.seed))
    ]
    seen = jax.tree.map(lambda *rows: np.stack([np.asarray(r) for r in rows], axis=1), *out)
    return {**vars(seen), "time": found.time[EVERY::EVERY], "candidates": bank.candidates}


def touchdowns(seeds: np.ndarray) -> dict:
    """The gating experiment: spikes, the load of 10 kg found, and which link it was taken to be on."""
    found = gating.run(seeds, settings=gating.SETTINGS, load=gating.LOAD)
    seen = followed(found)
    mass = np.repeat(seen["pi"][:, :, 0, 0], EVERY, axis=0)
    mass = np.vstack([np.repeat(mass[:1], EVERY, axis=0), mass])[: len(found.time)]
    mass = np.vstack([mass, np.repeat(mass[-1:], len(found.time) - len(mass), axis=0)])
    after = Run(**{**vars(found), "series": {**found.series, "mass": mass}})
    late, early = gating.found_after(after), gating.spikes(after)
    walking = (found.time > 4.0) & (found.time < gating.PICK_UP)
    events = [
        [
            (round(float(t), 3), seen["candidates"][k], round(float(p), 4))
            for t, k, p in zip(
                seen["time"], seen["opened"][:, j], seen["probability"][:, j].max(-1), strict=True
            )
            if k >= 0
        ]
        for j in range(len(seeds))
    ]
    right = sum(
        [e[1] for e in one if gating.PICK_UP <= e[0] <= gating.PICK_UP + 1.0] == [(0,)]
        for one in events
    )
    return {
        "spike_kg": summary(early),
        "bias_kg": summary(mass[walking].mean(axis=0) - gating.NOMINAL),
        "found_after_s": [None if np.isinf(x) else round(float(x), 3) for x in late],
        "right_link": right,
        "false": sum(e[0] < gating.PICK_UP for one in events for e in one),
        "seeds": len(seeds),
        "events": events,
    }


def minute(seeds: np.ndarray) -> dict:
    """60 s of walking forwards without a change: how often a link is opened."""
    found = pelvis.walk(
        seeds, (ORACLE,), amplitude=0.0, mass=lambda t: gating.NOMINAL, settings=gating.SETTINGS,
        sensors=SENSORS, duration=60.0, keep_inputs=True, label="minute",
    )  # fmt: skip
    seen = followed(found)
    return {
        "false_per_min": float((seen["opened"] >= 0).sum() / len(seeds)),
        "seeds": len(seeds),
        "largest_mass_error_kg": float(np.abs(seen["pi"][..., 0, 0] - gating.NOMINAL).max()),
        "fell": int(np.isfinite(found.fell).sum()),
    }


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    which, first, count, out = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
    found_ = {"touchdowns": touchdowns, "minute": minute}[which](first + np.arange(count))
    result = {"commit": commit(), **found_}
    with open(out, "w") as file:
        json.dump(result, file)
    print(result)
