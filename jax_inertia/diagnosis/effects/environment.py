"""Effects that belong to no single joint or body: where gravity points, what contact sensors read."""

import mujoco
import numpy as np

from jax_inertia.diagnosis.effects import advice
from jax_inertia.diagnosis.effects.base import Columns, Edit, Effect, Parameter


class GravityTilt(Effect):
    name, equation, kind, secant = (
        "gravity_tilt",
        "gravity turned about world x and y",
        "global",
        True,
    )
    source, advice = "a base that is not level", advice.TURNED_BASE
    units = {"tilt_x": "rad", "tilt_y": "rad"}
    prior = "0.04 rad about either axis, below 0.3 rad"
    mjcf = "option gravity"

    def shapes(self, context, place):
        return [(0.0, 0.0)]

    def columns(self, context, place, shape):
        # The real robot needs more torque for its own gravity; what is missing is what it did not need to give.
        x, y = shape
        tx, ty, txx, txy, tyy = np.moveaxis(context.tilt, -1, 0)
        along_x = tx + 0.5 * x * txx + 0.5 * y * txy
        along_y = ty + 0.5 * x * txy + 0.5 * y * tyy
        return Columns(-np.stack([along_x, along_y], axis=-1))

    def scale(self, context, place, shape):
        return np.full(2, 0.04)

    def possible(self, context, place, theta):
        return bool(np.hypot(*theta) < 0.3)

    def numbers(self, context, place, shape, theta):
        return {
            "tilt_x": Parameter(float(theta[0]), "rad"),
            "tilt_y": Parameter(float(theta[1]), "rad"),
        }

    def edit(self, spec, model, found):
        turn = np.array([found.values["tilt_x"], found.values["tilt_y"], 0.0])
        angle = float(np.linalg.norm(turn))
        if angle > 0:
            quat, gravity = np.zeros(4), np.zeros(3)
            mujoco.mju_axisAngle2Quat(quat, turn / angle, angle)
            mujoco.mju_rotVecQuat(gravity, np.asarray(spec.option.gravity), quat)
            spec.option.gravity = gravity
        return Edit(whole=True)


class ContactForceScale(Effect):
    name, equation, kind = "contact_force_scale", "λ_measured = g λ", "contact"
    source, advice = "a foot sensor's calibration", advice.ON_A_SCALE
    units, prior = {"scale": "1"}, "1/g − 1: 0.1, below 0.5"
    mjcf = "none: what a sensor reads is no matter of the model"

    def columns(self, context, place, shape):
        return Columns(context.contact_rows[:, place.index, :, None])

    def scale(self, context, place, shape):
        return np.array([0.1])

    def possible(self, context, place, theta):
        return bool(abs(theta[0]) < 0.5)

    def numbers(self, context, place, shape, theta):
        return {"scale": Parameter(float(1.0 / (1.0 + theta[0])), "1", factor=True)}
