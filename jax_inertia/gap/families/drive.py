"""Effects between the logged torque and the joint: gain, bias, limit, delay, lag."""

import abc

import numpy as np
from scipy import signal

from jax_inertia.gap.context import Context
from jax_inertia.gap.families.base import Columns, Family, Parameter, Place


class TorqueGain(Family):
    name, equation, kind = "torque_gain", "τ = g τ_logged", "joint"
    form_error, slow = 0.02, True

    def columns(self, context, place, shape):
        # The needed torque as the instrument: logged torque would correlate with its own noise.
        return Columns(context.inverse[:, place.index, None], place.index)

    def physical(self, context, place, shape, theta):
        return theta[0] < 0.6 and abs(self._gain(context, place, theta) - 1.0) < 0.4

    def parameters(self, context, place, shape, theta):
        return {"gain": Parameter(self._gain(context, place, theta), "1", factor=True)}

    def _gain(self, context: Context, place: Place, theta: np.ndarray) -> float:
        support = context.prepared.support
        if support is not None and support.used_up[place.index]:
            # Of a leg by whose logged torque the ground's force is taken, that torque is all that it seems to need.
            return 1.0 + theta[0]
        return 1.0 / (1.0 - theta[0])


class TorqueBias(Family):
    name, equation, kind = "torque_bias", "+ b", "joint"

    def columns(self, context, place, shape):
        return Columns(np.ones((len(context.time), 1)), place.index)

    def physical(self, context, place, shape, theta):
        return abs(theta[0]) < 0.6 * context.peak[place.index] + 1e-9

    def parameters(self, context, place, shape, theta):
        return {"bias": Parameter(theta[0], "N m")}


class TorqueSaturation(Family):
    name, equation, kind = "torque_saturation", "τ = clip(τ_logged, ±L)", "joint"
    form_error, whole = 0.03, 0.25

    def noisy(self, context):
        # Cutting off its own noise takes from the noise in y.
        return True

    def grid(self, context, place):
        # A loop that fights a limit may ask for many times what it gets.
        top = np.percentile(np.abs(context.tau[:, place.index]), 99.8)
        return (top * np.concatenate([np.geomspace(0.03, 0.38, 12), np.linspace(0.4, 0.97, 20)]),)

    def columns(self, context, place, shape):
        tau = context.tau[:, place.index]
        return Columns((np.clip(tau, -shape[0], shape[0]) - tau)[:, None], place.index)

    def physical(self, context, place, shape, theta):
        # A motor at its limit is asked for more some of the time, and then gives about the limit: else the "limit" is
        # near zero and the motor disconnected, which explains any joint whose torque is all friction.
        asked, needed = (x[:, place.index] for x in (context.tau, context.inverse))
        over = np.abs(asked) > shape[0]
        if not 0 < over.mean() < 0.6:
            return False
        return bool(np.median((needed * np.sign(asked))[over]) > 0.5 * shape[0])

    def parameters(self, context, place, shape, theta):
        return {"limit": Parameter(shape[0], "N m", 0.0)}


class _Late(Family):
    """A change of the torque's timing, at one joint or at all of them."""

    form_error, whole, slow = 0.03, 0.15, True
    law_of = "timing"

    def noisy(self, context):
        # A torque that is smoother, or later, has less of its own noise in it.
        return True

    def grid(self, context, place):
        return (np.geomspace(1e-3, 0.04, 28),)

    def columns(self, context, place, shape):
        rows = list(context.joint_dofs.values()) if place.kind == "global" else [place.index]
        tau = context.tau[:, rows]
        change = self.late(tau, context.time, shape[0]) - tau
        if place.kind == "joint":
            return Columns(change, place.index)
        out = np.zeros((*context.tau.shape, 1))
        out[:, rows, 0] = change
        return Columns(out)

    @abc.abstractmethod
    def late(self, tau, time, by) -> np.ndarray:
        """The torque, later by a delay or time constant `by` [s] (T, k)."""

    def physical(self, context, place, shape, theta):
        return True

    def places(self, context):
        joints = [Place("joint", n, d) for n, d in context.joint_dofs.items()]
        return [Place("global", "global", -1), *joints]


class TimeDelay(_Late):
    name, equation, kind = "time_delay", "τ(t) = τ_logged(t − d)", "global"

    def late(self, tau, time, by):
        step = time[1] - time[0]
        # A shift of a band-limited signal: exact as a phase, and fractional delays cost nothing.
        padded = np.concatenate([tau, tau[::-1]])
        frequency = np.fft.rfftfreq(len(padded), step)[:, None]
        shifted = np.fft.irfft(
            np.fft.rfft(padded, axis=0) * np.exp(-2j * np.pi * frequency * by),
            len(padded),
            axis=0,
        )
        return shifted[: len(tau)]

    def parameters(self, context, place, shape, theta):
        return {"delay": Parameter(shape[0], "s", 0.0)}


class ActuatorLag(_Late):
    name, equation, kind = "actuator_lag", "T τ̇ + τ = τ_logged", "global"

    def late(self, tau, time, by):
        step = time[1] - time[0]
        decay = np.exp(-step / by)
        # First-order hold: exact for a torque that is linear between grid points.
        r = step / by
        b1 = (1 - decay) / r - decay
        b0 = 1 - (1 - decay) / r
        start = signal.lfilter_zi([b0, b1], [1.0, -decay])
        return signal.lfilter([b0, b1], [1.0, -decay], tau, axis=0, zi=start[:, None] * tau[0])[0]

    def parameters(self, context, place, shape, theta):
        return {"time_constant": Parameter(shape[0], "s", 0.0)}
