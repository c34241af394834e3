"""Torques logged as currents or counts: one drive gain per joint, taken from the log itself."""

import numpy as np

from jax_inertia.logs.log import Log, TorqueUnit
from jax_inertia.model.robot import Robot
from jax_inertia.preflight.preflight import Finding, Severity
from jax_inertia.signals.torque_residual import prepare

# A slope this many standard errors from zero is a gain; where no joint has one, the best does from fewer on.
SURE, LEAST = 10.0, 2.0


def drive_gains(log: Log, robot: Robot) -> tuple[list[float], tuple[Finding, ...]]:
    """Gain of each joint in N m per unit of the log, and what there is to say of it; none for a log in N m.

    The gain is the slope g in  g i = τ_model + F sign v + d v + b, by least squares: a gap that is proportional to the
    torque itself cannot be separated from it. A joint that carries too little (a wrist's roll) gets the others' median.
    Raises ValueError where a channel is constant, or no joint's gain is determined.
    """
    if log.tau_unit is TorqueUnit.NEWTON_METRE:
        return [], ()
    prepared = prepare(robot, log)
    rows = dict(zip(robot.joint_names, robot.joint_dofadr, strict=True))
    v = np.asarray(prepared.observation.motion.v)
    gains, clarity = [], []
    for name in log.joint_names:
        row = rows[name]
        speed = v[:, row]
        columns = np.stack(
            [prepared.inverse[:, row], np.tanh(speed / 0.01), speed, np.ones_like(speed)], axis=1
        )
        used, current = prepared.finish(columns), prepared.finish(prepared.tau[:, row])
        # i = (τ_model + friction)/g: the noise is in the current, so it is the side that is fitted.
        fit = np.linalg.lstsq(used, current, rcond=None)[0]
        if not np.isfinite(fit[0]) or fit[0] == 0:
            raise ValueError(f"tau of {name!r} in {log.tau_unit_text!r} has no gain; log it")
        left = current - used @ fit
        error = np.sqrt(np.mean(left**2) * np.linalg.pinv(used.T @ used)[0, 0])
        # Neighbouring samples go together: about ten of them count as one.
        clarity.append(float(fit[0] / max(error * np.sqrt(10.0), 1e-300)))
        gains.append(1.0 / fit[0])
    sure = [x > min(SURE, max(max(clarity) * 0.99, LEAST)) for x in clarity]
    if not any(sure):
        raise ValueError(
            f"tau is in {log.tau_unit_text!r} and no joint's gain can be identified from this log; give torques in N m"
        )
    middle = float(np.median([g for g, s in zip(gains, sure, strict=True) if s]))
    gains = [g if s else middle for g, s in zip(gains, sure, strict=True)]
    text = ", ".join(f"{n} {g:.4g}" for n, g in zip(log.joint_names, gains, strict=True))
    message = (
        f"tau is in {log.tau_unit_text!r}: drive gains were taken from this log and the model, {text} N m per unit; "
        "a torque gain cannot be found with them"
    )
    if max(clarity) < SURE:
        message += f"; known to some {100 / max(clarity):.0f} % only"
    if unsure := [n for n, s in zip(log.joint_names, sure, strict=True) if not s]:
        message += f"; {', '.join(unsure)} carry too little to determine it, so they have the median of the others"
    return gains, (Finding(Severity.WARNING, "drive_gain", message),)


def in_newton_metres(log: Log, gains: list[float]) -> Log:
    """The log with `drive_gains` applied; as it is where there are none."""
    return log.with_torque_gains(gains) if gains else log
