"""Table II, elbow: holding the home pose while the forearm's mass follows Table I's waveform."""

import jax.numpy as jnp
import numpy as np

from benchmarks.paper.brain import (
    MODES,
    Settings,
    batched,
    inputs,
    make_brain,
    spread,
    standing,
    still,
)
from benchmarks.paper.plant import TICK, Fleet, LinkMass, Sensors, model
from jax_inertia.control.whole_body import Gains
from jax_inertia.mjcf import body_pi
from jax_inertia.priors import Load, Tolerance

FOREARM, JOINT = "left_elbow_pitch_link", "left_elbow_y"
SETTLE, DURATION = 1.0, 17.0  # s: one second of the bare arm, then the waveform
SETTINGS = Settings(
    bodies=(FOREARM,),
    prior=Load(4.0, 0.15),
    drift=Tolerance(mass=8.0, com=0.02, spread=0.1),
    iterations=2,
)


def waveform(t: float) -> float:
    """Table I: 4.5 kg, 3 kg amplitude, 1 Hz, sine and from 8 s on square [kg]."""
    wave = np.sin(2 * np.pi * t)
    return 4.5 + 3.0 * (wave if t < 8.0 else np.sign(wave) + (wave == 0))


def run(seeds, modes=(0, 1, 2), *, settings=SETTINGS, sensors=None, gains=Gains(), duration=DURATION):
    """RMSE of each mode and seed, and traces of the first seed."""
    sensors = sensors or Sensors()
    plant = model()
    home = plant.key_qpos[0].copy()
    brain = make_brain(plant, settings, sensors, None, gains=gains)
    com = np.asarray(brain.controller.terms(brain.robot, jnp.asarray(home), jnp.zeros(29)).com)
    import equinox as eqx
    brain = eqx.tree_at(lambda b: b.refer, brain, standing(home, com, still(home)), is_leaf=lambda x: x is None)
    mode = np.repeat(modes, len(seeds))
    fleet = Fleet(plant, np.tile(seeds, len(modes)), sensors)
    tick = batched(brain)
    memory = spread(brain.start(jnp.zeros(())), fleet.size)
    link = LinkMass(plant, FOREARM)
    joint = plant.joint(JOINT).qposadr[0]
    body = plant.body(FOREARM).id
    rows = []
    for k in range(int(duration / TICK)):
        t = k * TICK - SETTLE
        if t >= 0:
            link.set(waveform(t))
        truth = body_pi(plant, body)[None]
        memory, out = tick(memory, inputs(fleet.sense(), mode, truth))
        fleet.step(np.asarray(out.torque))
        rows.append((t, link.mass, fleet.q[:, joint] - home[joint], np.asarray(out.pi[:, 0, 0]), np.asarray(out.converged), np.asarray(out.physical[:,0]), fleet.q[:,2].copy()))
    return mode, rows
