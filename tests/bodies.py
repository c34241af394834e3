"""Random and awkward rigid bodies as π, and an oracle of what is physical, in NumPy alone."""

import numpy as np


def body(mass, com, about_com) -> np.ndarray:
    """π from mass, centre of mass and the 3×3 inertia about it."""
    com = np.asarray(com, float)
    i = np.asarray(about_com) + mass * (com @ com * np.eye(3) - np.outer(com, com))
    return np.array([mass, *(mass * com), *i[np.triu_indices(3)]])


def rotation(rng: np.random.Generator) -> np.ndarray:
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def spread_body(mass, com, sizes, turn=None) -> np.ndarray:
    """π of mass spread with the given standard deviations [m] along three axes: physical."""
    turn = np.eye(3) if turn is None else turn
    spread = turn @ np.diag(np.square(sizes)) @ turn.T * mass
    return body(mass, com, np.trace(spread) * np.eye(3) - spread)


def random_bodies(count: int, seed: int = 0, thinnest: float = 0.02) -> np.ndarray:
    """Links from 10 g to 100 kg, spread over `thinnest` to 0.5 m, centre of mass within 0.5 m."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(count):
        mass = 10 ** rng.uniform(-2, 2)
        sizes = np.exp(rng.uniform(np.log(thinnest), np.log(0.5), size=3))
        out.append(spread_body(mass, rng.uniform(-0.3, 0.3, size=3), sizes, rotation(rng)))
    return np.array(out)


def margin(pi: np.ndarray) -> float:
    """How far π is from the edge of the physical set: smallest slack of its conditions, no units.

    Positive mass, positive principal moments about the centre of mass, and triangle inequalities,
    against the moments about the frame's origin (which are what π stores, and rounds).
    """
    mass, h = pi[0], pi[1:4]
    i = np.zeros((3, 3))
    i[np.triu_indices(3)] = pi[4:]
    i = i + np.triu(i, 1).T
    if not np.all(np.isfinite(pi)) or mass <= 0:
        return -1.0
    c = h / mass
    moments = np.linalg.eigvalsh(i - mass * (c @ c * np.eye(3) - np.outer(c, c)))
    slack = [*moments, moments[0] + moments[1] - moments[2]]
    return float(min(slack) / (np.abs(np.trace(i)) + 1e-300))
