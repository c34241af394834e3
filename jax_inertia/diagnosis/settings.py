"""Every decision threshold of the whole-robot diagnosis: value, unit, and where the value comes from."""

import dataclasses
import enum


class CalibrationState(enum.StrEnum):
    """Whether a model has its joints' ordinary physics."""

    AS_BOUGHT = "as_bought"
    CALIBRATED = "calibrated"


@dataclasses.dataclass(frozen=True)
class Settings:
    """Frozen; passed to each station, never imported as constants.

    Values marked *decision* are judgements of what an engineer calls material; those marked *prior* are sizes that
    effects have on real robots (friction: Armstrong-Hélouvry, Dupont and Canudas de Wit, Automatica 30(7), 1994).
    """

    rows_per_cutoff: float = 2.5
    """Rate of the residual's rows, of the band's cutoff. A band carries two independent samples a period (Nyquist)."""
    margin_periods: float = 5.0
    """Periods of the cutoff left out at either end of a log, where a zero-phase filter leans on its padding: measured
    on a log that begins in motion (Panda), half a second of 10 Hz."""
    ordinary_odds: float = 2.0
    """Prior log odds against each ordinary effect, nats. Prior: every robot has friction."""
    refinement_odds: float = 5.0
    """The same against another form of an ordinary effect (Stribeck, asymmetric, load-dependent friction), nats."""
    odd_odds: float = 8.0
    """The same against each odd effect, nats: e⁻⁸, about one in 3000 places has one. Prior."""
    generic_odds: float = 10.0
    """The same against a generic alternative, which names no cause, nats. Prior."""
    unmeasured_odds: float = 25.0
    """The same of a robot on forces that are not measured, nats: what its feet do is in no equation and comes again
    with every step. Measured on quadrupeds: 15 had four false alarms in 18 logs, 40 missed effects."""
    least_variance: float = 0.01
    """Least residual standard deviation of a row, share of its gap's rms: filters and differences are no better."""
    mass_tolerance: float = 0.02
    """Standard deviation of a nominal body's mass, relative. CAD masses of built arms: 2 to 5 %."""
    com_tolerance: float = 0.001
    """Of a nominal centre of mass [m], on links of 0.15 to 1 m."""
    com_stated: float | None = None
    """The same where it is stated for this robot, whatever its size [m]."""
    inertia_tolerance: float = 0.05
    """Of a nominal rotational inertia, relative."""
    calibrated_mass: float = 0.01
    """The same of a model that is calibrated: of a mass, relative. Prior."""
    calibrated_inertia: float = 0.02
    """Of a rotational inertia of such a model, a rotor's too, relative. Prior."""
    calibrated_number: float = 0.05
    """Of a joint's friction of such a model, relative: dampings of a good model are 5 to 10 % off."""
    tolerance_numbers: float = 20.0
    """How many measured numbers the stated tolerance of a kind counts for, where the log says how large it is: a robot
    with many numbers further off has larger tolerances, one with a single such number has something odd."""
    calibrated_numbers: float = 1.0
    """The same of a calibrated model: how well one is calibrated, the log says."""
    ordinary_tolerance: float = 0.2
    """Change of a joint's friction or rotor inertia that is none, relative to the model's own number: dampings of a
    good model are 5 to 10 % off; two of those."""
    gain_tolerance: float = 0.05
    """Of a motor's torque over what a loop commands, relative: its constant is stated within 10 %, two deviations.
    Prior; a friction, which nobody states, is further off."""
    as_bought: float = 3.0
    """Log odds [nats] from which a model counts as bought, not calibrated: 20 to 1 (Kass and Raftery, JASA 90(430),
    1995). Where a log says next to nothing of friction, joints' votes add up to a fraction of a nat of either sign."""
    rest_speed: float = 0.02
    """Joints slower than this [rad/s, slides in 0.1 m/s] are at rest: there dry friction is whatever balances."""
    distinct: float = 3.0
    """Posterior standard deviations from zero from which a number is listed. Decision (99.7 %)."""
    material: float = 0.02
    """Share of a row's gap energy below which an ordinary effect is not listed. Decision."""
    refuted: float = 0.01
    """Chance that any number of a model within its tolerances is so far off that it is no more within them."""
    gate: float = 0.10
    """Share by which an odd effect may raise the other run's error before it is left out. Decision: what a plot shows;
    less is how one motion differs from another."""
    tie: float = 5.0
    """Nats within which another hypothesis explains as much: odds of 150 to 1 (Kass and Raftery 1995: very strong)."""
    tie_share: float = 0.01
    """The same as a share of the effect's evidence: an equation that errs by 10 % misplaces so much."""
    likely: float = 0.5
    """Probability from which an odd effect is stated as a cause: less is a stand-in. Decision: more likely than not."""
    most_effects: int | None = None
    """How many odd effects are looked for; as many as the log supports, where it is left out."""
    most_steps: int = 30
    """Bound of the search's moves, a safeguard where equations are wrong everywhere (LWR4+): what comes later predicts
    nothing. None of 60 development logs keeps more than four odd effects."""
    folds: int = 3
    """Parts of a joint's range that are predicted from the others. Measured on 48 opened robots as bought and six real
    ones (2026-11-30): error of another run over that of held-out rows, in the median 1.44 for five stretches of time,
    1.15 for three parts of the range, 1.30 for five."""

    def reach(self, evidence: float) -> float:
        """Nats by which another hypothesis may be behind an effect of so much evidence and explain as much."""
        return max(self.tie, self.tie_share * abs(evidence))
