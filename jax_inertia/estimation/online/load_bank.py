"""Which link took up or put down a load, when, and how sure: a bank of hypotheses with one filter.

    bank = make_load_bank(robot, ["torso", "left_forearm", "right_forearm"], sigma_tau=0.5, load=Load(5.0))
    state = bank.initial()
    state, seen = eqx.filter_jit(bank.step)(state, observation, dt)
    seen.probability            # of no change, then of each of `bank.candidates`

Hypothesis (h, t₀): since t₀ the links of h carry Δπ_h more than the filter believes, Δπ_h ~ N(0, Σ) of the size of the
load expected; the others are as believed. Torque is linear in π, so that every sample's likelihood is a quadratic in
Δπ, and a window's are one matrix and one vector,

    Λ = Σ_k Yᵀ R⁻¹ Y,    η = Σ_k Yᵀ R⁻¹ (Δτ − Y π̂),

whatever the links: the bank of filters, one for each candidate and time of change, shares them, and with
Δπ ~ N(0, C) its evidence is

    log p(data | C) / p(data | Δπ = 0) = ½ ηᵀ (Λ + C⁻¹)⁻¹ η − ½ log det(1 + C Λ),

C being P, the filter's own covariance, without a change and P + Σ_h with one: what an estimate still errs by is no
load. Their difference is the Bayes factor of a change at t₀ over the same samples (Willsky and Jones 1976; Adams and
MacKay 2007). With changes coming at `rate`, each to one link or to several with one cause, these are posterior
probabilities. Once one is beyond `threshold`, its links are opened in the filter (their covariance grows by the
load's), and all others keep resting.

Two things would make such evidence lie. Shocks: "no change" and a load are compared by samples that may be garbage, a
mixture of the noise stated and of noises 10 to 1000 times as large. One sample that no belief explains is then as
likely a shock as a load, and a second one is a load. And residuals that are not white: evidence counts the effective
number of samples, (1 − r) / (1 + r) of them at the correlation r of neighbouring residuals, and their size is that of
the last seconds where it is above the one stated. The filter takes its samples with the same weights.
"""

import itertools
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jax_inertia.dynamics.rigid_body import mass_matrix, resolve_bodies
from jax_inertia.dynamics.sparse_rows import moved_rows
from jax_inertia.estimation.inertial_filter import Estimator, State, make_estimator
from jax_inertia.estimation.priors import Load
from jax_inertia.maths import inertial_parameters
from jax_inertia.maths.argument_checks import floats_as, is_positive, require
from jax_inertia.maths.charts import LogCholeskyUUt
from jax_inertia.maths.gates import FixedGate
from jax_inertia.maths.kalman import Belief, cholesky
from jax_inertia.maths.noise import Noise
from jax_inertia.maths.precision import in_full_precision
from jax_inertia.maths.sample_weight import mixture
from jax_inertia.model.robot import Robot
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.window_mean import jerk_since, mean_residual


class BankState(eqx.Module):
    """What is carried from one sample to the next."""

    filter: State
    information: Float[Array, "windows n n"]
    """Λ of every window, for π of all links together; the last window began when a change was noticed."""
    vector: Float[Array, "windows n"]
    """Σ Yᵀ R⁻¹ Δτ of every window; η is this less Λ π̂."""
    lost: Float[Array, " windows"]
    """log-likelihood of Gaussian noise less that of the mixture, summed: what shocks are forgiven."""
    age: Float[Array, " windows"]
    """Time since each window began [s]."""
    size: Float[Array, ""]
    """Variance ratio of the last seconds' residuals, 1 where the noise is as stated."""
    last: Float[Array, " nv"]
    """Whitened residual of the sample before."""
    product: Float[Array, ""]
    """Mean product of neighbouring whitened residuals."""
    rest: Float[Array, ""]
    """How long the filter still needs for what was opened last [s]."""
    acceleration: Float[Array, " nv"]
    """Of the sample before, for how fast it changes; NaN where there was none."""
    expected: Float[Array, " n"]
    """Mean of Δπ of a change that has been noticed and not opened yet."""


