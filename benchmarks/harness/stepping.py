"""Humanoids that step in place in MJX, every one with its own load, ground and gait.

A harness holds the pelvis: springs and dampers, whose wrench a load cell tells the filter. The joints follow angles by
PD; the feet lift one after the other and land, softly or hard. At `CHANGE` the torso's load jumps. What is logged is
what a robot has: means over a tick of 9 ms, velocities differenced over it, and contact forces *sampled* at its end, so
that a touchdown gives forces that the motion does not explain.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from mujoco import mjx

from jax_inertia.robots import CORNERS, HumanoidOptions, humanoid_mjcf

DURATION, CHANGE = 8.0, 5.0  # s
STEPS = 6  # MJX steps of 1.5 ms to a tick
TORSO, PELVIS = "torso_link", "pelvis_link"
HARNESS = np.array([[4000.0, 4000.0, 3000.0], [400.0, 400.0, 400.0]])  # N/m, N s/m
UPRIGHT = (2500.0, 120.0)  # N m/rad, N m s/rad
RADIUS = 0.1  # m, of the load, a ball at the torso's own centre of mass


class Draw(eqx.Module):
    """What differs from robot to robot."""

    load: Float[Array, "*n 2"]
    """On the torso before and after the change [kg]."""
    solref: Float[Array, "*n"]
    """Time constant of the contacts [s]: short is hard."""
    period: Float[Array, "*n"]
    """Of a pair of steps [s]."""
    lift: Float[Array, "*n"]
    """Knee angle at the top of a step [rad]."""
    phase: Float[Array, "*n"]
    noise: Float[Array, "*n"]
    """All sensors' noise in parts of the nominal."""


class Record(eqx.Module):
    """A tick as logged, without noise."""

    q: Float[Array, "*n nq"]
    v: Float[Array, "*n nv"]
    """Mean over the tick."""
    v_end: Float[Array, "*n nv"]
    tau: Float[Array, "*n nu"]
    force: Float[Array, "*n 8 3"]
    """Of the ground on each corner at the tick's end, world axes [N]."""
    harness: Float[Array, "*n 6"]
    """[force; moment] on the pelvis, world axes, moment about its frame origin, mean over the tick."""


def draw(rollouts: int, seed: int) -> Draw:
    """So many robots, each from its own seed: more rollouts leave the first ones as they were."""
    rows = []
    for k in range(rollouts):
        rng = np.random.default_rng([seed, k])
        before = rng.uniform(0.0, 8.0)
        up = before + rng.uniform(3.0, 12.0)
        rows.append(
            [
                (before, up) if rng.uniform() < 0.5 else (up, before),
                np.exp(rng.uniform(np.log(0.003), np.log(0.015))),
                rng.uniform(0.7, 1.2),
                rng.uniform(0.3, 0.9),
                rng.uniform(0.0, 2 * np.pi),
                np.exp(rng.uniform(np.log(0.5), np.log(2.0))),
            ]
        )
    return Draw(*(jnp.asarray(np.array(x), jnp.float32) for x in zip(*rows, strict=True)))


def robot_model() -> mujoco.MjModel:
    """The humanoid with corner force sensors."""
    return mujoco.MjModel.from_xml_string(
        humanoid_mjcf(HumanoidOptions(corner_forces=True, visual=False))
    )


