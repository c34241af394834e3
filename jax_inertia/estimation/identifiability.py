"""What a log says of inertial parameters: which it determines, which the prior does, and of which nothing speaks.

Whitened by the noise of its rows, a log is worth the information Λ = Σ Yᵀ R⁻¹ Y (Foster et al., eq. stacked and eq.
least-squares with W = R⁻¹). With a prior of covariance Σ, bodies are known to (Λ + Σ⁻¹)⁻¹. A parameter by itself is
often lost in a sum; `combinations` are the sums that the log does determine (base parameters, Gautier 1991).

    known = knowledge(robot, observation, ["hand"], fit.noise, prior=Load(3.0))
    print(known)
"""

import enum
import html
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_inertia.dynamics.rigid_body import resolve_bodies, torque_regressor
from jax_inertia.estimation.log_filter import regressors
from jax_inertia.estimation.priors import Uncertainty
from jax_inertia.maths import charts
from jax_inertia.maths.inertial_parameters import PI_NAMES
from jax_inertia.maths.least_squares import Identifiability, combinations, weighted_least_squares
from jax_inertia.model.robot import BALL, FREE, Robot
from jax_inertia.signals.differences import Observation

NARROWED = 0.5
"""The data determine what they narrow to less than this share of the prior's σ."""
_UNTOUCHED = 0.99


class Source(enum.StrEnum):
    """Whose word a parameter's value is."""

    DATA = "data"
    """The log narrows it to less than half of what the prior allows; without a prior, it fixes it alone."""
    PRIOR = "prior"
    """The log sees it, in a sum with others that the prior has to divide."""
    NOTHING = "nothing"
    """The log is silent: what comes out is what was put in."""


_COLOURS = {Source.DATA: "#cfe8f7", Source.PRIOR: "#fbe3b5", Source.NOTHING: "#dddddd"}


class Combination(eqx.Module):
    """A sum of parameters that the data determine."""

    text: str = eqx.field(static=True)
    """Such as 'hand.hz +0.31 hand.m'."""
    sigma: float = eqx.field(static=True)
    """Standard deviation with data and prior, in the unit of the first term."""
    prior_sigma: float = eqx.field(static=True)
    """The prior's alone; infinite without one."""


class Knowledge(eqx.Module):
    """Whose word each parameter of the chosen bodies is, and how well each is known."""

    bodies: tuple[str, ...] = eqx.field(static=True)
    source: tuple[tuple[Source, ...], ...] = eqx.field(static=True)
    """One row for each body, in the order of π."""
    sigma: Float[np.ndarray, "bodies 10"]
    """With data and prior; infinite where nothing speaks and no prior was given."""
    prior_sigma: Float[np.ndarray, "bodies 10"]
    combinations: tuple[Combination, ...]
    """What the data determine, best known first (in units of the prior)."""
    alone: Identifiability
    """Rank and null space of the data alone."""
    log_det: float = eqx.field(static=True)
    """½ log det (1 + Λ Σ): how much the log narrows the prior [nats]; NaN without a prior."""

    def of(self, source: Source) -> tuple[str, ...]:
        """Names ('hand.m') of the parameters whose value is that source's word."""
        return tuple(
            f"{body}.{name}"
            for body, row in zip(self.bodies, self.source, strict=True)
            for name, one in zip(PI_NAMES, row, strict=True)
            if one is source
        )

    def __repr__(self) -> str:
        wide = max(len(body) for body in self.bodies)
        lines = [" " * wide + "".join(f"{name:>9}" for name in PI_NAMES)]
        for body, row in zip(self.bodies, self.source, strict=True):
            lines.append(f"{body:>{wide}}" + "".join(f"{one:>9}" for one in row))
        count = len(self.combinations)
        lines.append(f"determined by the data: {count} of {len(self.alone.names)} combinations")
        lines += [f"  {c.text}  (± {c.sigma:.2g})" for c in self.combinations]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """For notebooks: the table coloured by source, and the sums that the data determine."""
        head = "".join(f"<th>{name}</th>" for name in PI_NAMES)
        body = "".join(
            f"<tr><th>{html.escape(body)}</th>"
            + "".join(
                f'<td style="background:{_COLOURS[one]};color:#000" title="± {sigma:.3g}">{one}</td>'
                for one, sigma in zip(row, spread, strict=True)
            )
            + "</tr>"
            for body, row, spread in zip(self.bodies, self.source, self.sigma, strict=True)
        )
        sums = "".join(
            f"<li>{html.escape(c.text)} (± {c.sigma:.2g})</li>" for c in self.combinations
        )
        return (
            f"<table><tr><th></th>{head}</tr>{body}</table>determined by the data:<ul>{sums}</ul>"
        )