class BankStep(eqx.Module):
    """What one sample gave."""

    probability: Float[Array, " candidates_and_none"]
    """Posterior of no change, then of a change of each candidate in the last `memory` seconds."""
    since: Float[Array, ""]
    """Time since the change by the best hypothesis [s]."""
    opened: Int[Array, ""]
    """Index of the candidate that was opened by this sample; −1: none."""
    weight: Float[Array, ""]
    """How much the sample counted, in parts of a good one."""
    pi: Float[Array, "links 10"]
    """The filter's estimate."""


class LoadBank(eqx.Module):
    """Settings and the filter; immutable. Make one with `make_load_bank`."""

    estimator: Estimator
    spread: Float[Array, "n n"]
    """Root of the covariance of the loads' π, each about its link's centre of mass."""
    opening: Float[Array, "links 10 10"]
    """By how much the covariance of each link grows when it is opened, in the chart's coordinates."""
    rate: Float[Array, ""]
    threshold: Float[Array, ""]
    memory: Float[Array, ""]
    settle: Float[Array, ""]
    confirm: Float[Array, ""]
    averaging: Float[Array, ""]
    candidates: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    """Links of each, by their place in `estimator.bodies`."""
    windows: int = eqx.field(static=True)

    def initial(self) -> BankState:
        """State before the first sample: nothing has changed."""
        state = self.estimator.initial()
        n, dtype = len(state.belief.mean), state.belief.mean.dtype
        one = jnp.ones((), dtype)
        count = self.windows + 1
        return BankState(
            filter=state,
            information=jnp.zeros((count, n, n), dtype),
            vector=jnp.zeros((count, n), dtype),
            lost=jnp.zeros(count, dtype),
            age=jnp.append(self._staggered(dtype), 0.0),
            size=one,
            last=jnp.zeros(self.estimator.robot.nv, dtype),
            product=0.0 * one,
            rest=0.0 * one,
            acceleration=jnp.full(self.estimator.robot.nv, jnp.nan, dtype),
            expected=jnp.zeros(n, dtype),
        )

    @in_full_precision
    def step(
        self, state: BankState, observation: Observation, dt: Float[Array, ""] | float
    ) -> tuple[BankState, BankStep]:
        """Take one sample that comes `dt` [s] after the one before."""
        own = self.estimator
        observation = floats_as(observation, own.robot.pi.dtype)
        a, dt = jnp.asarray(observation.a), jnp.asarray(dt, own.robot.pi.dtype)
        jerk = jerk_since(state.acceleration, a, dt)
        regressor, residual = mean_residual(
            own.robot, observation, own.bodies, state.filter.bias, jerk, dt
        )
        delta = -residual
        noise = own.noise
        if own.sigma_a is not None:
            # A load that is not in the filter yet has its share of the accelerations' noise already.
            pi = self._pi(state) + state.expected.reshape(-1, 10)
            believed = own.robot.believed(own.bodies, pi)
            inertia = mass_matrix(believed, jnp.asarray(observation.motion.q))
            spread = inertia * own.sigma_a
            noise = noise.plus(spread @ spread.T)
        valid = jnp.asarray(observation.motion.valid) & jnp.isfinite(delta)
        state = eqx.tree_at(lambda s: s.acceleration, state, a)
        return self.update(state, regressor, delta, valid, noise, dt)

    @in_full_precision
    def update(
        self,
        state: BankState,
        regressor: Float[Array, "nv links 10"],
        delta: Float[Array, " nv"],
        valid: Bool[Array, " nv"],
        noise: Noise,
        dt: Float[Array, ""] | float,
    ) -> tuple[BankState, BankStep]:
        """`step` for a regressor, Δτ and its noise computed before."""
        own, dt = self.estimator, jnp.asarray(dt, delta.dtype)
        used = valid & jnp.all(jnp.isfinite(regressor), axis=(1, 2))
        flat = jnp.where(used[:, None], regressor.reshape(len(delta), -1), 0.0)
        delta = jnp.where(used, delta, 0.0)
        pi = self._pi(state).ravel()
        counted = used.astype(delta.dtype)
        stacked = jnp.concatenate([flat, delta[:, None], (delta - flat @ pi)[:, None]], axis=1)
        white = noise.whiten(stacked, counted)
        h, z, left = white[:, :-2], white[:, -2], white[:, -1]

        rows = jnp.maximum(jnp.sum(counted), 1.0)
        left, h, z = (x * jax.lax.rsqrt(state.size) for x in (left, h, z))
        # As `gates.Reopening`: a sample none of whose rows the links move says nothing, for or against.
        tested = jnp.any(used[jnp.asarray(moved_rows(own.robot, own.bodies))])
        weight = jnp.where(tested, self._weight(state, h, left, rows), 0.0)
        lost = jnp.where(tested, -0.5 * left @ left - mixture(left @ left, rows)[0], 0.0)
        seen = self._remember(state, left, weight, rows, dt)
        state = jax.tree.map(lambda new, old: jnp.where(tested, new, old), seen, state)
        state = self._gather(state, h, z, lost, dt)
        probability, best, since = self._posterior(state, pi)
        noticed = probability[0] < 1.0 - self.threshold
        sure = (probability[best + 1] > self.threshold) & (state.age[-1] > self.confirm)
        # Links in every likely candidate do carry something, though more of them stay possible.
        common, is_one = self._common(probability)
        late = ~sure & is_one & (state.age[-1] > 0.5 * self.memory)
        best = jnp.where(late, common, best)
        opened = noticed & (sure | late) & (state.rest <= 0)
        state = eqx.tree_at(
            lambda s: s.age, state, state.age.at[-1].set(jnp.where(noticed, state.age[-1], 0.0))
        )
        expected = self._expected(state, pi, best)
        moved = self._opened(state.filter, best, opened, pi + expected)
        noise = noise.scaled(state.size / (jnp.maximum(weight, 1e-6) * _effective(state)))
        widened = eqx.tree_at(lambda e: e.noise, own, noise)
        after, _ = widened.update(moved, regressor, -delta, used, dt)
        rest = jnp.where(opened, self.settle, jnp.maximum(state.rest - dt, 0.0))
        expected = jnp.where(noticed & (rest <= 0), expected, 0.0)
        at = lambda s: (s.filter, s.rest, s.expected)  # noqa: E731
        state = eqx.tree_at(at, state, (after, rest, expected))
        estimate = own.chart.to_pi(after.belief.mean.reshape(-1, 10))
        none = jnp.asarray(-1, best.dtype)
        return state, BankStep(probability, since, jnp.where(opened, best, none), weight, estimate)

    def _pi(self, state: BankState) -> Float[Array, "links 10"]:
        """The filter's estimate."""
        return self.estimator.chart.to_pi(state.filter.belief.mean.reshape(-1, 10))

    def _weight(self, state: BankState, h: Array, left: Array, rows: Array) -> Float[Array, ""]:
        """What the filter takes the sample for, by the NIS of its own belief."""
        belief = state.filter.belief
        g = jax.scipy.linalg.block_diag(*self.estimator.chart.jacobian(belief.mean.reshape(-1, 10)))
        root = h @ g @ cholesky(belief.covariance)
        inner = jnp.eye(root.shape[1], dtype=h.dtype) + root.T @ root
        half = jax.scipy.linalg.solve_triangular(
            jnp.linalg.cholesky(inner), root.T @ left, lower=True
        )
        return mixture(jnp.maximum(left @ left - half @ half, 0.0), rows)[1]

    def _remember(
        self, state: BankState, left: Array, weight: Array, rows: Array, dt: Array
    ) -> BankState:
        """Size and correlation of the last seconds' residuals, shocks left out."""
        share = weight * jnp.minimum(dt / self.averaging, 1.0)
        size = state.size * (1.0 + share * (left @ left / rows - 1.0))
        product = state.product + share * (left @ state.last / rows - state.product)
        at = lambda s: (s.size, s.product, s.last)  # noqa: E731
        return eqx.tree_at(at, state, (jnp.maximum(size, 1.0), product, weight * left))

    def _gather(self, state: BankState, h: Array, z: Array, lost: Array, dt: Array) -> BankState:
        """The sample into every window; the oldest begins anew, and all wait while the filter settles."""
        age, still = state.age + dt, state.rest > 0
        # The last window waits for a change to be noticed, by this sample or an earlier one.
        waits = state.age[-1] <= 0
        anew = jnp.append(age[:-1] >= self.memory, waits) | still
        keep = jnp.where(anew, 0.0, 1.0)
        taken = jnp.ones_like(keep).at[-1].set(jnp.where(waits, 0.0, 1.0))
        information = keep[:, None, None] * state.information + taken[:, None, None] * (h.T @ h)
        vector = keep[:, None] * state.vector + taken[:, None] * (h.T @ z)
        lost = keep * state.lost + taken * lost
        turned = jnp.where(anew[:-1], age[:-1] - self.memory, age[:-1])
        turned = jnp.where(still, -self._staggered(age.dtype), turned)
        age = jnp.append(turned, jnp.where(still, 0.0, age[-1]))
        at = lambda s: (s.information, s.vector, s.lost, s.age)  # noqa: E731
        return eqx.tree_at(at, state, (information, vector, lost, age))

    def _staggered(self, dtype: jnp.dtype) -> Float[Array, " windows"]:
        """Ages at which one window is always about to begin anew."""
        return self.memory * jnp.arange(self.windows, dtype=dtype) / self.windows

    def _posterior(
        self, state: BankState, pi: Float[Array, " n"]
    ) -> tuple[Float[Array, " k"], Int[Array, ""], Float[Array, ""]]:
        """(probabilities of none and of each candidate, the best candidate, time since its change)."""
        effective = _effective(state)
        roots = self._roots_of(state)

        def evidence(information, vector, root):
            factor = jnp.linalg.cholesky(
                jnp.eye(len(root), dtype=pi.dtype) + root.T @ information @ root
            )
            half = jax.scipy.linalg.solve_triangular(factor, root.T @ vector, lower=True)
            return 0.5 * half @ half - jnp.sum(jnp.log(jnp.diagonal(factor)))

        left = effective * (state.vector - state.information @ pi) @ self.spread
        seen = effective * self.spread.T @ state.information @ self.spread
        over_roots = jax.vmap(evidence, in_axes=(None, None, 0))
        every_one = jax.vmap(over_roots, in_axes=(0, 0, None))(seen, left, roots)
        # Without a change the filter's own error explains what is seen, or shocks do: as likely as not.
        shocks = -effective * state.lost
        none = jnp.logaddexp(every_one[:, 0], shocks) - jnp.log(2.0)
        factors = every_one[:, 1:] - none[:, None]
        # What two links take up at once has one cause: it is as likely as what one does.
        score = factors + jnp.log(self.rate * self.memory / self.windows)
        begun = jnp.where(state.age[:-1, None] > 0, score[:-1], -jnp.inf)
        each = jax.scipy.special.logsumexp(begun, axis=0)
        total = jax.nn.softmax(jnp.concatenate([jnp.zeros(1, pi.dtype), each]))
        # The sample in which a load arrives holds a part of it, and fits the wrong links: once a change is noticed,
        # they are distinguished by what has come since.
        since_then = (1.0 - total[0]) * jax.nn.softmax(score[-1])
        links = jnp.where(state.age[-1] > 0, since_then, total[1:])
        best = jnp.argmax(links)
        at = jnp.argmax(begun[:, best])
        return jnp.concatenate([total[:1], links]), best, state.age[at]

    def _roots_of(self, state: BankState) -> Float[Array, "hypotheses n n"]:
        """Roots of Δπ's covariances, in parts of `spread`: the filter's own, alone and with each candidate's load."""
        belief = state.filter.belief
        slopes = self.estimator.chart.jacobian(belief.mean.reshape(-1, 10))
        g = jax.scipy.linalg.block_diag(*slopes)
        own = jnp.linalg.solve(self.spread, g @ cholesky(belief.covariance))
        masks = self._masks(own.dtype)
        with_none = jnp.concatenate([jnp.zeros_like(masks[:1]), masks])
        return jax.vmap(lambda mask: cholesky(own @ own.T + jnp.diag(mask)))(with_none)

    def _common(self, probability: Float[Array, " k"]) -> tuple[Int[Array, ""], Bool[Array, ""]]:
        """(the candidate of all links that are likely to have changed, whatever else has; whether there is one)."""
        members = self._members()
        likely = members.T @ probability[1:] > self.threshold
        same = jnp.all((members > 0) == likely, axis=1)
        return jnp.argmax(same), jnp.any(same)

    def _members(self) -> np.ndarray:
        """Whether a link (column) is one of a candidate's (row)."""
        out = np.zeros((len(self.candidates), len(self.estimator.bodies)))
        for k, chosen in enumerate(self.candidates):
            out[k, list(chosen)] = 1.0
        return out

    def _expected(
        self, state: BankState, pi: Float[Array, " n"], best: Int[Array, ""]
    ) -> Float[Array, " n"]:
        """Mean of Δπ by the best candidate, from what has come since a change was noticed."""
        mask = self._masks(pi.dtype)[best]
        left = (state.vector[-1] - state.information[-1] @ pi) @ self.spread
        seen = self.spread.T @ state.information[-1] @ self.spread
        inner = jnp.eye(len(pi), dtype=pi.dtype) + mask[:, None] * mask * seen
        return self.spread @ jnp.linalg.solve(inner, mask * left)

    def _opened(
        self, state: State, best: Int[Array, ""], opened: Bool[Array, ""], pi: Float[Array, " n"]
    ) -> State:
        """The filter with the links of the best candidate opened, at what the hypothesis takes them to be.

        A load may be many times its link: from the bare link the first samples would be taken at a slope that is not
        the loaded one's, and what that leaves looks like a load on a neighbour.
        """
        which = jnp.asarray(self._members(), pi.dtype)[best] * opened
        more = jax.scipy.linalg.block_diag(*(which[:, None, None] * self.opening))
        old = state.belief.mean.reshape(-1, 10)
        new = self.estimator.chart.from_pi(inertial_parameters.as_bodies(pi.reshape(-1, 10)))
        there = (which[:, None] > 0) & jnp.all(jnp.isfinite(new), axis=1, keepdims=True)
        mean = jnp.where(there, new, old).ravel()
        return eqx.tree_at(lambda s: s.belief, state, Belief(mean, state.belief.covariance + more))

    def _masks(self, dtype: jnp.dtype) -> Float[Array, "candidates n"]:
        return jnp.asarray(np.repeat(self._members(), 10, axis=1), dtype)