class Plant(eqx.Module):
    """What all robots share."""

    model: mjx.Model
    home: Float[Array, "nq"]
    stiffness: Float[Array, "nu"]
    damping: Float[Array, "nu"]
    limit: Float[Array, "nu"]
    swing: Float[Array, "2 nu"]
    """Joint angles of each leg's lift, for a knee angle of 1 rad."""
    sway: Float[Array, "nu"]
    torso: int = eqx.field(static=True)
    pelvis: int = eqx.field(static=True)
    force_at: tuple[int, ...] = eqx.field(static=True)

    def tick(self, data: mjx.Data, who: Draw, time: Float[Array, ""]) -> tuple[mjx.Data, Record]:
        """Six steps."""
        load = jnp.where(time < CHANGE, who.load[0], who.load[1])
        model = self.model.replace(
            body_mass=self.model.body_mass.at[self.torso].add(load),
            body_inertia=self.model.body_inertia.at[self.torso].add(0.4 * load * RADIUS**2),
            pair_solref=self.model.pair_solref.at[:, 0].set(who.solref),
        )

        def step(k, carry):
            data, q, v, tau, harness = carry
            torque = self._torque(data, who, time + k * model.opt.timestep)
            wrench = self._harness(data)
            pushed = data.xfrc_applied.at[self.pelvis].set(wrench)
            after = mjx.step(model, data.replace(ctrl=torque, xfrc_applied=pushed))
            # MuJoCo's is about the centre of mass; a log's about the frame's origin.
            arm = data.xipos[self.pelvis] - data.xpos[self.pelvis]
            about = jnp.concatenate([wrench[:3], wrench[3:] + jnp.cross(arm, wrench[:3])])
            share = 1.0 / STEPS
            return (
                after,
                q + 0.5 * share * (data.qpos + after.qpos),
                v + 0.5 * share * (data.qvel + after.qvel),
                tau + share * torque,
                harness + share * about,
            )

        zero = jnp.zeros(len(self.limit))
        start = (data, 0.0 * data.qpos, 0.0 * data.qvel, zero, jnp.zeros(6))
        data, q, v, tau, harness = jax.lax.fori_loop(0, STEPS, step, start)
        q = q.at[3:7].divide(jnp.linalg.norm(q[3:7]))
        contact = data.sensordata[np.array(self.force_at)[:, None] + np.arange(3)]
        # The sensor gives the contact's axes: z, y, −x of the world.
        force = jnp.stack([-contact[:, 2], contact[:, 1], contact[:, 0]], axis=-1)
        return data, Record(q, v, data.qvel, tau, force, harness)

    def _torque(self, data: mjx.Data, who: Draw, time: Float[Array, ""]) -> Float[Array, "nu"]:
        angle = 2.0 * jnp.pi * time / who.period + who.phase
        begun = jnp.clip(time - 0.3, 0.0, 1.0)
        up = jnp.maximum(jnp.stack([jnp.sin(angle), -jnp.sin(angle)]), 0.0)
        want = self.home[7:] + begun * (
            who.lift * up @ self.swing + self.sway * jnp.sin(0.37 * angle + who.phase)
        )
        torque = self.stiffness * (want - data.qpos[7:]) - self.damping * data.qvel[6:]
        return jnp.clip(torque, -self.limit, self.limit)

    def _harness(self, data: mjx.Data) -> Float[Array, "6"]:
        force = HARNESS[0] * (self.home[:3] - data.qpos[:3]) - HARNESS[1] * data.qvel[:3]
        rotation = data.xmat[self.pelvis].reshape(3, 3)
        turned = 2.0 * jnp.sign(data.qpos[3]) * data.qpos[4:7]
        moment = rotation @ (-UPRIGHT[0] * turned - UPRIGHT[1] * data.qvel[3:6])
        return jnp.concatenate([force, moment])


def plant(model: mujoco.MjModel) -> Plant:
    """PD gains by class of joint, lifts and sways by name."""
    names = [model.joint(i).name for i in range(1, model.njnt)]
    arm = np.array([("shoulder" in n) or ("elbow" in n) for n in names])
    swing, sway = np.zeros((2, len(names))), np.zeros(len(names))
    for side, start in enumerate(("left", "right")):
        for joint, share in (("hip_y", -0.5), ("knee_y", 1.0), ("ankle_y", -0.5)):
            swing[side, names.index(f"{start}_{joint}")] = share
    for i, n in enumerate(names):
        sway[i] = 0.08 if n.startswith("spine") else 0.2 if "shoulder" in n else 0.0
    at = tuple(int(model.sensor(f"{c.name}_force").adr[0]) for c in CORNERS)
    return Plant(
        model=mjx.put_model(model),
        home=jnp.asarray(model.key_qpos[0]),
        stiffness=jnp.asarray(np.where(arm, 150.0, 1200.0)),
        damping=jnp.asarray(np.where(arm, 5.0, 35.0)),
        limit=jnp.asarray(model.actuator_ctrlrange[:, 1]),
        swing=jnp.asarray(swing),
        sway=jnp.asarray(sway),
        torso=model.body(TORSO).id,
        pelvis=model.body(PELVIS).id,
        force_at=at,
    )


def home_data(model: mujoco.MjModel, one: Plant) -> mjx.Data:
    """The home pose."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    return mjx.forward(one.model, mjx.put_data(model, data))


def roll(one: Plant, data: mjx.Data, who: Draw, ticks: int, tick_s: float) -> Record:
    """The log of one robot."""

    def step(data, k):
        return one.tick(data, who, k * tick_s)

    return jax.lax.scan(step, data, jnp.arange(ticks, dtype=jnp.float32))[1]
