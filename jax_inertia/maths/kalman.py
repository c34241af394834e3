"""Kalman filtering of one measurement at a time; knows no robot.

The update is the paper's (Foster et al., eq. predict and eq. update, with H = ∂h/∂x at the prior for the extended
filter), in one of the forms of `kalman_forms`.

Beyond the paper, each by one argument of `update`: iterations (Gauss–Newton from the prior: the iterated EKF of Bell
and Cathey 1993, which counts the observation once; steps that raise its cost are shortened), a gate on the *prior*
innovation, a mask of rows to leave out, noise enlarged for outliers.
Numerical trouble is returned as data (`Innovation.accepted`), never raised: an update that is not finite is not made.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jax_inertia.maths.gates import Gate
from jax_inertia.maths.kalman_forms import Correction as Correction
from jax_inertia.maths.kalman_forms import Elementary as Elementary
from jax_inertia.maths.kalman_forms import Form as Form
from jax_inertia.maths.kalman_forms import Information as Information
from jax_inertia.maths.kalman_forms import SquareRoot as SquareRoot
from jax_inertia.maths.kalman_forms import Standard as Standard
from jax_inertia.maths.kalman_forms import cholesky as cholesky
from jax_inertia.maths.kalman_forms import default_form as default_form
from jax_inertia.maths.kalman_forms import positive as positive
from jax_inertia.maths.noise import Noise
from jax_inertia.maths.precision import in_full_precision
from jax_inertia.maths.row_runs import spread_rows, take_rows


class Belief(eqx.Module):
    """A Gaussian: what the filter believes of the state."""

    mean: Float[Array, " n"]
    covariance: Float[Array, "n n"]


class Innovation(eqx.Module):
    """What one measurement said, before it was believed."""

    residual: Float[Array, " m"]
    """ν = z − h(x⁻); zero on masked rows."""
    sigma: Float[Array, " m"]
    """Standard deviation of ν by the filter's own account, √diag(S); exact for independent noise."""
    nis: Float[Array, ""]
    """Normalised innovation squared νᵀ S⁻¹ ν over the rows used, as the gate tests it (`update_by`)."""
    rows: Float[Array, ""]
    """Number of rows used: the degrees of freedom of `nis`."""
    log_likelihood: Float[Array, ""]
    """log N(ν; 0, S) over the rows used."""
    accepted: Bool[Array, ""]
    """Whether the measurement was believed; False where none of its rows hangs on the state, which is no verdict."""
    tested: Bool[Array, ""]
    """Whether any row that hangs on the state was used: else the measurement says nothing, neither for nor against."""

    @property
    def rejected(self) -> Bool[Array | np.ndarray, "*t"]:
        """Tested, and not believed; of one measurement, or of each of a run."""
        return self.tested & ~self.accepted


def predict(belief: Belief, q: Float[Array, "n n"]) -> Belief:
    """Random walk: the mean stays, P⁻ = P + Q (Foster et al., eq. predict with F = 1).

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.kalman import Belief, predict
    >>> predict(Belief(jnp.zeros(1), jnp.eye(1)), 0.5 * jnp.eye(1)).covariance
    Array([[1.5]], dtype=float64)
    """
    return Belief(belief.mean, belief.covariance + q)


class Measurement(NamedTuple):
    """One measurement z = h(x) + noise."""

    z: Float[Array, " m"]
    model: Callable[[Float[Array, " n"]], Float[Array, " m"]]
    """h."""
    jacobian: Callable[[Float[Array, " n"]], Float[Array, "m n"]] | None = None
    """∂h/∂x; None: by forward-mode autodiff."""
    mask: Bool[Array, " m"] | None = None
    """Rows where it is False are left out, and all that are not finite."""

    def used(self) -> Bool[Array, " m"]:
        """The rows that are not left out."""
        finite = jnp.isfinite(self.z)
        return finite if self.mask is None else finite & self.mask

    def left(self, x: Float[Array, " n"]) -> Float[Array, " m"]:
        """z − h(x); what is left out may hold anything, NaN too, and 0 · NaN is NaN: it is replaced, not scaled."""
        used = self.used()
        return jnp.where(used, jnp.where(used, self.z, 0.0) - self.model(x), 0.0)

    def slope(self, x: Float[Array, " n"]) -> Float[Array, "m n"]:
        """∂h/∂x, zero where left out."""
        jacobian = jax.jacfwd(self.model) if self.jacobian is None else self.jacobian
        return jnp.where(self.used()[:, None], jacobian(x), 0.0)


