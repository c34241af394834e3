"""Whether a log and its model mean the same by a joint: sign, order of columns, unit of angles.

Where they do not, some of the model's torque is as large as what is missing, and no effect is the cause. So a log is
refused where reading it otherwise leaves next to nothing of that: no robot's torque happens to be minus what it needs.
"""

import dataclasses
from collections.abc import Iterator

import equinox as eqx
import jax
import numpy as np
import scipy.optimize
from jaxtyping import Float

from jax_inertia.model.robot import HINGE, SLIDE
from jax_inertia.signals.torque_residual import Prepared, needed_torques, without_friction

Shares = Float[np.ndarray, " n"]

# As it stands a joint misses more than this share of the torques' energy, read otherwise less than that.
MISSED, FITS = 0.15, 0.05
# Read otherwise, what all joints miss is less than this share of what it was.
LEAVES = 0.2
# What moves by less than this share of the torque of the joint with most is not judged.
SLIGHT = 1e-3


def require_conventions(prepared: Prepared) -> None:
    """ValueError, one line, where a joint's sign, the torques' order or the unit of angles is another in the log."""
    log = _Read.of(prepared)
    for message in (*log.torques(), *log.motion()):
        raise ValueError(message)


@dataclasses.dataclass(frozen=True)
class _Read:
    """A log's torques beside those that its motion needs, joint by joint."""

    prepared: Prepared
    names: tuple[str, ...]
    rows: np.ndarray
    places: np.ndarray
    """Of the joints' positions in q."""
    tau: Float[np.ndarray, "T n"]
    needed: Float[np.ndarray, "T n"]

    @classmethod
    def of(cls, prepared: Prepared) -> "_Read":
        """Hinges and slides that carry some of the torque."""
        r = prepared.robot
        every = zip(r.joint_names, r.joint_type, r.joint_dofadr, r.joint_qposadr, strict=True)
        joints = [(name, int(d), int(p)) for name, kind, d, p in every if kind in (HINGE, SLIDE)]
        rows = np.array([d for _, d, _ in joints], int)
        tau, needed = (
            prepared.finish(x)[:, rows] for x in (prepared.tau, prepared.inverse - prepared.dry)
        )
        size = np.maximum(_energy(tau), _energy(needed))
        heard = size > SLIGHT**2 * size.max(initial=0.0)
        some = [j for j, h in zip(joints, heard, strict=True) if h]
        places = np.array([p for _, _, p in some], int)
        names = tuple(name for name, _, _ in some)
        return cls(prepared, names, rows[heard], places, tau[:, heard], needed[:, heard])

    def torques(self) -> Iterator[str]:
        """What is wrong with torques for a motion that is as the model has it."""
        missed = _missed(self.tau, self.needed)
        turned = (missed > MISSED) & (_missed(-self.tau, self.needed) < FITS)
        if turned.any():
            every = bool(np.all(missed > 1.0))
            which = "every joint" if every else " and ".join(self._called(turned))
            yield (
                f"tau of {which} is minus what the model needs: its sign is turned, or it is the load's torque and not "
                "the motor's; turn the sign of tau"
            )
        cost = np.stack([_missed(self.tau[:, [j]], self.needed) for j in range(len(self.names))])
        _, order = scipy.optimize.linear_sum_assignment(cost)
        moved = order != np.arange(len(order))
        fits = cost[np.arange(len(order)), order] < FITS
        swapped = moved & fits & (missed > MISSED)
        if swapped.sum() > 1:
            pairs = [
                f"tau of {self.names[j]!r} is what {self.names[order[j]]!r} needs"
                for j in np.flatnonzero(swapped)
            ]
            yield f"{'; '.join(pairs)}: columns go in the order of joint_names"

    def motion(self) -> Iterator[str]:
        """What is wrong with the motion, by whether all torques fit another."""
        before = float(np.mean(_missed(self.tau, self.needed))) if self.names else 0.0
        if before < MISSED / max(len(self.names), 1):
            return
        angles = self._angles()
        if angles.any() and self._left(np.where(angles, np.pi / 180.0, 1.0), 1.0) < LEAVES * before:
            yield "torques fit the motion if qpos is in degrees; expected rad"
        for j, name in enumerate(self.names):
            turned = np.where(np.arange(len(self.names)) == j, -1.0, 1.0)
            if self._left(turned, turned) < LEAVES * before:
                yield (
                    f"torques fit the motion if {name!r} runs the other way: its axis is turned in the model, or qpos "
                    "and tau in the log; turn the sign of both"
                )

    def _angles(self) -> np.ndarray:
        kinds = dict(
            zip(self.prepared.robot.joint_names, self.prepared.robot.joint_type, strict=True)
        )
        return np.array([kinds[name] == HINGE for name in self.names])

    def _left(self, moved: Shares, pushed: Shares | float) -> float:
        """What joints miss if their motion, and their torque, is so many times what the log has."""
        o, robot = self.prepared.observation, without_friction(self.prepared.robot)
        q, v, a = (np.array(x) for x in (o.motion.q, o.motion.v, o.a))
        q[:, self.places] *= moved
        v[:, self.rows] *= moved
        a[:, self.rows] *= moved
        other = eqx.tree_at(lambda x: (x.motion.q, x.motion.v, x.a), o, (q, v, a))
        needed = self.prepared.finish(np.asarray(jax.device_get(needed_torques(robot, other))))
        return float(np.mean(_missed(self.tau * pushed, needed[:, self.rows])))

    def _called(self, some: np.ndarray) -> list[str]:
        return [repr(name) for name, one in zip(self.names, some, strict=True) if one]


def _energy(x: Float[np.ndarray, "T n"]) -> Shares:
    return np.mean(x**2, axis=0)


def _missed(tau: Float[np.ndarray, "T *n"], needed: Float[np.ndarray, "T n"]) -> Shares:
    """Energy of what is missing over that of both torques: zero where they agree, two where one is minus the other."""
    return _energy(tau - needed) / np.maximum(_energy(tau) + _energy(needed), 1e-300)
