"""Effects between the logged torque and the joint: gain, limit, delay, lag."""

import abc

import numpy as np
from scipy import signal

from jax_inertia.diagnosis.effects.base import Effect, of_row
from jax_inertia.gap.families.base import Columns, Parameter, Place


class TorqueGain(Effect):
    """At one joint, or at all of them (supply voltage, torque constant of one drive type)."""

    name, equation, form_error = "torque_gain", "τ = g τ_logged", 0.02

    def places(self, context):
        return [Place("global", "global", -1), *super().places(context)]

    def columns(self, context, place, shape):
        # The needed torque is the instrument: the logged one correlates with its own noise.
        if place.kind == "joint":
            return of_row(context.inverse[:, place.index], place)
        out = np.zeros((*context.tau.shape, 1))
        rows = list(context.joint_dofs.values())
        out[:, rows, 0] = context.inverse[:, rows]
        return Columns(out)

    def scale(self, context, place, shape):
        return np.array([0.15])

    def possible(self, context, place, theta):
        return bool(abs(1.0 / (1.0 - min(theta[0], 0.9)) - 1.0) < 0.5)

    def numbers(self, context, place, shape, theta):
        # Friction at the joint is what the motor's torque is after its gain, so y = (1 − 1/g) needed + ....
        return {"gain": Parameter(1.0 / (1.0 - min(float(theta[0]), 0.9)), "1", factor=True)}


class TorqueSaturation(Effect):
    name, equation, form_error = "torque_saturation", "τ = clip(τ_logged, ±L)", 0.03

    def shapes(self, context, place):
        top = np.percentile(np.abs(context.tau[:, place.index]), 99.8)
        return [
            (float(top * x),) for x in (*np.linspace(0.4, 0.9, 11), *np.linspace(0.915, 0.99, 6))
        ]

    def steps(self, context, place, shape):
        return (0.03 * shape[0],)

    def columns(self, context, place, shape):
        tau = context.tau[:, place.index]
        return of_row(np.clip(tau, -shape[0], shape[0]) - tau, place)

    def scale(self, context, place, shape):
        return np.array([1.0])

    def possible(self, context, place, theta):
        # The cut is all there or not at all.
        return bool(0.6 < theta[0] < 1.5)

    def numbers(self, context, place, shape, theta):
        return {"limit": Parameter(shape[0], "N m", 0.0)}


class _Late(Effect):
    kind, secant, form_error, law = "global", True, 0.03, "timing"

    def places(self, context):
        joints = [Place("joint", n, d) for n, d in context.joint_dofs.items()]
        return [Place("global", "global", -1), *joints]

    def shapes(self, context, place):
        return [(1e-3,)]

    @abc.abstractmethod
    def late(self, tau: np.ndarray, step: float, by: float) -> np.ndarray:
        """The torque later by `by` [s]."""

    def columns(self, context, place, shape):
        rows = list(context.joint_dofs.values()) if place.kind == "global" else [place.index]
        tau, step = context.tau[:, rows], float(context.time[1] - context.time[0])
        by = shape[0] if abs(shape[0]) > 1e-4 else 1e-4
        change = (self.late(tau, step, by) - tau) / by
        if place.kind == "joint":
            return of_row(change, place)
        out = np.zeros((*context.tau.shape, 1))
        out[:, rows, 0] = change
        return Columns(out)


class TimeDelay(_Late):
    name, equation = "time_delay", "τ(t) = τ_logged(t − d)"

    def late(self, tau, step, by):
        # A shift of a band-limited signal: exact as a phase, of either sign.
        padded = np.concatenate([tau, tau[::-1]])
        frequency = np.fft.rfftfreq(len(padded), step)[:, None]
        turned = np.fft.rfft(padded, axis=0) * np.exp(-2j * np.pi * frequency * by)
        return np.fft.irfft(turned, len(padded), axis=0)[: len(tau)]

    def scale(self, context, place, shape):
        return np.array([0.01])

    def numbers(self, context, place, shape, theta):
        return {"delay": Parameter(float(theta[0]), "s")}

    def possible(self, context, place, theta):
        return bool(abs(theta[0]) < 0.3)


class ActuatorLag(_Late):
    name, equation = "actuator_lag", "T τ̇ + τ = τ_logged"

    def late(self, tau, step, by):
        by = max(by, 2e-4)
        decay, r = np.exp(-step / by), step / by
        b = [1 - (1 - decay) / r, (1 - decay) / r - decay]
        start = signal.lfilter_zi(b, [1.0, -decay])
        return signal.lfilter(b, [1.0, -decay], tau, axis=0, zi=start[:, None] * tau[0])[0]

    def scale(self, context, place, shape):
        return np.array([0.012])

    def numbers(self, context, place, shape, theta):
        return {"time_constant": Parameter(float(theta[0]), "s", 0.0)}

    def lower(self, context, place):
        return 0.0


class TorqueFilter(Effect):
    """A torque that was smoothed without delay when it was logged; 1/(1 + s²ω²) at ω, to second order."""

    name, equation, kind, form_error = (
        "a torque that was smoothed",
        "τ = τ_logged − s² τ̈",
        "global",
        0.1,
    )
    named = False

    def columns(self, context, place, shape):
        rows = list(context.joint_dofs.values())
        # In the analysis band, where the second order is what there is of it.
        smooth = context.below(context.prepared.bands.cutoff, context.tau[:, rows])
        slope = np.gradient(smooth, context.time, axis=0)
        out = np.zeros((*context.tau.shape, 1))
        out[:, rows, 0] = -np.gradient(slope, context.time, axis=0)
        return Columns(out)

    def scale(self, context, place, shape):
        return np.array([3e-4])

    def numbers(self, context, place, shape, theta):
        width = float(np.sign(theta[0]) * np.sqrt(abs(theta[0])))
        return {"width": Parameter(width, "s")}
