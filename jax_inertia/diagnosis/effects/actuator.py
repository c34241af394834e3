"""Effects between the logged torque and the joint: gain, limit, delay, lag."""

import abc

import mujoco
import numpy as np
from scipy import signal

from jax_inertia.diagnosis.effects import advice
from jax_inertia.diagnosis.effects.base import Columns, Edit, Effect, Parameter, Place, of_row
from jax_inertia.diagnosis.effects.spec_joint import actuators_of, joint_of
from jax_inertia.signals.held import put_off


def everywhere_and_at_joints(context) -> list[Place]:
    """All joints at once, and each alone."""
    joints = [Place("joint", n, d) for n, d in context.joint_dofs.items()]
    return [Place("global", "global", -1), *joints]


def on_rows(values: np.ndarray, context, place: Place, rows: list[int]) -> Columns:
    """One column of some rows' own torques (T, k): on a joint's row, or on all of them at once."""
    if place.kind == "joint":
        return of_row(values, place)
    out = np.zeros((*context.tau.shape, 1))
    out[:, rows, 0] = values
    return Columns(out)


def rows_of(context, place: Place) -> list[int]:
    """The joint's row, or every hinge's and slide's."""
    return list(context.joint_dofs.values()) if place.kind == "global" else [place.index]


class TorqueGain(Effect):
    """At one joint, or at all of them (supply voltage, torque constant of one drive type)."""

    name, equation, form_error = "torque_gain", "τ = g τ_logged", 0.02
    before_gain, by_load = True, True
    source = "a torque constant, a current sensor's scale; Gautier and Briot, J. Dyn. Syst. Meas. Control 136(5), 2014"
    units, advice = {"gain": "1"}, advice.KNOWN_WEIGHT
    prior = "1 − 1/g: 0.15; g from 0.5 to 1.5"
    mjcf = "gainprm, biasprm and forcerange of the joints' actuators; torques in qfrc_applied by step law"

    def places(self, context):
        return everywhere_and_at_joints(context)

    def columns(self, context, place, shape):
        # The needed torque is the instrument: the logged one correlates with its own noise. A leg by whose logged
        # torque the ground's force is taken has no other while it stands, and swings by the same gain.
        rows = rows_of(context, place)
        bears = [_bears(context, row) for row in rows]
        torque = np.where(bears, context.tau[:, rows], context.inverse[:, rows])
        return on_rows(torque, context, place, rows)

    def scale(self, context, place, shape):
        return np.array([0.15])

    def possible(self, context, place, theta):
        return bool(abs(1.0 / (1.0 - min(theta[0], 0.9)) - 1.0) < 0.5)

    def numbers(self, context, place, shape, theta):
        if place.kind == "joint" and _bears(context, place.index):
            # y = (g − 1) logged.
            return {"gain": Parameter(1.0 + float(theta[0]), "1", factor=True)}
        # Friction at the joint is what the motor's torque is after its gain, so y = (1 − 1/g) needed + ....
        return {"gain": Parameter(1.0 / (1.0 - min(float(theta[0]), 0.9)), "1", factor=True)}

    def edit(self, spec, model, found):
        gain = found.values["gain"]
        for actuator in actuators_of(spec, found):
            actuator.gainprm = np.asarray(actuator.gainprm) * gain
            actuator.biasprm = np.asarray(actuator.biasprm) * gain
            actuator.forcerange = np.asarray(actuator.forcerange) * gain
        return Edit(whole=False)

    def step(self, xp, now, at, applied):
        tau = applied.torque
        return applied._replace(torque=xp.where(at.rows, at.values["gain"] * tau, tau))


def _bears(context, row: int) -> bool:
    """Whether a row is a leg's by whose logged torque the ground's force is taken."""
    support = context.prepared.support
    return support is not None and support.bears(row)


class DriveGain(TorqueGain):
    """The same where torques are currents times a constant of each motor: that every such constant is uncertain."""

    refines = True
    source = (
        "torque constants of one drive type; two published sets of one UR10e differ by 13 to 49 %"
    )


class GainTolerance(TorqueGain):
    """The same as a tolerance, marginalised at each joint whose gain is not found."""

    name, named, marginal, form_error = "gain_tolerance", False, True, 0.0


