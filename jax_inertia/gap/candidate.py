"""An effect at a place with its numbers, and how its numbers are fitted to what is left of the missing torque.

Where a family's columns carry the sensors' noise themselves (accelerations, the logged torque shifted in time), plain
least squares is biased: the noise w of the columns A + w meets the noise n of y. An *echo*, the log with its noise
added once more, shows both, and the moments are corrected by it (errors in variables; Fuller 1987, ch. 1):

    AᵀA → (A + w)ᵀ(A + w) − wᵀw,   Aᵀy → (A + w)ᵀ(y + n) − wᵀn
"""

import dataclasses
import functools

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Place, Shape
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.gap.block import Beside, Block
from jax_inertia.gap.families.base import Family
from jax_inertia.gap.loudness import Loudness
from jax_inertia.gap.noise import NOISE_ERROR


@dataclasses.dataclass
class Candidate:
    """A family at a place, and where its numbers stand."""

    family: Family
    place: Place
    block: Block
    theta: np.ndarray
    tangent: Float[np.ndarray, "k p"]
    """∂(weights of the block's columns)/∂θ at the present numbers."""
    constant: Float[np.ndarray, " k"]
    """Those weights less tangent θ: zero for linear families."""
    grid: int = 1
    gain: float = 0.0
    """ΔJ over those chosen before."""
    aim: float = 0.0
    """What is maximised over the shape: the gain, in the motion's own band for families that are judged there."""
    score: float = -np.inf
    tightness: Float[np.ndarray, " p"] | None = None
    """Of each number of θ (`Family.tightness`)."""

    @property
    def shape(self) -> Shape:
        """Its nonlinear numbers."""
        return self.block.shape

    @property
    def weights(self) -> Float[np.ndarray, " k"]:
        """Of the block's columns."""
        return self.tangent @ self.theta + self.constant

    def noise(self, loudness: Loudness | None) -> float:
        """Misfit of one sample that counts as noise beside it."""
        return self.block.noise_beside(loudness, self.weights)

    @functools.cached_property
    def columns(self) -> Float[np.ndarray, "n p"]:
        """∂e/∂θ in the charged metric."""
        return self.block.columns @ self.tangent

    @functools.cached_property
    def offset(self) -> Float[np.ndarray, " n"]:
        """e − columns θ."""
        return self.block.columns @ self.constant

    @property
    def key(self) -> tuple[str, str, str]:
        return self.family.name, self.place.kind, self.place.name

    @property
    def surprise(self) -> float:
        """Score that its equation and unlikely numbers cost."""
        unlikely = 0.0 if self.tightness is None else np.sum((self.tightness * self.theta) ** 2)
        return self.family.doubt + float(unlikely)

    def same_cause(self, other: "Candidate") -> bool:
        """Whether it is the same family at the same place; of what passes, with no pause as long as either between."""
        if self.key != other.key or not self.family.passing:
            return self.key == other.key
        (start, stop, *_), (begins, ends, *_) = self.shape, other.shape
        pause = max(begins - stop, start - ends)
        return bool(pause < min(stop - start, ends - begins))

    def same_as(self, other: "Candidate") -> bool:
        """Whether it is the same cause by the same equation."""
        return self.same_cause(other) and self.family is other.family

    @property
    def effect(self) -> Float[np.ndarray, " n"]:
        """e in the charged metric."""
        return self.offset + self.columns @ self.theta

    def excuses(self, effect: Float[np.ndarray, " n"]) -> float:
        """Misfit that errors of the family's own equation may leave of its effect on some log."""
        return self.family.form_error**2 * float(effect @ effect)

    @property
    def stirred(self) -> float:
        """Misfit that the noise of its own columns adds, where its size is given: it cannot be made smaller by that."""
        given = self.family.whole is not None and not self.family.slow
        return max(self.aim - self.gain, 0.0) if given else 0.0

    @property
    def size(self) -> int:
        """Numbers that were free: θ and the shape, details such as presliding apart."""
        free = self.family.free_shape
        return len(self.theta) + (len(self.shape) if free is None else free)

    def price(self, n: int) -> float:
        """Score that its numbers cost on n samples."""
        return self.size * np.log(n) + (2 * np.log(self.grid) if self.grid > 1 else 0.0)


def effect_torque(
    context: Context, c: Candidate, shape: Shape | None = None
) -> Float[np.ndarray, "T nv"]:
    """A found effect's torque on the fast grid of any log; with other nonlinear numbers than its own, if given."""
    columns = c.family.columns(context, c.place, c.shape if shape is None else shape)
    values = columns.values @ c.family.weights(context, c.place, c.theta)
    if columns.row is None:
        return values
    out = np.zeros((len(values), context.robot.nv))
    out[:, columns.row] = values
    return out


