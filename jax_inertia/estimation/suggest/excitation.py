"""A motion that makes a robot's bodies known: optimised for information, within what the joints can do.

Each joint follows a finite Fourier series (Swevers et al. 1997, eq. 4), with ω = 2π / period,

    q(t) = q₀ + Σₖ (aₖ sin kωt − bₖ cos kωt) / kω,    Σₖ aₖ = 0,  Σₖ k bₖ = 0,

so that it starts and ends at rest in the same posture and can be repeated. What is maximised is the information that a
log of it adds to the prior, ½ log det (1 + Λ Σ) with Λ = Σ Yᵀ R⁻¹ Y (D-optimality; `identifiability`), by autodiff
through the regressor. Limits are soft while it is sought; the answer is then shrunk about q₀ until it keeps them all.
"""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
import scipy.optimize
from jaxtyping import Array, Bool, Float

from jax_inertia.dynamics import rigid_body
from jax_inertia.dynamics.rigid_body import resolve_bodies
from jax_inertia.estimation.identifiability import Knowledge, of_rows
from jax_inertia.estimation.priors import Load, Uncertainty
from jax_inertia.estimation.suggest.motion_limits import Limits
from jax_inertia.maths import charts
from jax_inertia.model.robot import HINGE, SLIDE, Robot
from jax_inertia.signals.torque_residual import FRICTION_VELOCITY

MOST_SAMPLES = 1_000_000
"""Of a motion: hours at rates that robots are driven at."""
SAMPLE_RATE = 20.0
"""Samples [1/s] that count as independent: twice the cutoff of `log_filter`."""
_CHECK_RATE = 200.0
_MARGIN = 0.97
_PENALTY = 3e4
_LEAST = 0.02


class Series(eqx.Module):
    """A finite Fourier series for every joint."""

    period: Float[Array, ""]
    centre: Float[Array, " n"]
    sine: Float[Array, "n k"]
    """aₖ [rad/s, m/s]."""
    cosine: Float[Array, "n k"]

    def at(
        self, time: Float[Array, " T"]
    ) -> tuple[Float[Array, "T n"], Float[Array, "T n"], Float[Array, "T n"]]:
        """(q, v, a) at these times [s]."""
        rate = 2 * jnp.pi / self.period * jnp.arange(1, self.sine.shape[1] + 1)
        s, c = jnp.sin(rate * time[:, None]), jnp.cos(rate * time[:, None])
        q = self.centre + (s / rate) @ self.sine.T - (c / rate) @ self.cosine.T
        v = c @ self.sine.T + s @ self.cosine.T
        return q, v, (c * rate) @ self.cosine.T - (s * rate) @ self.sine.T

    def scaled(self, share: float) -> "Series":
        """The same motion, smaller about its centre."""
        return Series(self.period, self.centre, share * self.sine, share * self.cosine)


class Suggestion(eqx.Module):
    """A motion to record, and what a log of it would say."""

    joint_names: tuple[str, ...] = eqx.field(static=True)
    series: Series
    time: Float[np.ndarray, " T"]
    q: Float[np.ndarray, "T n"]
    v: Float[np.ndarray, "T n"]
    a: Float[np.ndarray, "T n"]
    tau: Float[np.ndarray, "T n"]
    """Torque that the model needs for it, without the load [N m]."""
    known: Knowledge
    random: Knowledge
    """What a log of a random series, as large as the same limits allow, would say: the median of the starts."""

    @property
    def log_det(self) -> float:
        """How much a log of it narrows the prior [nats]."""
        return self.known.log_det

    def __repr__(self) -> str:
        span = f"{float(self.series.period):g} s, {len(self.joint_names)} joints"
        return (
            f"Suggestion({span}; narrows the prior by {self.log_det:.1f} nats, random motions by "
            f"{self.random.log_det:.1f})\n{self.known!r}"
        )