def beyond(tau: np.ndarray, limit: float | np.ndarray) -> np.ndarray:
    """From the limit to the largest torque asked for, where more is asked for than that; else 0 (T,) [N m]."""
    top = np.percentile(np.abs(tau), 99.8)
    return np.where(np.abs(tau) > limit, np.maximum(top - limit, 0.0), 0.0)


SOFT = 0.1
"""How far what a drive leaves out is from a sharp cut, relative: limits bend, and a grid's limit is not the drive's."""


class TorqueSaturation(Effect):
    name, equation, form_error = "torque_saturation", "τ = clip(τ_logged, ±L)", 0.03
    misses, before_gain = SOFT, True
    source = "a drive's current limit"
    units, advice = {"limit": "N m"}, advice.SMALL_AND_LARGE
    prior = "a limit between 0.05 and 0.99 of the largest torque asked for"
    mjcf = "joint actuatorfrcrange; torques in qfrc_applied by step law"

    def shapes(self, context, place):
        top = np.percentile(np.abs(context.tau[:, place.index]), 99.8)
        # A loop that fights a limit may ask for many times what it gets.
        low, high = np.geomspace(0.05, 0.35, 7), np.linspace(0.915, 0.99, 6)
        return [(float(top * x),) for x in (*low, *np.linspace(0.4, 0.9, 11), *high)]

    def steps(self, context, place, shape):
        return (0.03 * shape[0],)

    def columns(self, context, place, shape):
        tau = context.tau[:, place.index]
        return of_row(np.clip(tau, -shape[0], shape[0]) - tau, place)

    def room(self, context, place, shape):
        return beyond(context.tau[:, place.index], shape[0])

    def scale(self, context, place, shape):
        return np.array([SOFT])

    def numbers(self, context, place, shape, theta):
        return {"limit": Parameter(shape[0], "N m", 0.0)}

    def edit(self, spec, model, found):
        joint = joint_of(spec, found)
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.actfrcrange = np.array([-1.0, 1.0]) * found.values["limit"]
        return Edit(whole=False)

    def step(self, xp, now, at, applied):
        limit, tau = at.values["limit"], applied.torque
        return applied._replace(torque=xp.where(at.rows, xp.clip(tau, -limit, limit), tau))


CUT = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3)
"""Shares of a log in which a motor asks for more than its torque–speed line lets it give."""


class TorqueSpeed(Effect):
    """A motor at its supply's voltage: the faster it turns, the less it can drive, and the more it can brake."""

    name, equation = "torque_speed", "τ = clip(τ_logged, −L (1 + q̇/v₀), L (1 − q̇/v₀))"
    source = "back-EMF; Spong, Hutchinson and Vidyasagar, Robot Modeling and Control, 2006, ch. 6"
    units, advice = {"limit": "N m", "no_load_speed": "rad/s"}, advice.SMALL_AND_LARGE
    prior = "v₀ from 1.1 to 3 times the joint's peak speed; L cuts 0.5 to 30 % of the log"
    mjcf = "none: step law"
    form_error, misses, before_gain = 0.05, SOFT, True

    def shapes(self, context, place):
        tau, v = context.tau[:, place.index], context.v[:, place.index]
        fastest, side = float(np.percentile(np.abs(v), 99.5)), np.sign(tau)
        out = []
        for share in (1.1, 1.4, 2.0, 3.0):
            # Share of the motor's torque that each speed leaves it; backwards it brakes.
            left = np.maximum(1.0 - side * v / (share * fastest), 0.05)
            limits = np.quantile(np.abs(tau) / left, 1.0 - np.array(CUT))
            out += [(float(limit), share * fastest) for limit in limits]
        return out

    def steps(self, context, place, shape):
        return (0.03 * shape[0], 0.1 * shape[1])

    def columns(self, context, place, shape):
        tau, v = context.tau[:, place.index], context.v[:, place.index]
        return of_row(self.clipped(np, tau, v, *shape) - tau, place)

    @staticmethod
    def clipped(xp, tau, v, limit: float, no_load_speed: float):
        """Torque that the motor gives of what is asked for."""
        part = v / no_load_speed
        low, high = xp.minimum(-1.0 - part, 0.0), xp.maximum(1.0 - part, 0.0)
        return xp.clip(tau, limit * low, limit * high)

    def room(self, context, place, shape):
        tau, v = context.tau[:, place.index], context.v[:, place.index]
        return beyond(tau, np.abs(self.clipped(np, tau, v, *shape)))

    def scale(self, context, place, shape):
        return np.array([SOFT])

    def numbers(self, context, place, shape, theta):
        return {
            "limit": Parameter(shape[0], "N m", 0.0),
            "no_load_speed": Parameter(shape[1], "rad/s", 0.0),
        }

    def step(self, xp, now, at, applied):
        tau = applied.torque
        cut = self.clipped(xp, tau, now.v, at.values["limit"], at.values["no_load_speed"])
        return applied._replace(torque=xp.where(at.rows, cut, tau))


