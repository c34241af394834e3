"""Torques logged as currents or counts: one drive gain per joint, taken from the log itself."""

import numpy as np

from jax_inertia.gap.chain import prepare
from jax_inertia.log import Log, TorqueUnit
from jax_inertia.preflight import Finding, Severity
from jax_inertia.robot import Robot


def in_newton_metres(log: Log, robot: Robot) -> tuple[Log, tuple[Finding, ...]]:
    """The log in N m, and what was done to it; as it is where torque is in N m already.

    The gain of a joint is the slope of g in  g i = τ_model + F sign v + d v + b, by least squares: a gap that is
    proportional to the torque itself cannot be told from it. Raises ValueError where a channel is constant.
    """
    if log.tau_unit is TorqueUnit.NEWTON_METRE:
        return log, ()
    prepared = prepare(robot, log)
    rows = dict(zip(robot.joint_names, robot.joint_dofadr, strict=True))
    v = np.asarray(prepared.observation.motion.v)
    gains = []
    for name in log.joint_names:
        row = rows[name]
        speed = v[:, row]
        columns = np.stack(
            [prepared.inverse[:, row], np.tanh(speed / 0.01), speed, np.ones_like(speed)], axis=1
        )
        used = prepared.finish(columns)
        current = prepared.finish(prepared.tau[:, row])
        # i = (τ_model + friction)/g: the noise is in the current, so it is the side that is fitted.
        slope = np.linalg.lstsq(used, current, rcond=None)[0][0]
        if not np.isfinite(slope) or slope == 0:
            raise ValueError(f"tau of {name!r} in {log.tau_unit_text!r} has no gain; log it")
        gains.append(1.0 / slope)
    text = ", ".join(f"{n} {g:.4g}" for n, g in zip(log.joint_names, gains, strict=True))
    message = (
        f"tau is in {log.tau_unit_text!r}: drive gains were taken from this log and the model, {text} N m per unit; "
        "a torque gain cannot be found beside them"
    )
    return log.with_torque_gains(gains), (Finding(Severity.WARNING, "drive_gain", message),)
