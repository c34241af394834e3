"""What the forearm's mass ripples with in a curl: `diagnose` on its own sensors, and the same curls told of it.

One robot's last three curls are a log. Its model says of the forearm what the estimator has found by then, so that what
is left is what no forearm explains. The effects that `diagnose` names go into the model that the estimator has of the
robot, and it reads the same sensors of the other runs once more. The floor is a plant without any of these effects.
"""

import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from benchmarks.paper import curl
from benchmarks.paper.brain import Brain, Inputs
from benchmarks.paper.curl_log import contract, sensed
from benchmarks.paper.figures import figure, legend, save
from benchmarks.paper.hardware import FOREARM, NOTHING
from benchmarks.paper.loop import Run
from benchmarks.paper.plant import mjcf
from benchmarks.paper.shared_out import Wanted, every
from jax_inertia import load_model
from jax_inertia.diagnosis.effects.identified import Identified, effects_in
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.report.json_report import to_report
from jax_inertia.diagnosis.result import Diagnosis
from jax_inertia.diagnosis.simulate.corrected import corrected
from jax_inertia.dynamics.rigid_body import body_poses, contact_torque
from jax_inertia.logs.log import Log
from jax_inertia.logs.log_files import read_log
from jax_inertia.maths.inertial_parameters import centre_of_mass
from jax_inertia.maths.spatial import cross
from jax_inertia.model.load import set_inertials
from jax_inertia.model.robot import Robot
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.torque_residual import FRICTION_VELOCITY

SEED = 1000
"""Of the log: none of the runs that are scored has its noise."""
MOST = 5
OF_BODIES = ("payload", "com_shift", "link_inertia")
OTHERS = (
    "constant_force",
    "viscous_friction",
    "coulomb_friction",
    "asymmetric_coulomb",
    "load_friction",
    "torque_bias",
    "joint_spring",
    "armature",
    "gravity_tilt",
)


class Informed(Brain):
    """A brain whose estimator knows what a diagnosis found: in its robot's model, or as forces and friction beside."""

    force: Float[Array, "k 3"]
    """Constant, world axes, on each of `pushed` [N]."""
    point: Float[Array, "k 3"]
    """Where it acts, in the body's axes [m]."""
    load: Float[Array, " nv"]
    """Dry friction per newton metre of the motor's torque."""
    pushed: tuple[str, ...] = eqx.field(static=True)

    def observation(self, x: Inputs) -> Observation:
        """The window's means, with the torque that the known effects add to the motors'."""
        own = super().observation(x)
        q, v, tau = (jnp.asarray(y) for y in (own.motion.q, own.motion.v, own.motion.tau))
        index = np.array([self.robot.body_index(name) for name in self.pushed], int)
        rotation, _ = body_poses(self.robot, q)
        arm = jnp.einsum("kij,kj->ki", rotation[index], self.point)
        wrench = jnp.concatenate([self.force, cross(arm, self.force)], axis=-1)
        friction = self.load * jnp.abs(tau) * jnp.tanh(v / FRICTION_VELOCITY)
        known = contact_torque(self.robot, q, wrench, self.pushed) - friction
        return eqx.tree_at(lambda o: o.motion.tau, own, tau + known)


def informed(brain: Brain, effects: Sequence[Identified], pushed: tuple[str, ...]) -> Informed:
    """The brain with these effects known to its estimator; constant forces may be on the bodies `pushed` only.

    Raises ValueError for an effect that it cannot be told of.
    """
    robot, force = brain.estimator.robot, np.zeros((len(pushed), 3))
    index = np.array([robot.body_index(name) for name in pushed], int)
    point, load = np.array(centre_of_mass(robot.pi[index])), np.zeros(robot.nv)
    spec = mujoco.MjSpec.from_string(mjcf())
    beside = corrected(spec, effects).by_callback
    for effect in beside:
        if effect.family == "constant_force":
            at = pushed.index(effect.name)
            force[at] += effect.vector("force")
            if "point_x" in effect.values:
                point[at] = effect.vector("point")
        elif effect.family == "load_friction":
            joint = robot.joint_names.index(effect.name)
            load[robot.joint_dofadr[joint]] += effect.values["load_coefficient"]
        else:
            raise ValueError(f"an estimator cannot be told of {effect.family}")
    mended = load_model(spec.compile())
    estimator = eqx.tree_at(lambda e: e.robot, brain.estimator, mended)
    return Informed(
        brain.robot,
        brain.controller,
        estimator,
        brain.slew,
        brain.refer,
        brain.damping,
        jnp.asarray(force),
        jnp.asarray(point),
        jnp.asarray(load),
        pushed,
    )


def as_log(found: Run, robot: int) -> tuple[Log, Robot]:
    """One robot's last three curls, and the robot as its estimator knows it by then."""
    on = curl.late(found)
    series = {name: found.series[name][on, robot] for name in ("q", "v", "tau", "force")}
    spec = mujoco.MjSpec.from_string(mjcf())
    set_inertials(spec, {FOREARM: found.series["pi"][on, robot].mean(axis=0, dtype=float)})
    model = load_model(spec.compile())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "curl.npz"
        arrays = contract(model, found.time[on], series)
        np.savez(path, **arrays)  # pyright: ignore[reportArgumentType]
        return read_log(path, names=model), model


