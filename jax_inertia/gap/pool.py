"""Every family at every place: its columns, computed once, and its fit to what is left of the missing torque.

Where a family's columns carry the sensors' noise themselves (accelerations, the logged torque shifted in time), plain
least squares is biased: the noise w of the columns A + w meets the noise n of y. An *echo*, the log with its noise
added once more, shows both, and the moments are corrected by it (errors in variables; Fuller 1987, ch. 1):

    AᵀA → (A + w)ᵀ(A + w) − wᵀw,   Aᵀy → (A + w)ᵀ(y + n) − wᵀn
"""

import copy
import dataclasses
from collections.abc import Iterator

import numpy as np
import scipy.optimize
from jaxtyping import Float

from jax_inertia.gap.context import Context
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.families.base import Family, Place, Shape


@dataclasses.dataclass
class Candidate:
    """A family at a place, and where its numbers stand."""

    family: Family
    place: Place
    shape: Shape
    theta: np.ndarray
    columns: Float[np.ndarray, "n k"]
    """∂e/∂θ in the charged metric, at the present numbers."""
    offset: Float[np.ndarray, " n"]
    """e − columns θ: zero for linear families."""
    grid: int
    gain: float = 0.0
    """ΔJ over those chosen before."""
    aim: float = 0.0
    """What is maximised over the shape: the gain, in the motion's own band for families that are judged there."""
    score: float = -np.inf

    @property
    def key(self) -> tuple[str, str, str]:
        return self.family.name, self.place.kind, self.place.name

    @property
    def effect(self) -> Float[np.ndarray, " n"]:
        """e in the charged metric."""
        return self.offset + self.columns @ self.theta

    def excuses(self, effect: Float[np.ndarray, " n"]) -> float:
        """Misfit that errors of the family's own equation may leave of its effect on some log."""
        return self.family.form_error**2 * float(effect @ effect)

    @property
    def size(self) -> int:
        """Numbers that were free: θ and the shape, details such as presliding apart."""
        free = self.family.free_shape
        return len(self.theta) + (len(self.shape) if free is None else free)

    def price(self, n: int) -> float:
        """Score that its numbers cost on n samples."""
        return self.size * np.log(n) + (2 * np.log(self.grid) if self.grid > 1 else 0.0)


@dataclasses.dataclass(frozen=True)
class Echo:
    """The log once more, with its sensors' noise added again."""

    context: Context
    noise: Float[np.ndarray, " n"]
    """What that noise does to y, in the charged metric."""


@dataclasses.dataclass(frozen=True)
class Block:
    """Columns of one shape in the charged metric, and what noise alone puts into their moments."""

    shape: Shape
    columns: Float[np.ndarray, "n k"]
    noise: Float[np.ndarray, "n k"] | None = None
    """What the echo's noise adds to the columns, where they carry it."""
    gram: Float[np.ndarray, "k k"] | float = 0.0
    cross: Float[np.ndarray, " k"] | float = 0.0

    @classmethod
    def noisy(cls, shape: Shape, columns, noise, of_y: Float[np.ndarray, " n"]) -> "Block":
        """A block with its noise's moments."""
        return cls(shape, columns, noise, noise.T @ noise, noise.T @ of_y)