def fit(
    context: Context,
    family: Family,
    place: Place,
    block: Block,
    left: Beside,
    *,
    coarse: bool = False,
) -> Candidate | None:
    """Least squares in θ; Gauss–Newton on the manifold of a body's change; none where the equation has no θ.

    `coarse`: the shape is one of a few far apart, so an effect without θ may come out larger or smaller than it is.
    """
    moments, count, known = left.moments(block), block.count, family.tightness(context)
    raw, plain = moments.gram, moments.cross
    if not raw.any():
        return None
    if family.slow:
        gram, cross = left.slow_moments(block)
    elif family.whole is not None:
        gram, cross = raw - block.noise_gram, plain - block.noise_cross
        if gram[0, 0] < MOSTLY_NOISE * raw[0, 0]:
            return None
    else:
        gram, cross = raw, plain
    tangent, constant = np.eye(count), np.zeros(count)
    if family.whole is not None:
        theta = np.zeros(0)
        error = COARSE if coarse else family.whole
        if not _as_large_as_it_must_be(error, gram, cross):
            return None
        # What noise and a controller make of it above the motion's band may agree by chance with what it should be.
        if not family.slow and not _as_large_as_it_must_be(error, *left.slow_moments(block)):
            return None
        tangent, constant = np.zeros((count, 0)), np.ones(count)
    elif family.size is None:
        theta = _least_norm(gram, cross)
        if theta is not None and known is not None:
            noise = block.noise_beside(left.loudness, theta)
            theta = np.linalg.solve(gram + noise * np.diag(known**2), cross)
        if theta is None:
            return None
    else:
        free = _least_norm(gram, cross)
        noise = 1.0 if free is None else block.noise_beside(left.loudness, free)
        prior = np.zeros(family.size) if known is None else noise * known**2
        theta = _manifold(context, family, place, gram, cross, prior)
        if theta is None:
            return None
        tangent = _tangent(lambda t: family.weights(context, place, t), theta)
        constant = family.weights(context, place, theta) - tangent @ theta
    w = family.weights(context, place, theta)
    aim = float(2 * w @ cross - w @ gram @ w)
    # Numbers may come from the motion's band; what they bring is counted in all of it, without what the columns' own
    # noise explains of the noise in y. Whatever that noise excuses, an effect has to bring something.
    gain = float(2 * w @ plain - w @ raw @ w)
    if block.noise is not None:
        # An echo's noise is not among the nuisances, the log's own is (a torque's slope): of the columns it is no more
        # than all there is.
        own = min(w @ block.noise_gram @ w, w @ raw @ w)
        by_noise = float(2 * w @ block.noise_cross - own)
        gain = min(gain, gain - NOISE_ERROR * by_noise)
    if min(aim, gain) <= 0 or not family.physical(context, place, block.shape, theta):
        return None
    if family.slow and aim < SEEN:
        return None
    return Candidate(
        family, place, block, theta, tangent, constant, gain=gain, aim=aim, tightness=known
    )


def _as_large_as_it_must_be(error: float, gram: np.ndarray, cross: np.ndarray) -> bool:
    """Whether an effect without θ, its size let free, comes out as one: within its `error` and what chance does."""
    return bool(abs(cross[0] / gram[0, 0] - 1.0) <= error + 3.0 / np.sqrt(gram[0, 0]))


def _manifold(
    context: Context,
    family: Family,
    place: Place,
    gram: np.ndarray,
    cross: np.ndarray,
    prior: Float[np.ndarray, " p"],
) -> np.ndarray | None:
    """min over θ of wᵀ G w − 2 cᵀ w + Σ pᵢ θᵢ², w = weights(θ) and p the `prior`, by damped Gauss–Newton steps."""

    def change(t):
        return family.weights(context, place, t)

    def cost(t):
        d = change(t)
        return d @ gram @ d - 2 * cross @ d + prior @ t**2

    best, best_cost = None, 0.0
    # Where ten numbers free of each other would put it: from far away the descent may end beside the truth.
    for theta in family.starts(context, place, _least_norm(gram, cross)):
        damping, value = 1e-6, cost(theta)
        for _ in range(30):
            t = _tangent(change, theta)
            slope = t.T @ (cross - gram @ change(theta)) - prior * theta
            hessian = t.T @ gram @ t + np.diag(prior)
            scale = np.diagonal(hessian) + 1e-12 * max(np.max(np.diagonal(hessian)), 1e-300)
            step = np.linalg.lstsq(hessian + damping * np.diag(scale), slope, rcond=None)[0]
            trial = cost(theta + step)
            if trial < value:
                done = value - trial < 1e-8 * abs(trial)
                theta, value, damping = theta + step, trial, damping * 0.3
                if done:
                    break
            else:
                damping = max(damping * 10, 1e-6)
                if damping > 1e8:
                    break
        if value < best_cost:
            best, best_cost = theta, value
    return best


# A column of which less than this share of the energy is motion, the rest noise, says nothing.
MOSTLY_NOISE = 0.5
# Between the few shapes looked at first, an effect without θ may be this much larger or smaller.
COARSE = 0.7
# An effect judged in the motion's band must be seen there: this much misfit, whatever it brings above.
SEEN = 12.0


def _least_norm(gram: np.ndarray, cross: np.ndarray) -> np.ndarray | None:
    """θ of the normal equations; directions that do nothing (a force across a planar arm) stay zero."""
    scale = np.sqrt(np.maximum(np.diagonal(gram), 0.0))
    alive = scale > 1e-6 * max(float(scale.max()), 1e-3)
    if not alive.any():
        return None
    theta = np.zeros(len(cross))
    unit = gram[np.ix_(alive, alive)] / scale[alive, None] / scale[None, alive]
    values, vectors = np.linalg.eigh(unit)
    kept = values > 1e-8 * values[-1]
    part = vectors[:, kept]
    theta[alive] = part @ ((part.T @ (cross[alive] / scale[alive])) / values[kept]) / scale[alive]
    return theta


def _tangent(weights, theta: np.ndarray) -> np.ndarray:
    """∂(weights)/∂θ by central differences; they are at most cubic, so the step may be large."""
    out = []
    for k in range(len(theta)):
        h = np.zeros(len(theta))
        h[k] = 1e-4 * max(1.0, abs(theta[k]))
        out.append((weights(theta + h) - weights(theta - h)) / (2 * h[k]))
    return np.stack(out, axis=1)