def update(
    belief: Belief,
    measurement: Float[Array, " m"],
    model: Callable[[Float[Array, " n"]], Float[Array, " m"]],
    noise: Noise,
    *,
    jacobian: Callable[[Float[Array, " n"]], Float[Array, "m n"]] | None = None,
    mask: Bool[Array, " m"] | None = None,
    gate: Gate | None = None,
    outliers: Gate | None = None,
    iterations: int = 1,
    form: Form | None = None,
    project: Callable[[Float[Array, " n"]], Float[Array, " n"]] = lambda x: x,
) -> tuple[Belief, Innovation]:
    """One measurement update; see `Measurement` for what is measured, `update_by` for everything else.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.kalman import Belief, update
    >>> from jax_inertia.maths.noise import IndependentNoise
    >>> before = Belief(jnp.zeros(1), jnp.eye(1))
    >>> after, seen = update(before, jnp.array([2.0]), lambda x: x, IndependentNoise(jnp.ones(1)))
    >>> after.mean.round(6), after.covariance.round(6)
    (Array([1.], dtype=float64), Array([[0.5]], dtype=float64))
    """
    return update_by(
        belief,
        lambda: Measurement(measurement, model, jacobian, mask),
        noise,
        gate=gate,
        outliers=outliers,
        iterations=iterations,
        form=form,
        project=project,
    )


@in_full_precision
def update_by(
    belief: Belief,
    measure: Callable[[], Measurement],
    noise: Noise,
    *,
    rows: tuple[int, ...] | None = None,
    gate: Gate | None = None,
    outliers: Gate | None = None,
    iterations: int = 1,
    elsewhere: Float[Array, "k n"] | None = None,
    form: Form | None = None,
    project: Callable[[Float[Array, " n"]], Float[Array, " n"]] = lambda x: x,
) -> tuple[Belief, Innovation]:
    """One measurement update; iterations = 1 is the paper's extended Kalman filter.

    `measure` computes the measurement, which goes into one kernel with its linearisation where the form is for that.
    `rows`, ascending, are those that hang on the state at all (None: any may); the noise must be independent then, and
    the others count in `nis` alone. `project` is applied to every iterate. The belief is returned unchanged where the
    gate rejects or the result would not be finite.

    With iterations the gate tests the cost that they end at, |z − h(x)|² + |x − x⁻|² in units of noise and prior: for a
    linear model νᵀ S⁻¹ ν itself, and for others what it stands for, where one slope at x⁻ says nothing of a far
    state. They start at x⁻, or at one of the places `elsewhere` where that costs less.

    `outliers` has the γ up to which a measurement is believed at its word. One beyond it contradicts the belief: its
    noise is taken to be larger, by the factor that makes νᵀ (H P Hᵀ + s² R)⁻¹ ν = γ (Chang 2014, J. Geodesy 88:391).
    So no measurement moves the state by more than √γ of the prior's standard deviations, and a wild one by next to
    nothing: K ν falls as 1/|ν|. Without it, a torque that no body of the prior explains leaves one that does, with a
    certainty to match, for ever. The innovation is normalised by the noise as given.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.kalman import Belief, Measurement, update_by
    >>> from jax_inertia.maths.noise import IndependentNoise
    >>> before, noise = Belief(jnp.zeros(1), jnp.eye(1)), IndependentNoise(jnp.ones(2))
    >>> both = lambda: Measurement(jnp.array([2.0, 9.0]), lambda x: jnp.array([x[0], 9.0]))
    >>> after, seen = update_by(before, both, noise, rows=(0,))
    >>> after.mean.round(6), after.covariance.round(6)
    (Array([1.], dtype=float64), Array([[0.5]], dtype=float64))
    """
    form = default_form(belief.mean.dtype) if form is None else form
    prior, p = belief.mean, belief.covariance
    size = len(noise.variances())
    hanging, measured = tuple(range(size)) if rows is None else rows, form.kept(measure)
    rest = np.setdiff1d(np.arange(size), hanging)
    root = None if iterations == 1 else form.cholesky(p)
    places = _Places.of(belief, form, root, elsewhere)

    def linearised(x: Float[Array, " n"], one: Measurement) -> _Rows:
        used = one.used().astype(prior.dtype)
        h, left = one.slope(x), one.left(x)
        nu = left - h @ (prior - x)
        white = noise.whiten(jnp.concatenate([h, nu[:, None], left[:, None]], axis=1), used)
        own, others = take_rows(white, hanging), white[rest]
        every = jnp.concatenate([own[:, -1], others[:, -1]])
        return _Rows(own[:, :-2], own[:, -2], jnp.sum(others[:, -2] ** 2), every)

    def seen_first() -> tuple[Array, Array, Array, Array, _Rows]:
        one = measured()
        used = one.used().astype(prior.dtype)
        x = places.cheapest(lambda y: noise.whiten(one.left(y)[:, None], used)[:, 0])
        return one.left(prior), used, jnp.sum(used), x, linearised(x, one)

    residual, used, count, start, white = form.fused(seen_first)()
    first = white.corrected(form, p)
    step, covariance = first.step, first.covariance
    weight = jnp.ones_like(first.nis)
    if outliers is not None:
        weight = _weight(form, p, white, first.nis, outliers.threshold(count))
        weighed = white.times(weight).corrected(form, p)
        step, covariance = weighed.step, weighed.covariance
    mean, nis = form.fused(lambda step: project(prior + step))(step), first.nis
    if root is not None:

        def left(x: Float[Array, " n"]) -> Float[Array, " m"]:
            return weight * noise.whiten(measured().left(x)[:, None], used)[:, 0]

        def again(x: Float[Array, " n"]) -> _Rows:
            return linearised(x, measured()).times(weight)

        trials = _Trials(belief, root, form, form.fused(again), form.fused(left), project)
        at_start = start, weight * white.left, step, covariance
        mean, cost, step, covariance = trials.run(at_start, iterations - 1)
        # What counts as noisier costs less than it would at its word.
        nis = jnp.where(weight < 1.0, nis, cost)

    limit = jnp.inf if gate is None else gate.threshold(count)
    tested = jnp.any(take_rows(used, hanging) > 0)
    accepted = tested & (nis <= limit) & _finite(step, mean, covariance)
    out = Belief(jnp.where(accepted, mean, prior), jnp.where(accepted, covariance, p))
    # The log-density of ν itself: whitening scaled it by √det R.
    log_det = first.log_det + noise.log_det(used)
    likelihood = -0.5 * (first.nis + log_det + count * jnp.log(2.0 * jnp.pi))
    seen = noise.colour(spread_rows(first.rows, hanging, size), used)
    sigma = jnp.sqrt(jnp.sum(seen**2, axis=1) + noise.variances())
    return out, Innovation(residual, sigma, nis, count, likelihood, accepted, tested)


