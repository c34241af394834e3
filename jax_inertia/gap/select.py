"""Which effects: every candidate at every place, forward with joint refits, then backward and swaps.

A candidate's score is the drop of the charged misfit J it brings to those already chosen, against the noise the data
still show, less the price of its numbers: ΔJ/s² − p ln n − 2 ln(grid).
"""

import dataclasses

import numpy as np
import scipy.optimize
from jaxtyping import Float

from jax_inertia.gap import locate
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
    score: float = -np.inf

    @property
    def key(self) -> tuple[str, str, str]:
        return self.family.name, self.place.kind, self.place.name

    @property
    def effect(self) -> Float[np.ndarray, " n"]:
        """e in the charged metric."""
        return self.offset + self.columns @ self.theta

    @property
    def size(self) -> int:
        """Numbers that were free: θ and the shape, details such as presliding apart."""
        free = self.family.free_shape
        return len(self.theta) + (len(self.shape) if free is None else free)


class Pool:
    """All candidates of a log, their columns computed once."""

    def __init__(self, context: Context, evidence: Evidence, library: list[Family]):
        self.context, self.evidence = context, evidence
        self.library = library
        self.entries: list[tuple[Family, Place, list[tuple[Shape, np.ndarray]]]] = []
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
            blocks = []
            for shape in family.shapes(self.context, place):
                block = self.evidence.column(family.columns(self.context, place, shape))
                if np.isfinite(block).all() and np.sum(block**2) > 1e-12:
                    blocks.append((shape, block))
            if blocks:
                self.entries.append((family, place, blocks))

    def best(
        self, residual: Float[np.ndarray, " n"], chosen: Float[np.ndarray, "n s"], noise: float
    ) -> list[Candidate]:
        """Every candidate fitted to a residual beside the chosen columns, best score first."""
        n = self.evidence.rows
        basis = np.linalg.qr(chosen)[0] if chosen.shape[1] else chosen
        target = residual - basis @ (basis.T @ residual)
        out = []
        for family, place, blocks in self.entries:
            top = None
            for shape, block in blocks:
                free = block - basis @ (basis.T @ block) if basis.shape[1] else block
                fitted = self._fit(family, place, shape, block, free, target)
                if fitted is None:
                    continue
                if top is None or fitted.gain > top.gain:
                    top = fitted
            if top is None:
                continue
            top.grid = len(blocks)
            if family.passing:
                # Windows were picked from all there are: (duration / 0.1 s)² of them, about.
                top.grid = max(2, round((self.context.time[-1] / 0.1) ** 2))
            price = top.size * np.log(n) + (2 * np.log(top.grid) if top.grid > 1 else 0.0)
            top.score = top.gain / noise - price
            out.append(top)
        return sorted(out, key=lambda c: -c.score)

    def refined(self, candidate: Candidate, residual, chosen, noise) -> Candidate:
        """The same candidate with its shape between grid points, one number after the other."""
        family, place = candidate.family, candidate.place
        if not candidate.shape:
            return candidate
        basis = np.linalg.qr(chosen)[0] if chosen.shape[1] else chosen
        target = residual - basis @ (basis.T @ residual)
        best = candidate
        for _ in range(2):
            before = best.gain
            for axis in range(len(best.shape)):
                bounds = family.around(self.context, place, best.shape)[axis]
                if bounds[1] <= bounds[0]:
                    continue

                def cost(x, axis=axis):
                    nonlocal best
                    shape = (*best.shape[:axis], float(x), *best.shape[axis + 1 :])
                    block = self.evidence.column(family.columns(self.context, place, shape))
                    free = block - basis @ (basis.T @ block) if basis.shape[1] else block
                    fitted = self._fit(family, place, shape, block, free, target)
                    if fitted is None:
                        return 0.0
                    if fitted.gain > best.gain:
                        more = (fitted.gain - best.gain) / noise
                        fitted.grid, fitted.score = best.grid, best.score + more
                        best = fitted
                    return -fitted.gain

                scipy.optimize.minimize_scalar(
                    cost, bounds=bounds, method="bounded", options={"maxiter": 10}
                )
            if best.gain - before < noise:
                break
        return best

    def fit_again(self, candidate: Candidate, residual, chosen) -> Candidate | None:
        """The candidate refitted at its own shape, then refined; None where it is no longer physical."""
        family, place = candidate.family, candidate.place
        columns = family.columns(self.context, place, candidate.shape)
        block = self.evidence.column(columns)
        basis = np.linalg.qr(chosen)[0] if chosen.shape[1] else chosen
        free = block - basis @ (basis.T @ block) if basis.shape[1] else block
        target = residual - basis @ (basis.T @ residual) if basis.shape[1] else residual
        fitted = self._fit(family, place, candidate.shape, block, free, target)
        if fitted is None:
            return None
        fitted.grid, fitted.score = candidate.grid, candidate.score
        return self.refined(fitted, residual, chosen, 1.0)

    def _fit(self, family, place, shape, block, free, target) -> Candidate | None:
        """Least squares in θ; Gauss–Newton on the manifold of a body's change."""
        gram, cross = free.T @ free, free.T @ target
        if family.size is None:
            theta = _least_norm(gram, cross)
            if theta is None:
                return None
            gain = 2 * cross @ theta - theta @ gram @ theta
            columns, offset = block, np.zeros(len(target))
        else:
            theta, gain = self._manifold(family, place, gram, cross)
            if theta is None:
                return None
            tangent = _tangent(lambda t: family.change(self.context, place, t), theta)
            columns = block @ tangent
            offset = block @ family.change(self.context, place, theta) - columns @ theta
        if gain <= 0 or not family.physical(self.context, place, shape, theta):
            return None
        return Candidate(family, place, shape, theta, columns, offset, 1, float(gain))

    def _manifold(self, family, place, gram, cross):
        """min over θ of δπᵀ G δπ − 2 cᵀ δπ with δπ = change(θ), by a few damped Gauss–Newton steps."""

        def change(t):
            return family.change(self.context, place, t)

        def cost(t):
            d = change(t)
            return d @ gram @ d - 2 * cross @ d

        best, best_cost = None, 0.0
        starts = [np.zeros(family.size)]
        if family.name == "payload":
            scale = max(float(self.context.robot.pi[place.index, 0]), 0.1)
            starts = [np.concatenate([[m * scale], np.zeros(3)]) for m in (0.05, 0.3, 1.0)]
            # Where ten numbers free of each other would put it: from m alone, the descent may end beside the mass.
            free = _least_norm(gram, cross)
            if free is not None and free[0] > 0:
                starts.append(np.concatenate([free[:1], free[1:4] / free[0]]))
        elif family.name == "link_inertia":
            starts = [np.array([0.1])]
        for theta in starts:
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