def knowledge(
    robot: Robot,
    observation: Observation,
    bodies: Sequence[int | str],
    noise: Float[np.ndarray, " nv"] | float,
    *,
    prior: Uncertainty | None = None,
    bias: Float[np.ndarray, " nv"] | None = None,
) -> Knowledge:
    """What a log says of `bodies`, given the noise of one of its samples by row [N m, N].

    `noise` is that of independent samples, correlation taken in, as `BatchFit.noise` is. Raises ValueError for an
    unknown body, and for noise that is not positive.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import log_filter
    >>> from jax_inertia.estimation.identifiability import Source, knowledge
    >>> from jax_inertia.estimation.priors import Load
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> log = log_filter.observe(swing(load=0.5), robot)
    >>> knowledge(robot, log, ["lower"], 0.1, prior=Load(1.0)).of(Source.NOTHING)  # it swings in a plane
    ('lower.hy', 'lower.Ixx', 'lower.Ixy', 'lower.Ixz', 'lower.Iyz', 'lower.Izz')
    """
    y, _, valid = regressors(robot, observation, bodies, bias)
    sigma = np.broadcast_to(np.asarray(noise, float), (robot.nv,))
    if not np.all(sigma > 0):
        raise ValueError(f"noise is {sigma}; every row's must be positive")
    return of_rows(robot, y / sigma[:, None] * valid[..., None], bodies, prior=prior)


def of_rows(
    robot: Robot,
    whitened: Float[np.ndarray, "T nv n"],
    bodies: Sequence[int | str],
    *,
    prior: Uncertainty | None = None,
) -> Knowledge:
    """`knowledge` of regressors (n = 10 × bodies) in units of their rows' noise.

    >>> import numpy as np
    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation.identifiability import Source, of_rows
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> weighed = np.eye(1, 10).reshape(1, 1, 10) / 0.01  # a scale of 10 g: the mass, and nothing else
    >>> of_rows(load_model(double_pendulum()), weighed, ["lower"]).of(Source.DATA)
    ('lower.m',)
    """
    chosen = resolve_bodies(robot, bodies)
    names = _names(robot, chosen)
    rows = whitened.reshape(-1, whitened.shape[-1])
    fit = weighted_least_squares(rows, np.zeros(len(rows)), names=names)
    alone = fit.identifiability
    if prior is None:
        sigma = np.where(alone.determined, np.sqrt(np.diag(fit.covariance)), np.inf)
        determined = _determined(rows, 1.0 / _norms(rows), alone.rank, names, fit.covariance, None)
        ratio, prior_sigma, gain = np.where(alone.determined, 0.0, 1.0), np.inf * sigma, np.nan
    else:
        nominal = robot.pi[np.array(chosen)]
        blocks = np.asarray(prior.covariance(charts.Linear(), nominal))
        covariance = np.asarray(jax.scipy.linalg.block_diag(*blocks))
        prior_sigma = np.sqrt(np.diag(covariance))
        posterior, rank, gain = _posterior(rows, covariance)
        sigma = np.sqrt(np.diag(posterior))
        # What the prior holds fixed is the prior's word, though the data cannot narrow it.
        ratio = np.where(prior_sigma > 0, sigma / np.maximum(prior_sigma, 1e-300), NARROWED)
        determined = _determined(rows, prior_sigma, rank, names, posterior, covariance)
    sources = [
        Source.DATA if r < NARROWED else Source.PRIOR if r < _UNTOUCHED else Source.NOTHING
        for r in ratio
    ]
    return Knowledge(
        bodies=tuple(robot.body_names[i] for i in chosen),
        source=tuple(tuple(sources[k : k + 10]) for k in range(0, len(sources), 10)),
        sigma=sigma.reshape(-1, 10),
        prior_sigma=prior_sigma.reshape(-1, 10),
        combinations=tuple(determined),
        alone=alone,
        log_det=float(gain),
    )


