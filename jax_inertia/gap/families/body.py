"""Effects on a body's inertial parameters."""

import numpy as np

from jax_inertia.gap.families.base import Columns, Family, Parameter


def steiner(m: float, c: np.ndarray) -> np.ndarray:
    """Inertia [xx, xy, xz, yy, yz, zz] of a mass point at c: m (c·c 1 − c cᵀ)."""
    # Scalars: the fit on a body's manifold asks for it a hundred thousand times.
    x, y, z = c.tolist()
    return m * np.array([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y])


class Inertial(Family):
    """e = −Y δπ(θ), δπ the weights."""

    kind, alike, slow = "body", "−Y", True

    def columns(self, context, place, shape):
        return Columns(-context.regressor[:, :, place.index, :])

    def pi(self, context, place) -> np.ndarray:
        return context.pi[place.index]


# On a robot of usual size (`Context.scale`): how far from its body's frame a load is carried, and a centre of mass from
# where it should be [m].
FARTHEST, OFF_CENTRE = 1.0, 0.15


class Load(Inertial):
    """A mass more, at a point c of the body."""

    name = "payload"
    rigid = True
    # A real load is neither a point nor a ball: some of its own inertia is left.
    form_error = 0.05
    bends = ("mass", "centre of mass", "inertia")

    def starts(self, context, place, free):
        scale = max(float(self.pi(context, place)[0]), 0.1)
        out = [np.concatenate([[m * scale], np.zeros(3)]) for m in (0.05, 0.3, 1.0)]
        if free is not None and free[0] > 0:
            out.append(np.concatenate([free[:1], free[1:4] / free[0]]))
        return out

    def weights(self, context, place, theta):
        m, c = theta[0], theta[1:4]
        return np.array([m, *(m * c), *steiner(m, c)])

    def physical(self, context, place, shape, theta):
        return bool(theta[0] > 0 and np.linalg.norm(theta[1:4]) < FARTHEST * context.scale)

    def sized(self, context, place, size):
        pi = self.pi(context, place)
        return [np.array([size, *(pi[1:4] / pi[0] if pi[0] > 0 else np.zeros(3))])]

    def parameters(self, context, place, shape, theta):
        return {
            "mass": Parameter(theta[0], "kg", 0.0),
            **{f"com_{k}": Parameter(x, "m") for k, x in zip("xyz", theta[1:4], strict=True)},
        }


class LoadOfSomeSize(Load):
    equation, size = "π + [m, m c, m (c·c 1 − c cᵀ + k² 1)]", 5
    simpler = ("payload",)

    def starts(self, context, place, free):
        size = SIZE * context.scale
        return [np.append(theta, size**2) for theta in super().starts(context, place, free)]

    def weights(self, context, place, theta):
        return super().weights(context, place, theta) + theta[0] * max(theta[4], 0.0) * ROUND

    def tightness(self, context):
        return np.array([0.0, 0.0, 0.0, 0.0, 1.0 / (SIZE * context.scale) ** 2])

    def physical(self, context, place, shape, theta):
        widest = WIDEST * context.scale
        return super().physical(context, place, shape, theta) and 0 < theta[4] < widest**2

    def parameters(self, context, place, shape, theta):
        own = {"gyration_radius": Parameter(float(np.sqrt(theta[4])), "m", 0.0)}
        return super().parameters(context, place, shape, theta) | own


# Radius of gyration of what is carried, and of the widest of that, likewise [m].
SIZE, WIDEST = 0.07, 0.3
# A ball's inertia of one, among a body's parameters.
ROUND = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0])


class Payload(Load):
    equation, size, freer = "π + [m, m c, m (c·c 1 − c cᵀ)]", 4, LoadOfSomeSize()


class ComShift(Inertial):
    name, equation, size = "com_shift", "centre of mass + δ, mass and inertia about it kept", 3
    simpler = ()

    def sized(self, context, place, size):
        return [*(size * np.eye(3))]

    def weights(self, context, place, theta):
        pi = self.pi(context, place)
        m = pi[0]
        if m <= 0:
            return np.zeros(10)
        old, new = pi[1:4] / m, pi[1:4] / m + theta[:3]
        return np.array([0.0, *(m * theta[:3]), *(steiner(m, new) - steiner(m, old))])

    def physical(self, context, place, shape, theta):
        return bool(np.linalg.norm(theta) < OFF_CENTRE * context.scale)

    def parameters(self, context, place, shape, theta):
        return {f"com_shift_{k}": Parameter(x, "m") for k, x in zip("xyz", theta, strict=True)}


# No link has so many times more rotational inertia than its model, or less: a motor about its own axis may.
MOST = 10.0


class LinkInertia(Inertial):
    name, equation, size = (
        "link_inertia",
        "rotational inertia about the centre of mass scaled by s",
        1,
    )

    def starts(self, context, place, free):
        return [np.array([0.1])]

    def sized(self, context, place, size):
        return [np.array([size])]

    def weights(self, context, place, theta):
        pi = self.pi(context, place)
        m = pi[0]
        if m <= 0:
            return np.zeros(10)
        return np.array([0.0, 0.0, 0.0, 0.0, *(theta[0] * (pi[4:] - steiner(m, pi[1:4] / m)))])

    def physical(self, context, place, shape, theta):
        return bool(1.0 / MOST < 1.0 + theta[0] < MOST)

    def parameters(self, context, place, shape, theta):
        return {"inertia_scale": Parameter(1.0 + theta[0], "1", factor=True)}
