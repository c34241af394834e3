"""A joint's whole friction law as it is handed over, and the level and slope of MuJoCo that come nearest to it.

    τ = −[Σᵢ Fᵢ zᵢ + z (Σₖ Sₖ exp(−|q̇/vₖ|^δₖ) + μ |τ_load|) + a |z| + τ₀ + d q̇ + c |q̇| q̇ + ½ b |q̇| + d₁ exp(−t/T) q̇]

τ₀ takes back what of a joint's constant torque (`torque_bias`) stands in a model for the law's other terms.
zᵢ: direction of friction over the i-th presliding displacement (Dahl 1968), or of one that creeps as MuJoCo's does,
clip((q̇ + q̈/b)/speed, ±1) with b = 2/(0.95 · 0.02 s); z is the first of them. The terms are those of
Armstrong-Hélouvry, Dupont and Canudas de Wit, Automatica 30(7), 1994; most are mild and are no cause by themselves, but
all of them predict.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Interval, Term
from jax_inertia.diagnosis.effects.dry_friction import MOST_LOAD, direction
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.signals.dry_friction import bristle, sign

UNITS = {
    "bristle": "N m",
    "creep": "N m",
    "slow": "N m",
    "load": "1",
    "by_direction": "N m",
    "constant": "N m",
    "viscous": "N m s/rad",
    "quadratic": "N m s²/rad²",
    "slope_by_direction": "N m s/rad",
    "drift": "N m s/rad",
}
"""Unit of each form's number, of a hinge."""
NUMBERS_OF = {
    "bristle": {"displacement": "scale", "straight": "kind"},
    "creep": {"speed": "scale"},
    "slow": {"speed": "scale", "exponent": "kind"},
    "load": {"of_motor": "kind"},
    "by_direction": {},
    "constant": {},
    "viscous": {},
    "quadratic": {},
    "slope_by_direction": {},
    "drift": {"time_constant": "scale"},
}
"""Further numbers of each form in a report, and the field of `Term` that holds each."""
EQUATION = (
    "τ = −[Σ bristle z_i + z (Σ slow exp(−|v/speed|^exponent) + load |τ_load|) + by_direction |z| + constant "
    "+ viscous v + quadratic |v| v + slope_by_direction |v| / 2 + drift exp(−t/time_constant) v]"
)


@dataclasses.dataclass(frozen=True)
class FrictionCurve:
    """A joint's friction law: every term with its number and 95 % interval, and of which effect it is, if of any."""

    main: Term
    """The bristle whose direction multiplies what depends on speed and load."""
    terms: Mapping[Term, Interval]
    effects: Mapping[Term, str]
    """Family of the listed effect that a term belongs to."""
    quadratic: float = 0.0
    """c of −c |q̇| q̇ that the corrected model's damping holds [N m s²/rad²]."""

    def torque(self, moving: "Moving") -> Float[np.ndarray, " T"]:
        """What it takes of a joint's torque along a motion [N m]; positive where the joint moves forward."""
        return self._torque(moving, tuple(self.terms))

    def dry(self, moving: "Moving") -> Float[np.ndarray, " T"]:
        """The part of it that turns round with the direction."""
        return self._torque(moving, tuple(t for t in self.terms if t.form in TURNING))

    def _torque(self, moving: "Moving", terms: tuple[Term, ...]) -> Float[np.ndarray, " T"]:
        forms = curve_forms(self.main, terms, moving)
        values = np.array([self.terms[t].value for t in terms])
        motor = [k for k, term in enumerate(terms) if term.form == "load" and term.kind]
        rest = [k for k in range(len(values)) if k not in motor]
        out = forms[:, rest] @ values[rest]
        for k in motor:
            # The motor's torque has this friction in it: τ (1 − μ z sign τ) is what it needs without.
            needed = moving.motor + out
            raised = 1.0 - np.clip(values[k], 0.0, MOST_LOAD) * forms[:, k] * np.sign(needed)
            out = out + needed * (1.0 / raised - 1.0)
        return out

    @classmethod
    def read(cls, law: Mapping[str, Any]) -> "FrictionCurve":
        """From a joint's `friction` in a report.json as parsed; ValueError for a term of another form."""
        terms, effects = {}, {}
        for one in law["terms"]:
            form = one["form"]
            if form not in UNITS:
                raise ValueError(f"a friction law has no term {form!r}; terms: {', '.join(UNITS)}")
            own = {of: float(one[name]) for name, of in NUMBERS_OF[form].items()}
            term = Term(form, **own)
            low, high = map(float, one["ci95"])
            terms[term] = Interval(float(one["value"]), low, high, one["unit"])
            if "effect" in one:
                effects[term] = one["effect"]
        return cls(next(iter(terms)), terms, effects, float(law.get("quadratic_in_model", 0.0)))


