"""Effects on a body's inertial parameters: e = −Y δπ."""

import abc
from typing import ClassVar

import numpy as np

from jax_inertia.diagnosis.effects import advice
from jax_inertia.diagnosis.effects.base import Columns, Edit, Effect, Parameter
from jax_inertia.diagnosis.effects.external_force import lever_on
from jax_inertia.diagnosis.effects.identified import Identified
from jax_inertia.model.load import body_pi, set_inertials
from jax_inertia.signals.differences import RIGID_BODY_ERROR

SIZE = 0.1
"""A load's usual radius of gyration on such links [m]."""
ROUNDNESS = 0.8, 0.5
"""Mean and standard deviation of k², of that radius squared: loads of 2 to 15 cm, and none below a point's zero."""
ROUND = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0])
"""A ball's inertia of one, among a body's parameters."""
LIFTED = (
    "body {0!r}: its gravity compensation lifts as much as before, but at the centre of mass found"
)


def steiner(m: float, c: np.ndarray) -> np.ndarray:
    """Inertia [xx, xy, xz, yy, yz, zz] of a mass point at c: m (c·c 1 − c cᵀ)."""
    # Scalars: the fit on a body's manifold asks for it a hundred thousand times.
    x, y, z = c.tolist()
    return m * np.array([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y])


def load_change(m: float, c: np.ndarray) -> np.ndarray:
    """δπ of a mass more at a point."""
    return np.array([m, *(m * c), *steiner(m, c)])