def _finite(step: Array, mean: Array, covariance: Array) -> Bool[Array, ""]:
    """Whether an update is of numbers. The step too, since `project` may make a number of what is none; an entry of the
    covariance that is none leaves none on its row's diagonal.
    """
    each = [jnp.all(jnp.isfinite(x)) for x in (step, mean, jnp.diagonal(covariance))]
    return each[0] & each[1] & each[2]


class _Places(NamedTuple):
    """Where iterations may start: at the prior's mean, or elsewhere."""

    prior: Float[Array, " n"]
    elsewhere: list[Float[Array, " n"]]
    away: Float[Array, " k"]
    """(x − x⁻)ᵀ P⁻¹ (x − x⁻) of each of the others."""

    @classmethod
    def of(
        cls,
        belief: Belief,
        form: Form,
        root: Float[Array, "n n"] | None,
        elsewhere: Float[Array, "k n"] | None,
    ) -> "_Places":
        """`root` is the Cholesky factor of the covariance; None: there is one iteration, which starts at the mean."""
        if root is None or elsewhere is None:
            return cls(belief.mean, [], jnp.zeros(0, belief.mean.dtype))
        shift = (elsewhere - belief.mean).T
        away = jnp.sum(form.solve(root, shift) ** 2, axis=0)
        return cls(belief.mean, [elsewhere[k] for k in range(len(elsewhere))], away)

    def cheapest(
        self, left: Callable[[Float[Array, " n"]], Float[Array, " m"]]
    ) -> Float[Array, " n"]:
        """Where |white z − h(x)|² + |x − x⁻|² is least."""
        x = self.prior
        if not self.elsewhere:
            return x
        least = jnp.sum(left(x) ** 2)
        for k, place in enumerate(self.elsewhere):
            cost = jnp.sum(left(place) ** 2) + self.away[k]
            x, least = jnp.where(cost < least, place, x), jnp.minimum(cost, least)
        return x