TURNING = frozenset({"bristle", "creep", "slow", "load", "by_direction"})
"""Forms that turn round with the direction."""


class LinkApart(NamedTuple):
    """A link behind a spring or play, along a log."""

    ahead: Float[np.ndarray, " T"]
    """Its speed less its motor's [rad/s]."""
    held: Float[np.ndarray, " T"]
    """Direction of its dry friction, in [−1, 1]: while its motor crosses a play, friction holds it in whole or part."""


@dataclasses.dataclass(frozen=True)
class Moving:
    """A joint's motion, as its friction sees it; arrays (T,)."""

    context: Context
    row: int
    link: Float[np.ndarray, " T"]
    """Torque that the link needs [N m]."""
    motor: Float[np.ndarray, " T"]
    """Torque that the motor needs without this friction [N m]."""
    other: int = -1
    """Row of a joint with which the motor turns, q + `share` q_other."""
    share: float = 0.0
    scale: float = 1.0
    """Of logged positions over real ones."""
    link_apart: LinkApart | None = None
    """The joint's link, where its friction is that of the link, apart from the motor whose position is logged."""

    @classmethod
    def along(cls, context: Context, row: int) -> "Moving":
        """Along a log, loads as its model has them."""
        link = context.link_torque[:, row]
        return cls(context, row, link, link + context.armature[row] * context.a[:, row])

    def turned_with(self, other: int, share: float) -> "Moving":
        """The same of a motor that turns with another joint."""
        return dataclasses.replace(self, other=other, share=share)

    def _of(self, values: Float[np.ndarray, "T nv"]) -> Float[np.ndarray, " T"]:
        own = values[:, self.row] / self.scale
        return own if self.other < 0 else own + self.share * values[:, self.other]

    @property
    def v(self) -> Float[np.ndarray, " T"]:
        """Speed [rad/s]."""
        own = self._of(self.context.v)
        return own if self.link_apart is None else own + self.link_apart.ahead

    def direction(self, term: Term) -> Float[np.ndarray, " T"]:
        """z of a bristle, or of a friction that creeps.

        A plain sign is that of the speed, also where a joint rests: there a friction is whatever balances, and a model
        that a simulator runs has no rest of its own.
        """
        context, row = self.context, self.row
        if self.link_apart is not None:
            return self.link_apart.held
        if term.form == "creep":
            if self.other < 0:
                return context.creeping_at(row, term.scale)
            return np.clip(self.v / term.scale, -1.0, 1.0)
        if not term.scale:
            return sign(self.v / context.radian[row])
        if self.other < 0 and self.scale == 1.0:
            return direction(context, row, term.scale, term.kind)
        path, start = self._of(context.joint_position), float(np.sign(self.v[0]))
        return bristle(path, start, term.scale, straight=bool(term.kind))


def curve_forms(main: Term, terms: Sequence[Term], moving: Moving) -> Float[np.ndarray, "T k"]:
    """The form of each term along a motion; of a load on the motor z alone."""
    v, z = moving.v, moving.direction(main)

    def form(term: Term) -> np.ndarray:
        match term.form:
            case "bristle" | "creep":
                return moving.direction(term)
            case "slow":
                return z * np.exp(-(np.abs(v / term.scale) ** term.kind))
            case "load":
                return z if term.kind else z * np.abs(moving.link)
            case "constant":
                return np.ones_like(v)
            case "by_direction":
                return np.abs(z)
            case "viscous":
                return v
            case "quadratic":
                return np.abs(v) * v
            case "slope_by_direction":
                return 0.5 * np.abs(v)
            case "drift":
                return np.exp(-moving.context.time / term.scale) * v
        raise ValueError(f"a friction law has no term {term.form!r}; terms: {', '.join(UNITS)}")

    return np.stack([np.zeros_like(v), *map(form, terms)], axis=1)[:, 1:]