@in_full_precision
def make_load_bank(
    robot: Robot,
    links: Sequence[int | str],
    *,
    sigma_tau: Float[Array, "#nv"] | Float[Array, ""] | Sequence[float] | float = 1.0,
    load: Load,
    candidates: Sequence[Sequence[int | str]] | None = None,
    noise: Noise | None = None,
    sigma_a: Float[Array, "#nv"] | Float[Array, ""] | Sequence[float] | float | None = None,
    rate: float = 1.0 / 60.0,
    threshold: float = 0.99,
    memory: float = 1.0,
    windows: int = 10,
    settle: float = 0.3,
    confirm: float = 0.1,
    averaging: float = 2.0,
    iterations: int = 2,
) -> LoadBank:
    """Bank over `links`, each of which may take up a `load` at any time.

    `candidates` are the sets of links that may change at once (default: every link, and every pair of them).
    `sigma_tau` (or `noise`) is the noise of each row [N m, N], `sigma_a` that of accelerations [m/s², rad/s²], which
    the robot's inertia makes a noise of all rows at once. `rate` [1/s] says how often each of them changes,
    `threshold` from which probability on a change is believed, `memory` [s] how far back a change is looked for, in so
    many `windows`, `settle` [s] how long the filter has for a new load before the next is looked for, `confirm` [s]
    for how long links are compared after a change is noticed (where no candidate is sure, links that all likely ones
    share are opened after half of `memory`), `averaging` [s] over which residuals' size and correlation are taken.
    Raises ValueError for an unknown link, a candidate that is no set of the links, or numbers that cannot be.

    >>> from jax_inertia import Load, load_model
    >>> from jax_inertia.estimation.online.load_bank import make_load_bank
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> bank = make_load_bank(load_model(double_pendulum()), ["upper", "lower"], sigma_tau=0.1, load=Load(1.0))
    >>> bank.candidates
    ((0,), (1,), (0, 1))
    """
    estimator = make_estimator(
        robot,
        links,
        sigma_tau=sigma_tau,
        noise=noise,
        sigma_a=sigma_a,
        prior=Load(_RESTING * load.mass, load.reach).of_a_body(),
        drift=_REST_SECONDS,
        chart=LogCholeskyUUt(),
        gate=FixedGate(),
        iterations=iterations,
        paper=True,
    )
    times = {"memory": memory, "settle": settle, "confirm": confirm, "averaging": averaging}
    for name, value in {"rate": rate, **times}.items():
        require(name, value, is_positive, "positive and finite")
    require("threshold", threshold, lambda x: 0.5 < x < 1.0, "a probability above one half")
    if windows < 2:
        raise ValueError(f"windows is {windows}; it must be two at least")
    count = len(estimator.bodies)
    if candidates is None:
        chosen = [
            *itertools.combinations(range(count), 1),
            *itertools.combinations(range(count), 2),
        ]
    else:
        chosen = [_places(estimator, robot, one) for one in candidates]
    dtype = robot.pi.dtype
    nominal = robot.pi[np.array(estimator.bodies)]
    return LoadBank(
        estimator=estimator,
        spread=jax.scipy.linalg.block_diag(*_roots(load, nominal)),
        opening=load.of_a_body().covariance(estimator.chart, nominal),
        rate=jnp.asarray(rate, dtype),
        threshold=jnp.asarray(threshold, dtype),
        **{name: jnp.asarray(value, dtype) for name, value in times.items()},
        candidates=tuple(chosen),
        windows=windows,
    )