def beside(
    columns: Float[np.ndarray, "n s"], target: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n s"], Float[np.ndarray, " n"]]:
    """An orthonormal basis of the columns, and what they cannot reach of the target."""
    basis = np.linalg.qr(columns)[0] if columns.shape[1] else columns
    return basis, target - basis @ (basis.T @ target)


def effect_torque(context: Context, c: Candidate) -> Float[np.ndarray, "T nv"]:
    """A found effect's torque on the fast grid of any log."""
    columns = c.family.columns(context, c.place, c.shape)
    values = columns.values @ c.family.weights(context, c.place, c.theta)
    if columns.row is None:
        return values
    out = np.zeros((len(values), context.robot.nv))
    out[:, columns.row] = values
    return out


class Pool:
    """All candidates of a log, their columns computed once."""

    def __init__(self, context: Context, evidence: Evidence, library: list[Family], echo: Echo):
        self.context, self.evidence, self.echo = context, evidence, echo
        self.library = library
        self.entries: list[tuple[Family, Place, list[Block]]] = []
        for family in library:
            self._enter(family)

    def look_again(self, windows: tuple[tuple[float, float], ...]) -> None:
        """Offer what happens in passing (pushes) over other stretches of time."""
        if windows == self.context.windows:
            return
        self.context.windows = windows
        self.entries = [e for e in self.entries if not e[0].passing]
        for family in self.library:
            if family.passing:
                self._enter(family)

    def _enter(self, family: Family) -> None:
        for place in family.places(self.context):
            shapes = list(family.shapes(self.context, place))
            blocks = [
                b
                for b in self.blocks(family, place, shapes)
                if np.isfinite(b.columns).all() and np.sum(b.columns**2) > 1e-12
            ]
            if blocks:
                self.entries.append((family, place, blocks))

    def blocks(self, family: Family, place: Place, shapes: list[Shape]) -> list[Block]:
        """A family's columns at a place, for given nonlinear numbers."""

        def columns(context: Context) -> Iterator[np.ndarray]:
            family.prepare(context, place, shapes)
            return self.evidence.of_many(family.columns(context, place, s) for s in shapes)

        if not family.noisy(self.context):
            return [Block(s, x) for s, x in zip(shapes, columns(self.context), strict=True)]
        out = []
        for s, x, again in zip(
            shapes, columns(self.context), columns(self.echo.context), strict=True
        ):
            out.append(Block.noisy(s, x, again - x, self.echo.noise))
        return out

    def rescaled(self, scales: dict[str, float]) -> "Pool":
        """The same candidates where the model's tolerances are `scales` times as large."""
        out = copy.copy(self)
        out.evidence = self.evidence.rescaled(scales)

        def move(x: np.ndarray) -> np.ndarray:
            return out.evidence.recharged(x, self.evidence)

        out.echo = Echo(self.echo.context, move(self.echo.noise[:, None])[:, 0])
        out.entries = []
        for family, place, blocks in self.entries:
            sizes = np.cumsum([b.columns.shape[1] for b in blocks])[:-1]
            moved = np.split(move(np.concatenate([b.columns for b in blocks], 1)), sizes, 1)
            if blocks[0].noise is None:
                changed = [Block(b.shape, x) for b, x in zip(blocks, moved, strict=True)]
            else:
                noise = [b.noise for b in blocks if b.noise is not None]
                noise = np.split(move(np.concatenate(noise, 1)), sizes, 1)
                changed = [
                    Block.noisy(b.shape, x, w, out.echo.noise)
                    for b, x, w in zip(blocks, moved, noise, strict=True)
                ]
            out.entries.append((family, place, changed))
        return out

    def best(
        self, residual: Float[np.ndarray, " n"], chosen: Float[np.ndarray, "n s"], noise: float
    ) -> list[Candidate]:
        """Every candidate fitted to a residual beside the chosen columns, best score first."""
        n = self.evidence.rows
        basis, target = beside(chosen, residual)
        out = []
        for family, place, blocks in self.entries:
            fits = [self._fit(family, place, block, basis, target) for block in blocks]
            fits = [f for f in fits if f is not None]
            if not fits:
                continue
            top = max(fits, key=lambda c: c.aim)
            top.grid = len(blocks)
            if family.passing:
                # Windows were picked from all there are: (duration / 0.1 s)² of them, about.
                top.grid = max(2, round((self.context.time[-1] / 0.1) ** 2))
            top.score = top.gain / noise - top.price(n)
            out.append(top)
        return sorted(out, key=lambda c: -c.score)

    def refined(self, candidate: Candidate, residual, chosen, noise) -> Candidate:
        """The same candidate with its shape between grid points, one number after the other."""
        family, place = candidate.family, candidate.place
        if not candidate.shape:
            return candidate
        basis, target = beside(chosen, residual)
        best = candidate
        for _ in range(2):
            before = best.aim
            for axis in range(len(best.shape)):
                bounds = family.around(self.context, place, best.shape)[axis]
                if bounds[1] <= bounds[0]:
                    continue

                def cost(x, axis=axis):
                    nonlocal best
                    shape = (*best.shape[:axis], float(x), *best.shape[axis + 1 :])
                    [block] = self.blocks(family, place, [shape])
                    fitted = self._fit(family, place, block, basis, target)
                    if fitted is None:
                        return 0.0
                    if fitted.aim > best.aim:
                        more = (fitted.gain - best.gain) / noise
                        fitted.grid, fitted.score = best.grid, best.score + more
                        best = fitted
                    return -fitted.aim

                scipy.optimize.minimize_scalar(
                    cost, bounds=bounds, method="bounded", options={"maxiter": 10}
                )
            if best.aim - before < noise:
                break
        return best

    def fit_again(self, candidate: Candidate, residual, chosen) -> Candidate | None:
        """The candidate refitted at its own shape, then refined; None where it is no longer physical."""
        basis, target = beside(chosen, residual)
        [block] = self.blocks(candidate.family, candidate.place, [candidate.shape])
        fitted = self._fit(candidate.family, candidate.place, block, basis, target)
        if fitted is None:
            return None
        fitted.grid, fitted.score = candidate.grid, candidate.score
        return self.refined(fitted, residual, chosen, 1.0)

    def _fit(
        self, family: Family, place: Place, block: Block, basis: np.ndarray, target: np.ndarray
    ) -> Candidate | None:
        """Least squares in θ; Gauss–Newton on the manifold of a body's change; none where the equation has no θ."""
        columns = block.columns
        free = columns - basis @ (basis.T @ columns) if basis.shape[1] else columns
        if family.slow:
            seen, sought = self.evidence.slow(free), self.evidence.slow(target[:, None])[:, 0]
        else:
            seen, sought = free, target
        raw = seen.T @ seen
        gram, cross = raw - block.gram, seen.T @ sought - block.cross
        if np.any(np.diagonal(gram) < MOSTLY_NOISE * np.diagonal(raw)):
            return None
        offset = np.zeros(len(target))
        if family.whole is not None:
            theta, gain = np.zeros(0), 2 * cross[0] - gram[0, 0]
            # How large it comes out if let free, within what chance does to it.
            if abs(cross[0] / gram[0, 0] - 1.0) > family.whole + 3.0 / np.sqrt(gram[0, 0]):
                return None
            columns, offset = np.zeros((len(target), 0)), columns[:, 0]
        elif family.size is None:
            theta = _least_norm(gram, cross)
            if theta is None:
                return None
            gain = 2 * cross @ theta - theta @ gram @ theta
        else:
            theta, gain = self._manifold(family, place, gram, cross)
            if theta is None:
                return None
            tangent = _tangent(lambda t: family.weights(self.context, place, t), theta)
            offset = columns @ family.weights(self.context, place, theta)
            columns = columns @ tangent
            offset = offset - columns @ theta
        aim = float(gain)
        if family.slow:
            # Numbers from the motion's band, what they bring from all of it.
            w = family.weights(self.context, place, theta)
            gain = 2 * w @ (free.T @ target) - w @ (free.T @ free) @ w
        if family.noisy(self.context):
            # Whatever its own noise excuses, it has to bring something.
            gain = min(gain, 2 * float(free[:, 0] @ target) - raw[0, 0])
        if min(aim, gain) <= 0 or not family.physical(self.context, place, block.shape, theta):
            return None
        if family.slow and aim < SEEN:
            return None
        return Candidate(family, place, block.shape, theta, columns, offset, 1, float(gain), aim)

    def _manifold(self, family: Family, place: Place, gram: np.ndarray, cross: np.ndarray):
        """min over θ of δπᵀ G δπ − 2 cᵀ δπ with δπ = weights(θ), by a few damped Gauss–Newton steps."""

        def change(t):
            return family.weights(self.context, place, t)

        def cost(t):
            d = change(t)
            return d @ gram @ d - 2 * cross @ d

        best, best_cost = None, 0.0
        # Where ten numbers free of each other would put it: from far away the descent may end beside the truth.
        for theta in family.starts(self.context, place, _least_norm(gram, cross)):
            damping, value = 1e-6, cost(theta)
            for _ in range(30):
                t = _tangent(change, theta)
                slope = t.T @ (cross - gram @ change(theta))
                hessian = t.T @ gram @ t
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
        return best, -best_cost


# A column of which less than this share of the energy is motion says nothing.
MOSTLY_NOISE = 0.2
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