@eqx.filter_jit
def _masses(brain: Brain, x: Inputs, window: Inputs) -> Float[Array, "robots T"]:
    def one(x: Inputs, window: Inputs):
        seen = jax.vmap(brain.observation)(window)
        state = brain.estimator.calibrate_bias(brain.estimator.initial(), seen)

        def tick(state, x):
            state, _, pi = brain.follow(state, x)
            return state, pi[0, 0]

        return jax.lax.scan(tick, state, x)[1]

    return jax.vmap(one)(x, window)


def relearned(brain: Brain, found: Run) -> Run:
    """The same run as another estimator reads its sensors, calibrated at start-up like the first."""
    x = jax.tree.map(lambda *parts: np.stack(parts, axis=1), *found.inputs)
    begin, end = curl.CALIBRATE
    still = (found.time >= begin) & (found.time < end)
    mass = _masses(brain, x, jax.tree.map(lambda part: part[:, still], x))
    return dataclasses.replace(found, series={**found.series, "mass": np.asarray(mass).T})


def knowable(effects: Sequence[Identified]) -> tuple[list[Identified], list[Identified]]:
    """Effects that the estimator can be told of, and the others; what changes the forearm is its own to find."""
    told = [
        e for e in effects if e.family in OTHERS or (e.family in OF_BODIES and e.name != FOREARM)
    ]
    return told, [e for e in effects if e not in told]


def results(seeds: np.ndarray) -> dict:
    """What was found, and the estimate's error and ripple without it, with it, and without anything to find."""
    all_seeds = np.append(seeds, SEED)
    scored = np.arange(len(all_seeds)) < len(seeds)
    whole = {"watch_also": sensed, "keep_inputs": True, "label": "curls"}
    ran, bare = every(
        [
            Wanted(curl.run, all_seeds, (1,), whole),
            Wanted(curl.run, all_seeds, (1,), {"effects": NOTHING, "label": "floor"}),
        ]
    )
    log, robot = as_log(ran, len(seeds))
    found = diagnose(robot, log, max_effects=MOST)
    told, untold = knowable(effects_in(to_report(found)))
    pushed = tuple(dict.fromkeys(e.name for e in told if e.family == "constant_force"))
    brain = curl.mind()

    def again(known: Sequence[Identified]) -> Run:
        return relearned(informed(brain, known, pushed), ran)

    runs = {
        "as it was": ran,
        "told of what was found": again(told),
        "nothing to find (floor)": bare,
    }
    alone = {f"told of {e.family} at {e.name} alone": again([e]) for e in told}
    rows, parts = (
        [{"variant": name, **curl.figures_of(r, scored)} for name, r in some.items()]
        for some in (runs, alone)
    )
    _draw(runs, scored)
    return {
        "diagnosis": _told(found),
        "left_out": [str(e) for e in untold],
        "rows": rows,
        "parts": parts,
        "share": {of: share(rows, of) for of in ("ripple_percent", "in_step_percent")},
        "unphysical": int(ran.unphysical.sum() + bare.unphysical.sum()),
    }


def share(rows: list[dict], of: str) -> dict[str, float]:
    """Share of what is over the floor, and of all, that is gone with the effects known; from medians."""
    before, after, floor = (row[of]["median"] for row in rows)
    return {"of_all": 1.0 - after / before, "over_floor": (before - after) / (before - floor)}


def _told(found: Diagnosis) -> dict:
    held = found.heldout
    return {
        "verdict": str(found.verdict),
        "heldout": {"before": held.before, "after": held.after, "noise": held.noise},
        "effects": [
            {
                "family": f.family,
                "place": f.place.name,
                "sizes": [f.sizes],
                "explained": f.share,
                "ties": [f"{t.family} at {t.place.name}" for t in f.equivalent],
            }
            for f in found.found
        ],
    }


def _draw(runs: dict[str, Run], scored: np.ndarray) -> None:
    fig, axes = figure(2, height=5.0)
    for k, (name, found) in enumerate(runs.items()):
        on = curl.late(found)
        error = 100.0 * (found.series["mass"] / found.series["true"] - 1.0)[on][:, scored].astype(
            float
        )
        edge = curl.SMOOTH // 2
        time = found.time[on][edge:-edge]
        for axis, x in zip(axes, (error[:, 0], error.mean(axis=1)), strict=True):
            axis.plot(time, curl.smoothed(x), lw=1, color=("C1", "C0", "0.5")[k], label=name)
    axes[0].set_ylabel("error of the mass, one run [%]")
    axes[1].set_ylabel(f"mean of {scored.sum()} runs [%]")
    for axis in axes:
        axis.axhline(0.0, color="k", lw=0.6)
    axes[1].set_xlabel("time [s]")
    legend(axes[0])
    save(fig, "paper_curl_causes")