def suggest_motion(
    robot: Robot,
    bodies: Sequence[int | str],
    limits: Limits,
    *,
    prior: Uncertainty | None = None,
    noise: Float[np.ndarray, " nv"] | float | None = None,
    period: float = 10.0,
    harmonics: int = 6,
    starts: int = 3,
    steps: int = 150,
    rate: float = 100.0,
    clear: Callable[[Float[np.ndarray, "T n"]], Bool[np.ndarray, " T"]] | None = None,
    seed: int = 0,
    progress: Callable[[str], None] = lambda stage: None,
) -> Suggestion:
    """Optimise the motion most informative about `bodies`, within `limits`; the best of several starts.

    `prior` is how far they may be from the model (default: a load of a tenth of the robot), `noise` of one torque
    sample by row (default: 2 % of the torque limit, 1 N m where there is none). Torques are those of the model as it
    is: leave room in `limits` for the load. `clear` says which postures are free of collisions. `rate` [Hz] is that of
    the samples given back. Raises ValueError for a robot whose joints are not all hinges and slides, and where not
    even the middle posture keeps the limits.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation.suggest.motion_limits import Limits
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> from jax_inertia.estimation.suggest.excitation import suggest_motion
    >>> robot, limits = load_model(double_pendulum()), Limits.of(double_pendulum(), velocity=2.0)
    >>> found = suggest_motion(robot, ["lower"], limits, period=4.0, starts=1, steps=10)
    >>> found.q.shape, bool(abs(found.v).max() <= 2.0)
    ((401, 2), True)
    """
    _require_motion(robot, period, harmonics, starts, rate)
    limits = limits.fitting(robot)
    prior = Load(0.1 * float(jnp.sum(robot.pi[:, 0]))) if prior is None else prior
    if noise is None:
        noise = np.where(np.isfinite(limits.torque), 0.02 * limits.torque, 1.0)
    task = _task(robot, bodies, limits, prior, noise, period, harmonics)
    rng = np.random.default_rng(seed)
    best, random = None, []
    for k in range(starts):
        progress(f"optimising, start {k + 1} of {starts}")
        x = rng.normal(size=(robot.nv, task.width)) / np.sqrt(2 * harmonics)
        x[:, 0] = np.clip(0.3 * x[:, 0], -0.5, 0.5)
        # As large as the limits allow too: a fair rival.
        random.append(_within(task, limits, clear, np.column_stack([x[:, :1], 4.0 * x[:, 1:]])))
        found = scipy.optimize.minimize(
            lambda flat: _value_and_slope(task, flat),
            x.ravel(),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": steps, "maxcor": 20},
        )
        series = _within(task, limits, clear, found.x.reshape(x.shape))
        value = float(_gain(task, series))
        if best is None or value > best[0]:
            best = (value, series)
    assert best is not None
    random.sort(key=lambda series: float(_gain(task, series)))
    usual = _known(task, random[len(random) // 2], prior)
    return _suggestion(task, best[1], _known(task, best[1], prior), usual, rate)


def _require_motion(robot: Robot, period: float, harmonics: int, starts: int, rate: float) -> None:
    """ValueError for what no motion can be made of."""
    if not all(kind in (HINGE, SLIDE) for kind in robot.joint_type):
        raise ValueError(
            "a motion is suggested for hinge and slide joints only; fix the base (a model of the arm alone)"
        )
    if period <= 0 or harmonics < 2 or starts < 1:
        raise ValueError(
            f"period {period:g} s, {harmonics} harmonics, {starts} starts; expected a period above 0, two harmonics "
            "and one start at least"
        )
    if not 2 <= rate * period <= MOST_SAMPLES:
        raise ValueError(
            f"{period:g} s at {rate:g} Hz are {rate * period:.3g} samples; a motion has from 2 to {MOST_SAMPLES}"
        )


def _task(
    robot: Robot,
    bodies: Sequence[int | str],
    limits: Limits,
    prior: Uncertainty,
    noise: Float[np.ndarray, " nv"] | float,
    period: float,
    harmonics: int,
) -> "_Task":
    chosen = resolve_bodies(robot, bodies)
    if not chosen:
        raise ValueError("no body is named; name at least one")
    blocks = prior.covariance(charts.Linear(), robot.pi[np.array(chosen)])
    return _Task(
        robot=robot,
        root=jnp.asarray(np.linalg.cholesky(jax.scipy.linalg.block_diag(*blocks))),
        sigma=jnp.asarray(np.broadcast_to(np.asarray(noise, float), (robot.nv,))),
        low=jnp.asarray(limits.low),
        high=jnp.asarray(limits.high),
        velocity=jnp.asarray(limits.velocity),
        torque=jnp.asarray(limits.torque),
        period=jnp.asarray(period),
        bodies=chosen,
        harmonics=harmonics,
        samples=max(round(SAMPLE_RATE * period), 4 * harmonics),
    )


class _Task(eqx.Module):
    """All that the optimisation looks at."""

    robot: Robot
    root: Float[Array, "p p"]
    """Cholesky factor of the prior's covariance."""
    sigma: Float[Array, " nv"]
    low: Float[Array, " nv"]
    high: Float[Array, " nv"]
    velocity: Float[Array, " nv"]
    torque: Float[Array, " nv"]
    period: Float[Array, ""]
    bodies: tuple[int, ...] = eqx.field(static=True)
    harmonics: int = eqx.field(static=True)
    samples: int = eqx.field(static=True)

    @property
    def width(self) -> int:
        """Unknowns of a joint: its centre, and what the two conditions leave of 2 K coefficients."""
        return 1 + 2 * (self.harmonics - 1)

    def series(self, x: Float[Array, "n w"]) -> Series:
        """The series of unknowns in units of the limits."""
        k = np.arange(1, self.harmonics + 1)
        half = 0.5 * (self.high - self.low)
        middle = 0.5 * (self.high + self.low)
        sine, cosine = (
            self.velocity[:, None] * part @ scipy.linalg.null_space(row[None]).T
            for part, row in zip(jnp.split(x[:, 1:], 2, axis=1), (np.ones(len(k)), k), strict=True)
        )
        return Series(self.period, middle + half * x[:, 0], sine, cosine)

    def times(self) -> Float[Array, " T"]:
        """When the motion is looked at [s]."""
        return jnp.arange(self.samples) / self.samples * self.period

    def look(self, state: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """(whitened regressors in units of the prior (T, nv, p), torque (T, nv)) of a batch of states."""

        def one(x):
            q, v, a = x
            y, nominal = rigid_body.condensed_dynamics(self.robot, q, v, a, self.bodies)
            passive = rigid_body.passive_torque(
                self.robot, q, v, friction_velocity=FRICTION_VELOCITY
            )
            needed = jnp.einsum("vbp,bp->v", y, self.robot.pi[np.array(self.bodies)]) + nominal
            rows = y.reshape(len(self.sigma), -1) @ self.root / self.sigma[:, None]
            return rows, needed - passive

        return jax.vmap(one)(state)

    def gain(self, rows: Float[Array, "T nv p"]) -> Float[Array, ""]:
        """½ log det (1 + Λ Σ)."""
        flat = rows.reshape(-1, rows.shape[-1])
        lower = jnp.linalg.cholesky(flat.T @ flat + jnp.eye(flat.shape[1]))
        return jnp.sum(jnp.log(jnp.diagonal(lower)))


# Called a few times each: without optimisation they compile in half the time.
_QUICK = {"xla_backend_optimization_level": 0}
_look_at_block = eqx.filter_jit(_Task.look, compiler_options=_QUICK)  # pyright: ignore[reportCallIssue]


def _look(task: _Task, state: tuple[Array, Array, Array]) -> tuple[np.ndarray, np.ndarray]:
    """`_Task.look` in blocks of `task.samples`, the last one filled up with its last state.

    A motion is looked at on three grids, and compiling takes longer than all of them together: blocks compile once.
    """
    length, size = len(state[0]), task.samples
    filled = [np.pad(x, ((0, -length % size), (0, 0)), mode="edge") for x in map(np.asarray, state)]
    parts = [
        _look_at_block(task, tuple(jnp.asarray(x[start : start + size]) for x in filled))
        for start in range(0, length, size)
    ]
    rows, torque = (np.concatenate(part)[:length] for part in zip(*parts, strict=True))
    return rows, torque


def _gain(task: _Task, series: Series) -> Float[Array, ""]:
    return task.gain(jnp.asarray(_look(task, series.at(task.times()))[0]))


@eqx.filter_jit
def _sought(x: Float[Array, "n w"], task: _Task) -> tuple[Array, Array]:
    def loss(x):
        q, v, a = task.series(x).at(task.times())
        rows, torque = task.look((q, v, a))
        half, middle = 0.5 * (task.high - task.low), 0.5 * (task.high + task.low)
        used = [(q - middle) / half, v / task.velocity, torque / task.torque]
        beyond = sum(jnp.sum(jnp.mean(jax.nn.relu(jnp.abs(u) - _MARGIN) ** 2, 0)) for u in used)
        return _PENALTY * beyond - task.gain(rows)

    return jax.value_and_grad(loss)(x)


def _value_and_slope(task: _Task, flat: np.ndarray) -> tuple[float, np.ndarray]:
    value, slope = _sought(jnp.asarray(flat.reshape(task.robot.nv, -1)), task)
    return float(value), np.asarray(slope, float).ravel()


def _within(task: _Task, limits: Limits, clear: Callable | None, x: np.ndarray) -> Series:
    """The series of x, as large about its centre as the limits allow at every moment of it."""
    centre = np.clip(x[:, 0], -1.0, 1.0)
    series = task.series(jnp.asarray(np.column_stack([centre, x[:, 1:]])))
    time = jnp.arange(round(_CHECK_RATE * float(task.period))) / _CHECK_RATE
    share, broken = 1.0, ""
    while share > _LEAST:
        trial = series.scaled(share)
        state = trial.at(time)
        q, v, torque = (np.asarray(x) for x in (*state[:2], _look(task, state)[1]))
        broken = limits.broken(q, v, torque, task.robot.joint_names)
        if not broken and clear is not None and not np.all(clear(q)):
            broken = "it collides"
        if not broken:
            return trial
        share *= 0.95
    raise ValueError(
        f"no motion about the posture {np.asarray(series.centre).round(3)} keeps the limits: {broken}"
    )


def _known(task: _Task, series: Series, prior: Uncertainty) -> Knowledge:
    rows, _ = _look(task, series.at(task.times()))
    return of_rows(task.robot, rows @ np.linalg.inv(task.root), task.bodies, prior=prior)


def _suggestion(
    task: _Task, series: Series, known: Knowledge, random: Knowledge, rate: float
) -> Suggestion:
    time = jnp.arange(round(rate * float(task.period)) + 1) / rate
    q, v, a = series.at(time)
    return Suggestion(
        joint_names=task.robot.joint_names,
        series=series,
        time=np.asarray(time),
        q=np.asarray(q),
        v=np.asarray(v),
        a=np.asarray(a),
        tau=_look(task, (q, v, a))[1],
        known=known,
        random=random,
    )