DELAYS = (1e-3, 5e-3, 0.012, 0.025, 0.05, 0.1, 0.2)
"""From which secants start [s]: one that starts at a twentieth of a delay ends at another effect."""


class Late(Effect):
    """A torque that comes later, at one joint or at all of them."""

    kind, secant, form_error, law = "global", True, 0.03, "timing"
    advice, before_gain = advice.FAST_SWEEP, True

    def places(self, context):
        return everywhere_and_at_joints(context)

    @abc.abstractmethod
    def later(self, tau: np.ndarray, step: float, by: float) -> np.ndarray:
        """The torque later by `by` [s]."""

    def change(self, context, place: Place, by: float) -> Columns:
        """What it makes of the torque: later less as logged."""
        rows = rows_of(context, place)
        tau, step = context.tau[:, rows], context.time[1] - context.time[0]
        return on_rows(self.later(tau, step, by) - tau, context, place, rows)

    def columns(self, context, place, shape):
        by = shape[0] if abs(shape[0]) > 1e-4 else 1e-4
        whole = self.change(context, place, by)
        return Columns(whole.values / by, whole.row)


class TimeDelay(Late):
    name, equation = "time_delay", "τ(t) = τ_logged(t − d)"
    source, units = "a bus, a driver's cycle", {"delay": "s"}
    prior = "0.01 s or the delay searched, of either sign, below 0.3 s"
    mjcf = "delay and nsample of the joints' actuators; torques in qfrc_applied by step law"

    def shapes(self, context, place):
        return [(sign * x,) for x in DELAYS for sign in (1.0, -1.0)]

    def later(self, tau, step, by):
        return put_off(tau, by / step)

    def scale(self, context, place, shape):
        return np.array([max(0.01, abs(shape[0]))])

    def numbers(self, context, place, shape, theta):
        return {"delay": Parameter(float(theta[0]), "s")}

    def possible(self, context, place, theta):
        return bool(abs(theta[0]) < 0.3)

    def edit(self, spec, model, found):
        delay = found.values["delay"]
        if delay < 0:
            return Edit(
                whole=False,
                remark=f"the torques act {-delay:.4g} s before their stamps: no simulation knows the future",
            )
        for actuator in actuators_of(spec, found):
            actuator.delay = delay
            actuator.nsample = max(2, int(np.ceil(delay / model.opt.timestep)) + 1)
        return Edit(whole=False)

    def memory(self, xp, at, u):
        return xp.tile(u, (int(max(at.values["delay"], 0.0) / at.period) + 2, 1))

    def late(self, xp, at, state, u):
        state = xp.concatenate([u[None], state[:-1]])
        whole, part = divmod(max(at.values["delay"], 0.0) / at.period, 1.0)
        arrived = (1 - part) * state[int(whole)] + part * state[int(whole) + 1]
        return state, xp.where(at.rows, arrived, u)


class ActuatorLag(Late):
    name, equation = "actuator_lag", "T τ̇ + τ = τ_logged"
    source, units = "a current loop's bandwidth", {"time_constant": "s"}
    prior = "0.012 s, not below zero"
    mjcf = "none: step law"

    def shapes(self, context, place):
        return [(x,) for x in DELAYS if x < 0.1]

    def later(self, tau, step, by):
        by = max(by, 2e-4)
        # First-order hold: exact for a torque that is linear between grid points.
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

    def memory(self, xp, at, u):
        return xp.array(u)

    def late(self, xp, at, state, u):
        reach = 1.0 - np.exp(-at.period / max(at.values["time_constant"], 1e-9))
        state = state + reach * (u - state)
        return state, xp.where(at.rows, state, u)


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
        return on_rows(-np.gradient(slope, context.time, axis=0), context, place, rows)

    def scale(self, context, place, shape):
        return np.array([3e-4])

    def numbers(self, context, place, shape, theta):
        width = float(np.sign(theta[0]) * np.sqrt(abs(theta[0])))
        return {"width": Parameter(width, "s")}
