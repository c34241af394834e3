"""A baseline: least squares over MuJoCo replays of the targets, a fixed set of numbers for every joint.

As PACE has them: armature, viscous and dry friction, encoder offset of each joint and one delay of the targets; kp too.
No intervals, no choice of what is there, one start. Shares no code with the package.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco import rollout
from scipy.optimize import least_squares

STEP = 2e-3
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
Run = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Stamps from 0 s, positions (T, n), targets (T, n)."""


class PaceLike:
    """Numbers of every joint of a model with one position actuator at each, fitted to runs."""

    def __init__(
        self,
        spec,
        joints: Sequence[str],
        kp: np.ndarray,
        kd: np.ndarray,
        *,
        start_kp: float = 1.0,
        limit: np.ndarray | None = None,
    ):
        for a in list(spec.actuators):
            spec.delete(a)
        for name, p, d in zip(joints, kp, kd, strict=True):
            a = spec.add_actuator(name=f"{name}_servo", target=name)
            a.trntype = mujoco.mjtTrn.mjTRN_JOINT
            a.set_to_position(kp=float(p), kv=float(d))
            top = np.inf if limit is None else float(limit[len(spec.actuators) - 1])
            if np.isfinite(top):
                a.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
                a.forcerange = np.array([-top, top])
        self.model = m = spec.compile()
        m.opt.timestep, m.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        ids = [m.joint(x).id for x in joints]
        self.q, self.v, self.kp = m.jnt_qposadr[ids], m.jnt_dofadr[ids], np.asarray(kp, float)
        self.data, n = mujoco.MjData(m), len(ids)
        full = np.zeros((m.nv, m.nv))
        mujoco.mj_forward(m, self.data)
        mujoco.mj_fullM(m, self.data, full)
        inertia, damp = np.diagonal(full)[self.v], np.asarray(kd, float)
        own = m.dof_armature[self.v], m.dof_damping[self.v], m.dof_frictionloss[self.v]
        self.nominal = np.concatenate([*own, np.zeros(2 * n + 1)])
        torque = 0.3 * np.maximum(inertia * 20.0, 0.02 * self.kp)
        self.low = np.concatenate(
            [np.full(n, 1e-5), np.zeros(2 * n), np.full(n, -0.15), np.full(n, -5.0), [0.0]]
        )
        self.high = np.concatenate(
            [20 * inertia + own[0] * 20, 5 * damp + own[1] * 20 + 0.5, 20 * torque + own[2] * 20, np.full(n, 0.15),
             np.full(n, 1.0), [0.2]]
        )  # fmt: skip
        self.scale = np.concatenate(
            [0.5 * inertia, 0.5 * damp + 1e-3, torque, np.full(n, 0.02), np.full(n, 0.3), [0.02]]
        )
        self.start = self.nominal.copy()
        self.start[4 * n : 5 * n], self.start[-1], self.n = np.log(start_kp), 0.01, n

    def replay(self, numbers: np.ndarray, run: Run, ratio: float | np.ndarray = 1.0) -> np.ndarray:
        """Positions (T, n) at the run's stamps; `ratio`: of the run's kp to the one that was said."""
        m, d, n = self.model, self.data, self.n
        t, q, target = run
        m.dof_armature[self.v], m.dof_damping[self.v] = numbers[:n], numbers[n : 2 * n]
        m.dof_frictionloss[self.v] = numbers[2 * n : 3 * n]
        offset, kp = numbers[3 * n : 4 * n], ratio * self.kp * np.exp(numbers[4 * n : 5 * n])
        m.actuator_gainprm[:, 0], m.actuator_biasprm[:, 1] = kp, -kp
        steps = int(np.ceil(t[-1] / STEP))
        # Between two steps a delay moves the target in part, so that it has a derivative.
        late = np.arange(steps) * STEP - numbers[-1]
        at = [
            np.clip(np.searchsorted(t, late + s * STEP, side="right") - 1, 0, len(t) - 1)
            for s in np.linspace(0, 1, 8)
        ]
        told = np.mean([target[k] for k in at], axis=0) - offset
        mujoco.mj_resetData(m, d)
        d.qpos[self.q] = q[0] - offset
        state = np.zeros(mujoco.mj_stateSize(m, _STATE))
        mujoco.mj_getState(m, d, state, _STATE)
        path = rollout.rollout(m, d, state[None], told[None], persistent_pool=True)[0][0][
            :, 1 + self.q
        ]
        path = np.concatenate([q[:1] - offset, path])
        grid = np.arange(steps + 1) * STEP
        return np.stack([np.interp(t, grid, path[:, j]) for j in range(n)], axis=1) + offset

    def fit(
        self, runs: Sequence[Run], ratios: Sequence[np.ndarray | float], rounds: int = 20
    ) -> np.ndarray:
        """The numbers that fit best; `ratios`: of each run's kp to the one that was said."""

        def numbers(z: np.ndarray) -> np.ndarray:
            return np.clip(self.low + (z - 1.0) * self.scale, self.low, self.high)

        def miss(z: np.ndarray) -> np.ndarray:
            parts = [
                (self.replay(numbers(z), r, x) - r[1]).ravel()
                for r, x in zip(runs, ratios, strict=True)
            ]
            return np.clip(np.nan_to_num(np.concatenate(parts), nan=10.0), -10, 10)

        # Differences are relative to the variable, so that none may be near 0.
        top = 1.0 + (self.high - self.low) / self.scale
        start = 1.0 + (np.clip(self.start, self.low, self.high) - self.low) / self.scale
        inside = np.clip(start, 1.0 + 1e-9, top - 1e-9)
        found = least_squares(miss, inside, bounds=(1.0, top), diff_step=2e-2, max_nfev=rounds)
        return numbers(found.x)


def errors(path: np.ndarray, run: Run, settling: float = 0.2) -> np.ndarray:
    """Rms of each joint after the start [rad]."""
    return np.sqrt(np.mean((path - run[1])[run[0] >= settling] ** 2, axis=0))