def _effective(state: BankState) -> Float[Array, ""]:
    """Share of samples that carry news of their own, by the correlation of neighbouring residuals."""
    correlation = jnp.clip(state.product, 0.0, 0.95)
    return (1.0 - correlation) / (1.0 + correlation)


def _roots(load: Load, nominal: Float[Array, "links 10"]) -> Float[Array, "links 10 10"]:
    """Root of a load's covariance about each link's frame: independent about the link's centre of mass, and moved."""
    com = inertial_parameters.centre_of_mass(nominal)
    units = inertial_parameters.pseudo_inertia(jnp.eye(10, dtype=nominal.dtype))

    def moved(c: Float[Array, "3"]) -> Float[Array, "10 10"]:
        shift = jnp.eye(4, dtype=nominal.dtype).at[:3, 3].set(c)
        return inertial_parameters.from_pseudo_inertia(shift @ units @ shift.T).T

    return jax.vmap(moved)(com) * load.sigma_pi().astype(nominal.dtype)


_RESTING, _REST_SECONDS = 0.01, 3600.0
"""A link that rests may be off by this share of a load, and drift by as much in an hour."""


def _places(estimator: Estimator, robot: Robot, one: Sequence[int | str]) -> tuple[int, ...]:
    """Where the links of a candidate stand among the estimated ones."""
    bodies = resolve_bodies(robot, one)
    away = [robot.body_names[b] for b in bodies if b not in estimator.bodies]
    if away or not bodies:
        names = [robot.body_names[b] for b in estimator.bodies]
        raise ValueError(f"candidate {list(one)} is no set of the links {names}")
    return tuple(sorted(estimator.bodies.index(b) for b in bodies))