def shift_change(pi: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """δπ of a centre of mass that moves, mass and inertia about it kept; zero of a body without mass."""
    m = pi[0]
    if m <= 0:
        return np.zeros(10)
    old, new = pi[1:4] / m, pi[1:4] / m + shift
    return np.array([0.0, *(m * shift), *(steiner(m, new) - steiner(m, old))])


def inertia_change(pi: np.ndarray, share: float) -> np.ndarray:
    """δπ of a rotational inertia about the centre of mass that is larger by a share of itself."""
    m = pi[0]
    if m <= 0:
        return np.zeros(10)
    return np.array([0.0, 0.0, 0.0, 0.0, *(share * (pi[4:] - steiner(m, pi[1:4] / m)))])


LEAST = 0.02
"""Least mass by which a load's first and second moments are judged, of a usual one's: where none is found yet."""
MASSES = np.array([4.0, 1.0, 0.25, 0.0625])
"""Loads that are asked for, of a usual one's mass: an arm on a bench may be given its own weight to carry."""
LOAD = 0.08
"""Standard deviation of a load's mass, of the robot's: arms carry 0.1 to 0.3 of their weight at most."""


class _Inertial(Effect):
    kind, advice, form_error = "body", advice.BRISK, RIGID_BODY_ERROR
    loads = True
    mjcf: ClassVar[str] = "body inertial"

    def regressor(self, context, place) -> np.ndarray:
        """Y of the body (T, nv, 10)."""
        return context.regressor[:, :, place.index, :]

    def mass(self, context, place) -> float:
        """Nominal, kg."""
        return max(float(context.pi[place.index][0]), 1e-9)

    @abc.abstractmethod
    def change(self, pi: np.ndarray, found: Identified) -> np.ndarray:
        """δπ of what was found."""

    def edit(self, spec, model, found):
        names = [body.name for body in spec.bodies]
        if found.name not in names:
            raise ValueError(f"the model has no body {found.name!r}; it has: {', '.join(names)}")
        pi = body_pi(model, model.body(found.name).id)
        changed = pi + self.change(pi, found)
        set_inertials(spec, {found.name: changed})
        body = spec.body(found.name)
        if not body.gravcomp:
            return Edit(whole=True)
        # What lifts a body goes on lifting what the model said it weighs.
        body.gravcomp *= pi[0] / changed[0]
        return Edit(whole=True, remark=LIFTED.format(found.name))


class Payload(_Inertial):
    """A rigid load on the manifold of bodies: θ = [m, m c, m k²].

    What is quadratic in c is the secant at θ: bilinear in m c and the c of the nonlinear numbers, which are θ's own.
    """

    name, equation, secant = "payload", "mass m, centre c, moments m k² about c, added", True
    source = "a tool, a gripper; Khalil, Gautier and Lemoine, ICRA 2007"
    units = {"mass": "kg", "com_x": "m", "com_y": "m", "com_z": "m", "gyration_radius": "m"}
    prior = "0.08 of the robot's mass or 0.3 of the body's, up to four times that; as far off as its centre and 6 cm"

    def shapes(self, context, place):
        pi = context.pi[place.index]
        own = pi[1:4] / pi[0] if pi[0] > 0 else np.zeros(3)
        masses = self.usual_mass(context, place) * MASSES
        return [(m, *(m * own), m * (SIZE * context.scale) ** 2) for m in masses.tolist()]

    def columns(self, context, place, shape):
        m, first = max(float(shape[0]), 1e-9), np.asarray(shape[1:4])
        c = first / m if shape[0] > 0 else np.zeros(3)
        c = c * min(1.0, context.scale / max(float(np.linalg.norm(c)), 1e-9))
        change = np.zeros((10, 5))
        change[:4, :4] = np.eye(4)
        for k, axis in enumerate(np.eye(3)):
            change[4:, 1 + k] = _between(1.0, axis, c)
        change[:, 4] = ROUND
        return Columns(-self.regressor(context, place) @ change)

    def usual_mass(self, context, place) -> float:
        """Standard deviation of its mass [kg]: what a robot is made to carry goes with what it weighs."""
        whole = float(np.sum(context.pi[:, 0]))
        return max(0.3 * self.mass(context, place), LOAD * whole)

    def mean(self, context, place, shape):
        # A log that shows moments alone leaves it there, and not at none.
        near = self._near(context, place, shape)
        round_ = ROUNDNESS[0] * self._judged_by(context, place, shape) * (SIZE * context.scale) ** 2
        return np.array([near, 0.0, 0.0, 0.0, round_])

    def _judged_by(self, context, place, shape) -> float:
        """Mass by which a load's moments are judged [kg]."""
        return max(float(shape[0]), LEAST * self.usual_mass(context, place))

    def _near(self, context, place, shape) -> float:
        """The mass of the grid that is nearest to that by which moments are judged [kg]."""
        masses = self.usual_mass(context, place) * MASSES
        return float(masses[np.argmin(np.abs(np.log(masses / max(float(shape[0]), 1e-9))))])

    def scale(self, context, place, shape):
        # As far from the joint as the body's own centre of mass; its moments by its mass: p(m c | m), p(m k² | m).
        lever, size = lever_on(context, place), ROUNDNESS[1] * (SIZE * context.scale) ** 2
        usual, mass = self.usual_mass(context, place), self._judged_by(context, place, shape)
        spread = max(usual, self._near(context, place, shape))
        return np.array([spread, *(mass * np.array([lever, lever, lever, size]))])

    def least(self, context, place, shape, count):
        # Nothing is rounder than a point.
        return np.array([*[-np.inf] * (count - 1), 0.0])

    def possible(self, context, place, theta):
        mass = max(float(theta[0]), 1e-9)
        lever = np.linalg.norm(theta[1:4]) / mass
        # Nothing is rounder than a point; noise in accelerations makes it seem so by some.
        round_enough = theta[4] > -mass * (SIZE * context.scale) ** 2
        return bool(theta[0] > 0 and lever < context.scale and round_enough)

    def numbers(self, context, place, shape, theta):
        mass = float(theta[0])
        com = theta[1:4] / (mass if abs(mass) > 1e-9 else 1e-9)
        radius = np.sqrt(max(float(theta[4]) / max(mass, 1e-9), 0.0))
        return {
            "mass": Parameter(mass, "kg", 0.0),
            **{f"com_{k}": Parameter(float(x), "m") for k, x in zip("xyz", com, strict=True)},
            # No load is a point: MuJoCo has no body without rotational inertia.
            "gyration_radius": Parameter(
                float(np.clip(radius, 1e-3, 0.3 * context.scale)), "m", 0.0
            ),
        }

    def change(self, pi, found):
        # MuJoCo has no body without rotational inertia; a point on a massless one gets that of a 2 mm ball.
        gyration = found.values.get("gyration_radius", 0.0 if pi[0] > 0 else 1e-3)
        mass = found.values["mass"]
        return load_change(mass, np.array(found.vector("com"))) + mass * gyration**2 * ROUND


class ComShift(_Inertial):
    name, equation, secant = "com_shift", "centre of mass + δ, mass and inertia about it kept", True
    source = "batteries, cables and covers that CAD leaves out"
    units = {"com_shift_x": "m", "com_shift_y": "m", "com_shift_z": "m"}
    prior = "15 mm along each axis, below 0.15 m"

    def shapes(self, context, place):
        return [(0.0, 0.0, 0.0)]

    def columns(self, context, place, shape):
        pi, m = context.pi[place.index], self.mass(context, place)
        c, shift = pi[1:4] / m, np.asarray(shape)
        change = np.zeros((10, 3))
        for k, axis in enumerate(np.eye(3)):
            change[1 + k, k] = m
            # steiner(c + δ) − steiner(c) is bilinear in δ and 2 c + δ.
            change[4:, k] = _between(m, axis, 2 * c + shift)
        return Columns(-self.regressor(context, place) @ change)

    def scale(self, context, place, shape):
        return np.full(3, 0.015 * context.scale)

    def possible(self, context, place, theta):
        return bool(np.linalg.norm(theta) < 0.15 * context.scale)

    def numbers(self, context, place, shape, theta):
        return {
            f"com_shift_{k}": Parameter(float(x), "m") for k, x in zip("xyz", theta, strict=True)
        }

    def change(self, pi, found):
        return shift_change(pi, np.array(found.vector("com_shift")))


def _between(m: float, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The six moments of the symmetric form whose diagonal is `steiner`."""
    whole = m * (float(a @ b) * np.eye(3) - 0.5 * (np.outer(a, b) + np.outer(b, a)))
    return whole[np.triu_indices(3)]


class LinkInertia(_Inertial):
    name, equation = "link_inertia", "rotational inertia about the centre of mass scaled by s"
    source = "shells and motors that CAD takes for solid"
    units = {"inertia_scale": "1"}
    prior = "s − 1: 0.8; s from 0.1 to 10"

    def columns(self, context, place, shape):
        pi, m = context.pi[place.index], self.mass(context, place)
        central = np.concatenate([np.zeros(4), pi[4:] - steiner(m, pi[1:4] / m)])
        return Columns((-self.regressor(context, place) @ central)[..., None])

    def scale(self, context, place, shape):
        return np.array([0.8])

    def lower(self, context, place):
        return 0.1 - 1.0

    def possible(self, context, place, theta):
        return bool(0.1 <= 1.0 + theta[0] < 10.0)

    def numbers(self, context, place, shape, theta):
        return {"inertia_scale": Parameter(1.0 + float(theta[0]), "1", factor=True)}

    def change(self, pi, found):
        return inertia_change(pi, found.values["inertia_scale"] - 1.0)
