"""What a robot's joints can do: ranges, speeds, torques, and postures without collision."""

from collections.abc import Callable

import equinox as eqx
import mujoco
import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.model.mujoco_types import MjModel
from jax_inertia.model.robot import Robot

_TOLERANCE = 1e-9


class Limits(eqx.Module):
    """Limits of every hinge and slide joint, in the model's order; infinite torque: none."""

    low: Float[np.ndarray, " n"]
    high: Float[np.ndarray, " n"]
    velocity: Float[np.ndarray, " n"]
    torque: Float[np.ndarray, " n"]

    @classmethod
    def of(
        cls,
        model: MjModel,
        *,
        velocity: Float[np.ndarray, " n"] | float = 1.5,
        swing: float = 1.0,
        share: float = 0.9,
    ) -> "Limits":
        """The model's own joint ranges and motor limits, each used up to `share`.

        MJCF has no limits of velocity [rad/s]: give the robot's. Joints without a range swing by `swing` [rad] about
        the model's reference posture; joints without a motor that is limited have no limit of torque.
        """
        limited = model.jnt_limited.astype(bool)
        middle = np.where(limited, model.jnt_range.mean(axis=1), model.qpos0[model.jnt_qposadr])
        half = np.where(limited, 0.5 * share * np.ptp(model.jnt_range, axis=1), swing)
        torque = share * _torques(model)
        speed = np.broadcast_to(np.asarray(velocity, float), (model.njnt,)).copy()
        return cls(middle - half, middle + half, speed, torque)

    def fitting(self, robot: Robot) -> "Limits":
        """The same, once it is sure that it fits the robot; ValueError otherwise."""
        for name in ("low", "high", "velocity", "torque"):
            value = np.asarray(getattr(self, name))
            if value.shape != (robot.nv,) or np.any(np.isnan(value)):
                raise ValueError(f"limits.{name} is {value}; expected {robot.nv} numbers")
        for what, bad in (
            ("a range that is empty or infinite", ~(np.isfinite(self.high - self.low))),
            ("a range that is empty or infinite", self.high <= self.low),
            ("no positive, finite velocity", ~((self.velocity > 0) & np.isfinite(self.velocity))),
            ("no positive torque", self.torque <= 0),
        ):
            if np.any(bad):
                name = robot.joint_names[int(np.flatnonzero(bad)[0])]
                raise ValueError(f"joint {name!r} has {what}; give limits that leave room to move")
        return self

    def broken(
        self,
        q: Float[np.ndarray, "T n"],
        v: Float[np.ndarray, "T n"],
        torque: Float[np.ndarray, "T n"],
        names: tuple[str, ...],
    ) -> str:
        """A few words on which joint leaves what furthest; empty where the motion stays inside at every sample."""
        beyond = {
            "range": np.maximum(self.low - q, q - self.high),
            "velocity": np.abs(v) - self.velocity,
            "torque": np.abs(torque) - self.torque,
        }
        for what, excess in beyond.items():
            worst = excess.max(axis=0)
            if worst.max() > _TOLERANCE:
                return f"{names[int(worst.argmax())]} leaves its {what}"
        return ""


def _torques(model: MjModel) -> Float[np.ndarray, " n"]:
    """Most torque of each joint: its own limit, or what its motors give; infinite where nothing limits it."""
    out = np.full(model.njnt, np.inf)
    given = np.zeros(model.njnt)
    for u in range(model.nu):
        if model.actuator_trntype[u] != mujoco.mjtTrn.mjTRN_JOINT:
            continue
        j, gear = model.actuator_trnid[u, 0], abs(model.actuator_gear[u, 0])
        force = np.inf
        if model.actuator_forcelimited[u]:
            force = np.abs(model.actuator_forcerange[u]).min()
        motor = model.actuator_gaintype[u] == mujoco.mjtGain.mjGAIN_FIXED
        motor &= model.actuator_biastype[u] == mujoco.mjtBias.mjBIAS_NONE
        if motor and model.actuator_ctrllimited[u]:
            drive = np.abs(model.actuator_ctrlrange[u]).min() * model.actuator_gainprm[u, 0]
            force = min(force, abs(drive))
        given[j] += gear * force
    out = np.where(given > 0, given, out)
    limited = model.jnt_actfrclimited.astype(bool)
    return np.where(limited, np.minimum(out, np.abs(model.jnt_actfrcrange).min(axis=1)), out)


def collision_free(
    model: MjModel,
) -> Callable[[Float[np.ndarray, "T n"]], Bool[np.ndarray, " T"]]:
    """A test of postures for MuJoCo's contacts, those of the reference posture apart."""
    data = mujoco.MjData(model)

    def touching(q: np.ndarray) -> set[tuple[int, int]]:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        return {(int(a), int(b)) for a, b in data.contact.geom[: data.ncon]}

    usual = touching(model.qpos0)

    def clear(q: Float[np.ndarray, "T n"]) -> Bool[np.ndarray, " T"]:
        return np.array([touching(one) <= usual for one in q])

    return clear