def select(
    pool: Pool, max_effects: int, floor: float
) -> tuple[list[Candidate], list[Candidate], list[float]]:
    """(chosen effects, the first step's ranking, misfit J after 0, 1, 2 ... effects).

    `floor` is the J that noise alone would have.
    """
    y = pool.evidence.y
    chosen: list[Candidate] = []
    misfits = [float(y @ y)]
    ranking: list[Candidate] = []
    while len(chosen) < max_effects:
        pool.look_again(locate.windows(pool.evidence, _remaining(pool, chosen), floor))
        step = propose(pool, chosen, floor)
        if not chosen:
            ranking = step
        # Whitening is itself estimated: once a cause is found, structure in a hundredth of the noise is none.
        if not step or step[0].score < STOP + (0.01 * floor if chosen else 0.0):
            break
        trial = settle(pool, [*chosen, step[0]])
        if len(trial) > 1:
            trial = swap(pool, prune(pool, trial, floor), floor)
            after = misfit(pool, trial)
            # Significance is not materiality: beside a large effect, the error of its own equation is significant.
            if len(trial) <= len(chosen) or misfits[-1] - after < allowance(pool, chosen, trial):
                break
        chosen = trial
        misfits.append(misfit(pool, chosen))
    return chosen, ranking, misfits


