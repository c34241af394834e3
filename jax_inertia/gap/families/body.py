"""Effects on a body: its inertial parameters, forces on it."""

from types import ModuleType

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


class Payload(Inertial):
    name, equation, size = "payload", "π + [m, m c, m (c·c 1 − c cᵀ)]", 4
    rigid = True
    # A real load is no point: its own inertia is left.
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
        return bool(theta[0] > 0 and np.linalg.norm(theta[1:4]) < 1.0)

    def parameters(self, context, place, shape, theta):
        return {
            "mass": Parameter(theta[0], "kg"),
            **{f"com_{k}": Parameter(x, "m") for k, x in zip("xyz", theta[1:4], strict=True)},
        }


class ComShift(Inertial):
    name, equation, size = "com_shift", "centre of mass + δ, mass and inertia about it kept", 3
    simpler = ()

    def weights(self, context, place, theta):
        pi = self.pi(context, place)
        m = pi[0]
        if m <= 0:
            return np.zeros(10)
        old, new = pi[1:4] / m, pi[1:4] / m + theta[:3]
        return np.array([0.0, *(m * theta[:3]), *(steiner(m, new) - steiner(m, old))])

    def physical(self, context, place, shape, theta):
        return bool(np.linalg.norm(theta) < 0.15)

    def parameters(self, context, place, shape, theta):
        return {f"com_shift_{k}": Parameter(x, "m") for k, x in zip("xyz", theta, strict=True)}


class LinkInertia(Inertial):
    name, equation, size = (
        "link_inertia",
        "rotational inertia about the centre of mass scaled by s",
        1,
    )

    def starts(self, context, place, free):
        return [np.array([0.1])]

    def weights(self, context, place, theta):
        pi = self.pi(context, place)
        m = pi[0]
        if m <= 0:
            return np.zeros(10)
        return np.array([0.0, 0.0, 0.0, 0.0, *(theta[0] * (pi[4:] - steiner(m, pi[1:4] / m)))])

    def physical(self, context, place, shape, theta):
        return bool(theta[0] > -0.98)

    def parameters(self, context, place, shape, theta):
        return {"inertia_scale": Parameter(1.0 + theta[0], "1")}


class ConstantForce(Family):
    name, equation, kind = "constant_force", "Jᵀ f, f fixed in the world", "body"

    def columns(self, context, place, shape):
        return Columns(context.force_rows[:, place.index])

    def physical(self, context, place, shape, theta):
        return bool(np.linalg.norm(theta) < 2000)

    def parameters(self, context, place, shape, theta):
        return {f"force_{k}": Parameter(x, "N") for k, x in zip("xyz", theta, strict=True)}


class Drag(Family):
    name, equation, kind = "drag", "−c |v| v at the centre of mass", "body"
    form_error = 0.05

    def columns(self, context, place, shape):
        v = context.com_velocity[:, place.index]
        f = -np.linalg.norm(v, axis=1, keepdims=True) * v
        return Columns(np.einsum("tjc,tc->tj", context.force_rows[:, place.index], f)[:, :, None])

    def physical(self, context, place, shape, theta):
        return bool(0 < theta[0] < 200)

    def parameters(self, context, place, shape, theta):
        return {"coefficient": Parameter(theta[0], "N s²/m²")}


# A person, or a light collision [N].
HARDEST_PUSH = 700.0


def push_window(xp: ModuleType, time, start: float, end: float, flank: float, skew: float):
    """w(t): flat between two flanks (Tukey's window; Harris 1978), and skewed, since nobody pushes symmetrically.

    `xp` is numpy or jax.numpy.
    """
    phase = xp.clip((time - start) / (end - start), 0.0, 1.0)
    near = xp.minimum(xp.minimum(phase, 1 - phase) / flank, 1.0)
    return (0.5 - 0.5 * xp.cos(np.pi * near)) * (1.0 + skew * xp.sin(2 * np.pi * phase))


class Push(Family):
    name, equation, kind = "push", "Jᵀ f w(t), w a plateau with flanks over a short window", "body"
    passing, form_error = True, 0.1

    # A shape is when the force is at its half, rising and falling, the share of the whole that either flank takes, and
    # by how much more it is in the first half: so that each hardly moves the others.
    def shapes(self, context, place):
        return [(*window, 0.3, 0.0) for window in context.windows]

    def around(self, context, place, shape):
        # The chain's low-pass smears a push by a tenth of a second.
        rise, fall, *_ = shape
        middle = 0.5 * (rise + fall)
        return [
            (max(rise - 0.1, 0.0), min(rise + 0.15, middle - 0.02)),
            (max(fall - 0.15, middle + 0.02), min(fall + 0.1, context.time[-1])),
            (0.02, 0.5),
            (-0.7, 0.7),
        ]

    def columns(self, context, place, shape):
        window = push_window(np, context.time, *_whole(shape), *shape[2:])
        return Columns(context.force_rows[:, place.index] * window[:, None, None])

    def physical(self, context, place, shape, theta):
        return bool(np.linalg.norm(theta) < HARDEST_PUSH)

    def parameters(self, context, place, shape, theta):
        start, stop = _whole(shape)
        return {
            **{f"force_{k}": Parameter(x, "N") for k, x in zip("xyz", theta, strict=True)},
            "start": Parameter(start, "s"),
            "end": Parameter(stop, "s"),
            "flank": Parameter(shape[2], "1"),
            "skew": Parameter(shape[3], "1"),
        }


def _whole(shape) -> tuple[float, float]:
    """When a push begins and ends."""
    rise, fall, flank, _ = shape
    half = 0.5 * flank * (fall - rise) / (1.0 - flank)
    return rise - half, fall + half