class _Rows(NamedTuple):
    """A measurement linearised at a point, whitened."""

    h: Float[Array, "k n"]
    """Of the rows that hang on the state."""
    nu: Float[Array, " k"]
    rest: Float[Array, ""]
    """|ν|² of the others."""
    left: Float[Array, " m"]
    """Residual z − h(x) of all, the others' last: a kernel is done with them before it comes to H."""

    def times(self, factor: Float[Array, ""]) -> "_Rows":
        """With less noise, by this factor."""
        return _Rows(factor * self.h, factor * self.nu, factor**2 * self.rest, factor * self.left)

    def corrected(self, form: Form, p: Float[Array, "n n"]) -> Correction:
        """The correction of covariance `p` by all rows."""
        seen = form.correct(p, self.h, self.nu)
        return seen._replace(nis=seen.nis + self.rest)


class _Trials(NamedTuple):
    """Iterations after the first: linearise where the last one ended; back with a shorter step where the cost rose."""

    prior: Belief
    root: Float[Array, "n n"]
    """Cholesky factor of the prior's covariance."""
    form: Form
    linearise: Callable[[Float[Array, " n"]], _Rows]
    left: Callable[[Float[Array, " n"]], Float[Array, " m"]]
    """White z − h(x)."""
    project: Callable[[Float[Array, " n"]], Float[Array, " n"]]

    def run(
        self, first: tuple[Array, Array, Array, Array], count: int
    ) -> tuple[Array, Array, Array, Array]:
        """(mean, its cost, step, covariance), given where to start: x, the whitened residual there, the step that its
        slope gives, and the covariance.
        """
        prior, p = self.prior.mean, self.prior.covariance

        def cost(x: Float[Array, " n"], left: Float[Array, " m"]) -> Float[Array, ""]:
            away = self.form.solve(self.root, x - prior)
            value = left @ left + away @ away
            return jnp.where(jnp.isfinite(value), value, jnp.inf)

        def again(_, state):
            x, best, step, covariance, share = state
            trial = self.project(x + share * (prior + step - x))
            rows = self.linearise(trial)
            value, new = cost(trial, rows.left), rows.corrected(self.form, p)
            better = (value <= best) & jnp.all(jnp.isfinite(new.step))
            moved = (trial, value, new.step, new.covariance, jnp.ones_like(share))
            stayed = (x, best, step, covariance, 0.25 * share)
            return jax.tree.map(lambda a, b: jnp.where(better, a, b), moved, stayed)

        x, left, step, covariance = first
        start = (x, cost(x, left), step, covariance, jnp.ones_like(prior[0]))
        state: tuple[Array, ...] = jax.lax.fori_loop(0, count, again, start)
        x, best, step, covariance, share = state
        last = self.project(x + share * (prior + step - x))
        value = cost(last, self.left(last))
        better = value <= best
        mean = jnp.where(better, last, x)
        return mean, jnp.where(better, value, best), step, covariance


def _weight(
    form: Form,
    p: Float[Array, "n n"],
    rows: _Rows,
    nis: Float[Array, ""],
    limit: Float[Array, ""],
) -> Float[Array, ""]:
    """1/s, s ≥ 1, with νᵀ (H P Hᵀ + s² 1)⁻¹ ν = `limit` for whitened rows; 1 where s = 1 is below it already.

    By Newton on the reciprocal, as trust regions do (Moré and Sorensen 1983): N(t) with t = s² is the least cost
    |ν − H x|²/t + xᵀP⁻¹x, so N′ = −|ν − H x|²/t², and 1/N rises and is concave: from N(1)/γ, which is never too large,
    it goes up and never beyond. Two steps, since all that hangs on them is how far off the limit an outlier ends.
    """
    # Zero where all rows are left out; and a threshold of no rows may be infinite.
    t = jnp.maximum(nis / limit, 1.0)
    for _ in range(2):
        scaled = rows.times(jax.lax.rsqrt(t))
        seen = scaled.corrected(form, p)
        left = scaled.nu - scaled.h @ seen.step
        excess = jnp.maximum(seen.nis / limit - 1.0, 0.0)
        most = jnp.maximum(left @ left + scaled.rest, jnp.finfo(p.dtype).tiny)
        t = t * (1.0 + excess * seen.nis / most)
    return jax.lax.rsqrt(t)