def _remaining(pool: Pool, chosen: list[Candidate]) -> np.ndarray:
    """What the chosen effects leave, in the charged metric."""
    columns, target = _stacked(pool, chosen)
    if not columns.shape[1]:
        return target
    return target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]


# An effect must bring this much score (twice the log of the odds, about) to be added to what is chosen.
STOP = 30.0


def _redness(pool: Pool, chosen: list[Candidate], added: Candidate) -> float:
    """How many samples of what is left count as one: (1 + ρ)/(1 − ρ) of its lag-one correlation ρ."""
    left = pool.evidence.unflatten(_remaining(pool, [*chosen, added]))
    rho = float(np.sum(left[1:] * left[:-1]) / max(float(np.sum(left**2)), 1e-300))
    rho = min(max(rho, 0.0), 0.9)
    return (1 + rho) / (1 - rho)


def allowance(pool: Pool, chosen: list[Candidate], trial: list[Candidate]) -> float:
    """Misfit that the equations of the `chosen` may leave in the rows where what is new in `trial` acts."""
    old = {c.key for c in chosen}
    new = [_row_energy(pool, c) for c in trial if c.key not in old]
    if not new:
        return np.inf
    acts = np.max(new, axis=0) > 0.05 * np.max(new)
    total = 0.0
    for c in chosen:
        energy = _row_energy(pool, c)
        share = energy[acts].sum() / max(energy.sum(), 1e-300)
        total += c.family.form_error**2 * share * float(c.effect @ c.effect)
    return total


def _row_energy(pool: Pool, c: Candidate) -> np.ndarray:
    """Energy of an effect on each row, in units of the row's noise."""
    context = pool.context
    columns = c.family.columns(context, c.place, c.shape)
    change = c.family.change(context, c.place, c.theta)
    values = columns.values @ (c.theta if change is None else change)
    out = np.zeros(context.robot.nv)
    sigma = pool.evidence.whitener.sigma
    if columns.row is None:
        return np.mean(values**2, axis=0) / sigma**2
    out[columns.row] = np.mean(values**2) / sigma[columns.row] ** 2
    return out


def propose(pool: Pool, chosen: list[Candidate], floor: float) -> list[Candidate]:
    """Candidates to add, best first, the leading ones refined; simpler families first where they do as well."""
    columns, target = _stacked(pool, chosen)
    n = pool.evidence.rows
    own = {c.key for c in chosen}
    ranked = [c for c in pool.best(target, columns, 1.0) if c.key not in own]
    if not ranked:
        return []
    before = misfit(pool, chosen)
    noise = max(1.0, (before - max(c.gain for c in ranked)) / max(floor, 1.0))
    noise *= _redness(pool, chosen, max(ranked, key=lambda c: c.gain)) if noise > 1.2 else 1.0
    for c in ranked:
        price = c.size * np.log(n) + (2 * np.log(c.grid) if c.grid > 1 else 0.0)
        c.score = (c.gain - c.family.noise_share * floor) / noise - price
    ranked.sort(key=lambda c: -c.score)
    # Between grid points a candidate gains some; one that is far behind does not catch up.
    near = [c for c in ranked[:8] if c.score > 0.25 * ranked[0].score]
    lead = [pool.refined(c, target, columns, noise) for c in near]
    ranked = sorted([*lead, *ranked[len(near) :]], key=lambda c: -c.score)
    return _parsimonious(ranked, before, floor)


def _parsimonious(ranked: list[Candidate], before: float, floor: float) -> list[Candidate]:
    """Move a simpler family ahead of the leader where it explains nearly as much *and* fits nearly as well."""
    best = ranked[0]
    for c in ranked[1:]:
        if c.place != best.place or c.family.name not in best.family.simpler:
            continue
        noise = max(1.0, (before - best.gain) / max(floor, 1.0))
        if best.gain - c.gain < max(STOP * noise, 5e-4 * best.gain) and c.score > STOP:
            return [c, *(x for x in ranked if x is not c)]
    return ranked


