"""The numbers of a replay that fits: Gauss–Newton over MuJoCo replays.

The cost is the replays' error, output by output in units of what remains of it, every sample counting for its share of
an independent one, and a Gaussian prior about the nominal model:

    Σ_j Σ_t (q̂_tj − q_tj)² / (σ_j² T_j)  +  Σ_j Σ_t (τ̂_tj − τ_tj)² / (σ'_j² T'_j)  +  Σ_p ((θ_p − θ⁰_p) / s_p)²

with T_j the integrated autocorrelation time of joint j's error [samples]; torques τ where they are logged, τ̂ what the
loop gives at the measured positions (`simulate.py`). Replays of a position-controlled robot
do not drift apart: the whole log is one shot, and no velocities have to be guessed between.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.replay.loop import ALL, LOGARITHMIC, TOLERANCES, Parameter
from jax_inertia.replay.record import Record
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import misses, replay

ROUNDS = 12
_ENOUGH = 2e-3
_DAMPINGS = (0.0, 0.1), (1e-2, 1.0, 10.0)
"""Of steps: those that are tried first, and the others where these keep less of what they promise than `_KEPT`."""
_KEPT = 0.25
_DIFFERENCE = 0.02
# Between Jacobians: steps with a mended one, while each takes so much of the cost.
_MENDED, _WORTHWHILE = 2, 0.03
# Of the log, for the first look at kp and delay [s].
_LOOK = 12.0
_GUESSED = np.array([-5.0, -4.5, -4.0, -3.5, -3.0, -2.4, -1.8, -1.2, -0.6, 0.0])
_SAID = np.array([-0.8, -0.4, -0.2, 0.0, 0.2])
_DELAYS = (0.0, 0.015, 0.03, 0.06, 0.12)


class Fit(NamedTuple):
    """Numbers that fit, and how well they are known."""

    table: tuple[Parameter, ...]
    theta: Float[np.ndarray, " P"]
    covariance: Float[np.ndarray, "P P"]
    hessian: Float[np.ndarray, "P P"]
    """Half the second derivative of the cost, prior included."""
    samples: float
    """How many independent samples the errors are worth."""
    error: Float[np.ndarray, "N m"]
    """Of the joints' positions [rad], and then of their torques [N m] where those are logged."""
    columns: Float[np.ndarray, "P N m"]
    """Derivatives of the error, there or a last small step before."""
    weights: "Weights"

    @property
    def sigma(self) -> Float[np.ndarray, " P"]:
        """Standard deviations."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def free(self) -> Bool[np.ndarray, " P"]:
        """Which numbers were fitted."""
        return np.diagonal(self.covariance) > 0


class Weights(NamedTuple):
    """What an error of an output counts: remaining rms σ [rad or N m] and autocorrelation time T [samples]."""

    sigma: Float[np.ndarray, " m"]
    correlated: Float[np.ndarray, " m"]

    @property
    def root(self) -> Float[np.ndarray, " m"]:
        """The square root of one sample's weight."""
        return 1.0 / (self.sigma * np.sqrt(self.correlated))


def errors(
    plant: Plant,
    table: Sequence[Parameter],
    thetas: Float[np.ndarray, "B P"],
    records: Sequence[Record],
) -> Float[np.ndarray, "B N m"]:
    """Replay minus log of every vector, all records one after the other, where they count [rad].

    Where torque is logged it is a second output of every joint, after all positions: `simulate.misses` [N m].
    """
    parts = []
    for r in records:
        error = replay(plant, table, thetas, r) - r.q
        if r.torque is not None:
            error = np.concatenate([error, misses(plant, table, thetas, r)], axis=2)
        parts.append(error[:, r.settled])
    return np.concatenate(parts, axis=1)


def weights(error: Float[np.ndarray, "N m"], floor: float | Float[np.ndarray, " m"]) -> Weights:
    """From an error as it is."""
    sigma = np.maximum(np.sqrt(np.mean(error**2, axis=0)), floor)
    return Weights(sigma, np.array([autocorrelation_time(e) for e in error.T]))