def structure(robot: Robot, bodies: Sequence[int | str] | None = None) -> Identifiability:
    """What the best of motions could determine of `bodies` (default: all): rank by structure, free of any log.

    From regressors at random states, far from each other and fast; joint limits are left aside. A floating base is
    taken to be measured with the wrench that holds it.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation.identifiability import structure
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> structure(load_model(double_pendulum()))
    Identifiability(rank 6 of 20; 4 determined alone, 3 only in combination, 13 invisible)
    """
    chosen = resolve_bodies(robot, bodies)
    count = 40 + 20 * len(chosen)
    rng = np.random.default_rng(0)
    q = rng.uniform(-np.pi, np.pi, size=(count, robot.nq))
    for kind, address in zip(robot.joint_type, robot.joint_qposadr, strict=True):
        if kind in (FREE, BALL):
            at = address + (3 if kind == FREE else 0)
            quat = rng.normal(size=(count, 4))
            q[:, at : at + 4] = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    v, a = rng.normal(size=(2, count, robot.nv)) * [[[3.0]], [[10.0]]]
    y = np.asarray(_stacked(robot, jnp.asarray(q), jnp.asarray(v), jnp.asarray(a), chosen))
    rows = y.reshape(-1, 10 * len(chosen))
    names = _names(robot, chosen)
    return weighted_least_squares(rows, np.zeros(len(rows)), names=names).identifiability


@eqx.filter_jit
def _stacked(robot: Robot, q, v, a, chosen: tuple[int, ...]):
    return jax.vmap(lambda q, v, a: torque_regressor(robot, q, v, a, chosen))(q, v, a)


def _names(robot: Robot, chosen: tuple[int, ...]) -> list[str]:
    return [f"{robot.body_names[i]}.{name}" for i in chosen for name in PI_NAMES]


def _posterior(rows: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, int, float]:
    """((Λ + Σ⁻¹)⁻¹, number of directions narrowed to less than `NARROWED`, ½ log det (1 + Λ Σ))."""
    # A prior without spread somewhere (a massless frame) has no Cholesky factor; eigenvectors serve as well.
    value, vector = np.linalg.eigh(covariance)
    root = vector * np.sqrt(np.maximum(value, 0.0))
    r = np.asarray(np.linalg.qr(rows @ root, mode="r"))
    _, s, vt = np.linalg.svd(r)
    shrink = np.ones(len(root))
    shrink[: len(s)] = 1.0 / np.sqrt(1.0 + s**2)
    half = root @ vt.T * shrink
    return half @ half.T, int(np.sum(shrink < NARROWED)), -float(np.sum(np.log(shrink)))


def _norms(rows: np.ndarray) -> np.ndarray:
    """Length of each column, one for columns that are zero."""
    size = np.linalg.norm(rows, axis=0)
    return np.where(size > 1e-8 * max(size.max(initial=0.0), 1e-300), size, 1.0)


def _determined(
    rows: np.ndarray,
    unit: np.ndarray,
    rank: int,
    names: list[str],
    posterior: np.ndarray,
    prior: np.ndarray | None,
) -> list[Combination]:
    """The sums that the data narrow, each by its text and what is known of it."""
    r = np.asarray(np.linalg.qr(rows * unit, mode="r"))
    out = []
    for text, w in combinations(r, unit, rank, names, least=0.02).items():
        before = np.inf if prior is None else float(np.sqrt(w @ prior @ w))
        out.append(Combination(text, float(np.sqrt(w @ posterior @ w)), before))
    return sorted(out, key=lambda c: c.sigma / c.prior_sigma)