def settle(pool: Pool, chosen: list[Candidate]) -> list[Candidate]:
    """Refit all numbers together: each in turn against what the others leave, then all θ at once."""
    for _ in range(3 if len(chosen) > 1 else 1):
        for i, c in enumerate(chosen):
            others = [x for k, x in enumerate(chosen) if k != i]
            columns, target = _stacked(pool, others)
            refit = pool.fit_again(c, target, columns)
            if refit is not None:
                chosen = [refit if k == i else x for k, x in enumerate(chosen)]
        columns, target = _stacked(pool, chosen)
        theta = np.linalg.lstsq(columns, target, rcond=None)[0]
        parts = np.split(theta, np.cumsum([len(c.theta) for c in chosen])[:-1])
        if all(
            c.family.physical(pool.context, c.place, c.shape, x)
            for c, x in zip(chosen, parts, strict=True)
        ):
            for c, x in zip(chosen, parts, strict=True):
                c.theta = x
    return chosen


def prune(pool: Pool, chosen: list[Candidate], floor: float) -> list[Candidate]:
    """Drop effects that the others have made redundant."""
    while len(chosen) > 1:
        full = misfit(pool, chosen)
        noise = max(1.0, full / max(floor, 1.0))
        worth = []
        for i, c in enumerate(chosen):
            rest = [x for k, x in enumerate(chosen) if k != i]
            price = c.size * np.log(pool.evidence.rows)
            drop = misfit(pool, rest) - full - allowance(pool, rest, chosen)
            worth.append(drop / noise - price)
        weakest = int(np.argmin(worth))
        if worth[weakest] >= STOP:
            break
        chosen = settle(pool, [x for k, x in enumerate(chosen) if k != weakest])
    return chosen


def swap(pool: Pool, chosen: list[Candidate], floor: float) -> list[Candidate]:
    """Try each chosen effect's place for another: forward steps alone lose the smaller of two."""
    for _ in range(2):
        improved = False
        for i in range(len(chosen)):
            others = [x for k, x in enumerate(chosen) if k != i]
            options = propose(pool, others, floor)
            if not options or options[0].key == chosen[i].key:
                continue
            trial = settle(pool, [*others[:i], options[0], *others[i:]])
            if misfit(pool, trial) < misfit(pool, chosen) - STOP:
                chosen, improved = trial, True
        if not improved:
            break
    return chosen


def misfit(pool: Pool, chosen: list[Candidate]) -> float:
    """J with all θ free and the shapes as they are."""
    columns, target = _stacked(pool, chosen)
    if not columns.shape[1]:
        return float(target @ target)
    theta = np.linalg.lstsq(columns, target, rcond=None)[0]
    return float(np.sum((target - columns @ theta) ** 2))


def _stacked(pool: Pool, chosen: list[Candidate]) -> tuple[np.ndarray, np.ndarray]:
    y = pool.evidence.y
    if not chosen:
        return np.zeros((len(y), 0)), y
    columns = np.concatenate([c.columns for c in chosen], axis=1)
    return columns, y - np.sum([c.offset for c in chosen], axis=0)


def _least_norm(gram: np.ndarray, cross: np.ndarray) -> np.ndarray | None:
    """θ of the normal equations; directions that do nothing (a force across a planar arm) stay zero."""
    scale = np.sqrt(np.diagonal(gram))
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


def _tangent(change, theta: np.ndarray) -> np.ndarray:
    """∂(change)/∂θ by central differences; `change` is at most cubic, so the step may be large."""
    out = []
    for k in range(len(theta)):
        h = np.zeros(len(theta))
        h[k] = 1e-4 * max(1.0, abs(theta[k]))
        out.append((change(theta + h) - change(theta - h)) / (2 * h[k]))
    return np.stack(out, axis=1)