def autocorrelation_time(x: Float[np.ndarray, " N"]) -> float:
    """1 + 2 Σ ρ_k up to the first k where ρ is not positive, as in Geyer 1992, of x about its mean [samples]."""
    n, x = len(x), x - np.mean(x)
    power = np.abs(np.fft.rfft(x, 2 * n)) ** 2
    rho = np.fft.irfft(power)[: n // 2]
    if not rho[0] > 0:
        return 1.0
    rho = rho / rho[0]
    last = int(np.argmax(rho <= 0)) if np.any(rho <= 0) else len(rho)
    return float(1.0 + 2.0 * np.sum(rho[1:last]))


def start(
    plant: Plant, table: Sequence[Parameter], records: Sequence[Record], guessed: bool
) -> Float[np.ndarray, " P"]:
    """The nominal numbers, with the kp of each joint and the times whose replays of the first seconds err least.

    A least-squares step does not find its way over an order of magnitude of kp, nor over a period of the motion.
    """
    theta = np.array([p.nominal for p in table])
    gains = [k for k, p in enumerate(table) if p.family == "kp_scale"]
    late = next(
        (k for k, p in enumerate(table) if p.family == "target_delay" and p.joint == ALL), None
    )
    scales = _GUESSED if guessed else _SAID
    delays = [{}] if late is None else [{late: d} for d in _DELAYS]
    lead = [k for k, p in enumerate(table) if p.family == "torque_lead"]
    if late is not None and lead:
        delays += [{lead[0]: d} for d in _DELAYS[1:]]
    tries = np.repeat(theta[None], len(scales) * len(delays), axis=0)
    for k, (times, s) in enumerate((d, s) for d in delays for s in scales):
        tries[k, gains] = s
        tries[k, list(times)] = list(times.values())
    short = [r.between(0, int(np.searchsorted(r.time, _LOOK))) for r in records]
    square = np.mean(errors(plant, table, tries, short) ** 2, axis=1).reshape(
        len(delays), len(scales), -1, len(plant.names)
    )
    # Outputs in units of their own best; a joint's are its position and, where logged, its torque.
    relative = np.log(square + 1e-8).sum(axis=2)
    best = int(np.argmin(relative.min(axis=1).sum(axis=-1)))
    theta[gains] = scales[np.argmin(relative[best], axis=0)][[table[k].joint for k in gains]]
    theta[list(delays[best])] = list(delays[best].values())
    return theta


def fit(
    plant: Plant,
    table: Sequence[Parameter],
    records: Sequence[Record],
    theta: Float[np.ndarray, " P"],
    *,
    free: Bool[np.ndarray, " P"] | None = None,
    floor: float | Float[np.ndarray, " m"] = 1e-4,
    rounds: int = ROUNDS,
    known: tuple[np.ndarray, np.ndarray] | None = None,
    mended_only: bool = False,
    progress: Callable[[str], None] = lambda text: None,
) -> Fit:
    """Gauss–Newton from `theta`; numbers that are not free stay where they are.

    Between Jacobians, up to two steps with one that is mended by Broyden's formula: a replay for each try, where a
    Jacobian takes one for each number. `known`: error and derivatives near the start, from another fit;
    `mended_only`: with no other Jacobian than that.
    """
    problem = _Problem(plant, tuple(table), records, floor, np.ones(len(table), bool))
    if free is not None:
        problem = problem._replace(free=free)
    theta = np.clip(theta, *problem.bounds)
    error, columns = known or derivatives(plant, table, records, theta, problem.free)
    mended = int(known is not None)
    # What is off by little is nearly linear: its columns are computed first, and anew once all others stay.
    most = problem.free & np.array([p.family not in TOLERANCES for p in table], bool)
    asked, outdated = most, False
    for k in range(rounds):
        progress(f"fitting replays, round {k + 1}")
        step = problem.step(theta, error, columns)
        if step.gain > _ENOUGH:
            new, now = step.theta, step.error
            if mended_only or (mended < _MENDED and step.gain > _WORTHWHILE):
                columns = mend(plant, problem.table, columns, new - theta, now - error)
                theta, error, mended = new, now, mended + 1
                continue
            theta = new
        elif mended_only or not (mended or outdated):
            if step.gain > 0:
                theta, error = step.theta, step.error
            break
        else:
            asked = problem.free
        error, columns = _again(plant, table, records, theta, asked, columns)
        mended, outdated = 0, not np.array_equal(asked, problem.free)
    if (mended or outdated) and not mended_only:
        error, columns = derivatives(plant, table, records, theta, problem.free)
    return _told(problem, theta, error, columns)


class _Step(NamedTuple):
    theta: np.ndarray
    error: np.ndarray
    gain: float
    """By what share the cost falls."""


class _Problem(NamedTuple):
    plant: Plant
    table: tuple[Parameter, ...]
    records: Sequence[Record]
    floor: float | np.ndarray
    free: np.ndarray

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([p.low for p in self.table]), np.array([p.high for p in self.table])

    @property
    def prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of each number; those that stand still have none."""
        mean = np.array([p.mean for p in self.table])
        return mean, np.array([p.sd for p in self.table])

    def step(self, theta, error, columns) -> _Step:
        """The best of a few damped steps."""
        low, high = self.bounds
        mean, sd = self.prior
        w = weights(error, self.floor)
        hessian, gradient = normal(error, columns, w, theta, mean, sd)
        # What stands at a bound and wants beyond stays there.
        held = ~self.free | ((theta <= low) & (gradient > 0)) | ((theta >= high) & (gradient < 0))
        go = np.flatnonzero(~held)
        h, own = hessian[np.ix_(go, go)], gradient[go]
        mean, sd = mean[self.free], sd[self.free]
        now = cost(error[None], w, theta[None, self.free], mean, sd)[0]
        promised = float(own @ np.linalg.solve(h, own)) / now
        best = _Step(theta, error, -np.inf)
        for dampings in _DAMPINGS:
            tries = np.repeat(theta[None], len(dampings), axis=0)
            for new, damping in zip(tries, dampings, strict=True):
                new[go] -= np.linalg.solve(h + damping * np.diag(np.diagonal(h)), own)
            tries = np.clip(tries, low, high)
            found = errors(self.plant, self.table, tries, self.records)
            gains = (now - cost(found, w, tries[:, self.free], mean, sd)) / now
            k = int(np.argmax(gains))
            if gains[k] > best.gain:
                best = _Step(tries[k], found[k], float(gains[k]))
            if best.gain > _KEPT * promised or promised < _ENOUGH:
                break
        return best


def mend(plant: Plant, table, columns, step, change) -> np.ndarray:
    """Derivatives that say of the last step what it did (Broyden), each joint's by the numbers of its tree."""
    step = np.nan_to_num(step)
    scaled = step / np.array([p.sd for p in table])
    share = scaled[:, None] * touches(plant, table, change.shape[-1])
    lacking = change - np.einsum("p,pnj->nj", step, columns)
    size = np.maximum(np.sum(share**2, axis=0), 1e-300)
    by = share / size / np.array([p.sd for p in table])[:, None]
    return columns + by[:, None] * lacking


def touches(plant: Plant, table: Sequence[Parameter], outputs: int) -> Bool[np.ndarray, "P m"]:
    """Which outputs each number can change: positions, and perhaps torques, of the joints of its tree."""
    trees = [plant.tree_of(p) for p in table]
    joints = [np.ones_like(plant.trees, bool) if t is None else plant.trees == t for t in trees]
    return np.tile(np.array(joints), outputs // len(plant.trees))


def _told(problem: _Problem, theta, error, columns) -> Fit:
    """How well the numbers are known: the wider, number by number, of two ways to allow for errors that last.

    One counts samples by their autocorrelation; the other is the sandwich H⁻¹ Σ_b g_b g_bᵀ H⁻¹ over blocks b of the
    log, which is a jackknife over them to first order.
    """
    table, free = problem.table, problem.free
    w = weights(error, problem.floor)
    hessian, _ = normal(error, columns, w, theta, *problem.prior)
    go = np.flatnonzero(free)
    inverse = np.linalg.inv(hessian[np.ix_(go, go)])
    length = int(max(2.0 * np.max(w.correlated), 1.0 / problem.records[0].period))
    blocks = max(len(error) // length, 1)
    white, rest, scores = columns * w.root, error * w.root, []
    for rows in np.array_split(np.arange(len(error)), blocks):
        scores.append(np.einsum("ptj,tj->p", white[go][:, rows], rest[rows]))
    meat = np.array(scores).T @ np.array(scores)
    sandwich = inverse @ meat @ inverse
    wider = np.sqrt(np.maximum(np.diagonal(sandwich) / np.diagonal(inverse), 1.0))
    covariance = np.zeros((len(table),) * 2)
    covariance[np.ix_(go, go)] = np.minimum(np.outer(wider, wider), 1e6) * inverse
    samples = float(np.sum(len(error) / w.correlated))
    return Fit(table, theta, covariance, hessian, samples, error, columns, w)


def derivatives(plant, table, records, theta, free) -> tuple[np.ndarray, np.ndarray]:
    """Error (N, n) and its derivatives (P, N, n), by differences as wide as the encoders can see.

    Numbers of separate trees of joints, which do not feel each other, share a replay.
    """
    steps = np.array([_DIFFERENCE * (p.sd if np.isfinite(p.sd) else 1.0) for p in table])
    linear = np.array([p.family not in LOGARITHMIC for p in table])
    steps = np.maximum(steps, _DIFFERENCE * np.abs(np.where(linear, theta, 0.0)))
    steps = np.where(theta + steps > np.array([p.high for p in table]), -steps, steps)
    go = np.flatnonzero(free)
    rows = together([plant.tree_of(table[k]) for k in go])
    thetas = np.repeat(theta[None], max(rows, default=-1) + 2, axis=0)
    for k, row in zip(go, rows, strict=True):
        thetas[row + 1, k] += steps[k]
    out = errors(plant, table, thetas, records)
    jacobian = np.zeros((len(table), *out.shape[1:]))
    for k, row in zip(go, rows, strict=True):
        jacobian[k] = (out[row + 1] - out[0]) / steps[k]
    return out[0], jacobian * touches(plant, table, out.shape[-1])[:, None]


def _again(plant, table, records, theta, asked, columns) -> tuple[np.ndarray, np.ndarray]:
    """Error and derivatives, those by numbers that are not asked about as they were."""
    error, new = derivatives(plant, table, records, theta, asked)
    return error, np.where(asked[:, None, None], new, columns)


def together(trees: Sequence[int | None]) -> list[int]:
    """A replay's number for each change: those of separate trees share one, those of all joints have their own."""
    out, used = [], dict.fromkeys({t for t in trees if t is not None}, 0)
    for t in trees:
        out.append(-1 if t is None else used[t])
        if t is not None:
            used[t] += 1
    shared = max(used.values(), default=0)
    alone = iter(range(shared, shared + len(trees)))
    return [next(alone) if row < 0 else row for row in out]


def normal(error, jacobian, w: Weights, theta, mean, sd) -> tuple[np.ndarray, np.ndarray]:
    """Half the cost's second derivative, and half its gradient."""
    flat = (jacobian * w.root).reshape(len(theta), -1)
    prior = 1.0 / sd**2
    away = np.where(np.isfinite(theta), theta - mean, 0.0)
    gradient = flat @ (error * w.root).ravel() + prior * away
    return flat @ flat.T + np.diag(prior), gradient


def cost(error, w: Weights, thetas, mean, sd) -> np.ndarray:
    return np.sum((error * w.root) ** 2, axis=(1, 2)) + np.sum(((thetas - mean) / sd) ** 2, axis=1)
