"""Plans for effects between the logged torque and the joint: gain, limit, delay, lag."""

import numpy as np

from jax_inertia.diagnosis.effects import actuator
from jax_inertia.diagnosis.effects.base import Parameter, Place
from jax_inertia.gap.families.base import Family


class TorqueGain(Family):
    effect = actuator.TorqueGain()
    form_error, slow = 0.02, True

    def places(self, context):
        return [p for p in super().places(context) if p.kind == "joint"]

    def physical(self, context, place, shape, theta):
        gain = self.parameters(context, place, shape, theta)["gain"].value
        return theta[0] < 0.6 and abs(gain - 1.0) < 0.4


class TorqueSaturation(Family):
    effect = actuator.TorqueSaturation()
    form_error, whole = 0.03, 0.25

    def noisy(self, context):
        # Cutting off its own noise takes from the noise in y.
        return True

    def grid(self, context, place):
        # A loop that fights a limit may ask for many times what it gets.
        top = np.percentile(np.abs(context.tau[:, place.index]), 99.8)
        return (top * np.concatenate([np.geomspace(0.03, 0.38, 12), np.linspace(0.4, 0.97, 20)]),)

    def physical(self, context, place, shape, theta):
        # A motor at its limit is asked for more some of the time, and then gives about the limit: else the "limit" is
        # near zero and the motor disconnected, which explains any joint whose torque is all friction.
        asked, needed = (x[:, place.index] for x in (context.tau, context.inverse))
        over = np.abs(asked) > shape[0]
        if not 0 < over.mean() < 0.6:
            return False
        return bool(np.median((needed * np.sign(asked))[over]) > 0.5 * shape[0])


class Late(Family[actuator.Late]):
    """A change of the torque's timing, whole: the delay or time constant [s] is the one nonlinear number."""

    form_error, whole, slow = 0.03, 0.15, True
    law_of = "timing"

    def __init__(self, effect: actuator.Late):
        self.effect = effect

    def noisy(self, context):
        # A torque that is smoother, or later, has less of its own noise in it.
        return True

    def grid(self, context, place):
        return (np.geomspace(1e-3, 0.04, 28),)

    def columns(self, context, place: Place, shape):
        return self.effect.change(context, place, shape[0])

    def physical(self, context, place, shape, theta):
        return True

    def parameters(self, context, place, shape, theta):
        ((name, unit),) = self.effect.units.items()
        return {name: Parameter(shape[0], unit, 0.0)}
