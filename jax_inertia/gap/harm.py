"""Effects that fit worse than the model alone are no causes: held out on the log itself, or on another motion."""

import dataclasses

import numpy as np
from jaxtyping import Float

from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.energies import Shrink
from jax_inertia.gap.other_motion import OtherMotion, Trial, grown
from jax_inertia.gap.outcome import Search
from jax_inertia.gap.propose import STOP
from jax_inertia.gap.shrink import Sight, held_out, misfit_held_out, what_is_left
from jax_inertia.gap.tied import instead
from jax_inertia.gap.together import misfit
from jax_inertia.gap.verdict import Verdict, second_look
from jax_inertia.text.words import named

# A share of the gap, and of the missing torque, that the nominal model's own errors may add on another motion: an
# effect may be true and yet undo some of them. More is no cause.
WORSE, WORSE_TORQUE = 0.1, 1.3
# The same where nothing is known for a cause: what is listed there has to help.
WORSE_GUESS = 0.02


@dataclasses.dataclass(frozen=True)
class Checked:
    """Effects tried where they were not fitted."""

    chosen: list[Candidate]
    harm: float
    """Above one where they fit worse than the model alone."""
    heldout: Shrink
    """On the log itself, each fifth of it predicted from the other four."""
    sight: Sight
    """Where that was measured."""
    trial: Trial | None
    """On the other motion."""
    notes: tuple[str, ...] = ()
    """What the other motion told of effects that the log could not tell from each other."""

    def seconded(self, verdict: Verdict) -> Verdict:
        """What the other motion leaves of the log's own verdict on them."""
        return verdict if self.trial is None else second_look(verdict, self.trial.misfit)

    def refuted(self, verdict: Verdict) -> bool:
        """Whether the other motion speaks against effects that the log's own verdict lets stand."""
        if self.trial is None or verdict is Verdict.UNKNOWN:
            return False
        return self.harm > 1.0 or self.seconded(verdict) is Verdict.UNKNOWN


def _harm_of(growth: float, before: float, after: float, floor: float) -> float:
    """Harm of torques that have grown, beside the misfit before and after.

    None where the most of the misfit is gone: noise of columns that hold accelerations is no harm in the noise's units.
    """
    return 0.0 if after - floor < 0.5 * (before - floor) else growth / WORSE_TORQUE


def _grown_beyond(there: Shrink) -> float:
    """Harm of the gap's energy that another motion has more of, beyond what the model's errors and noise may add."""
    return there.after**2 / max((1.0 + WORSE) * there.before**2 + there.noise**2, 1e-300)


def without_harm(search: Search, other: OtherMotion | None, rows: list[int]) -> Checked:
    """The effects but for those that fit worse than the model alone, held out or on another motion.

    Where the other motion refutes one that the log could not tell from another, and not that other, that other stands:
    it is fitted to the log as all are, and the other motion has only to bear it out.
    """
    pool, prepared = search.pool, search.pool.context.prepared
    before = prepared.finish_torque(prepared.missing)
    alone = float(pool.evidence.y @ pool.evidence.y)
    noise = max(1.0, search.misfits[-1] / max(search.noise, 1.0))

    def size(torque: Float[np.ndarray, "R nv"]) -> float:
        """Energy over all rows [N² m²]."""
        return float(np.sum(torque[pool.evidence.used] ** 2))

    noise_alone = float(np.mean([size(x) for x in search.replicas]))

    def tried(effects: list[Candidate]) -> Checked:
        after = what_is_left(pool, effects)
        own, sight = held_out(pool, rows, effects, before, after, search.replicas)
        trial = None if other is None else other.trial(effects, sight)
        left = misfit_held_out(pool, effects)
        harm = [
            # On stretches that it was not fitted to, an effect has to bring half of what it had to on all of them.
            left / max(alone - 0.5 * STOP, 1.0),
            _harm_of(grown(pool.evidence, before, after), alone, left, search.floor),
        ]
        if search.verdict is Verdict.UNKNOWN:
            # Guesses have to help, on all joints together: one whose sensors are far better than its model would
            # have the others' torques bent for its sake.
            harm.append(size(after) / ((1.0 + WORSE) * size(before) + noise_alone))
            # And where the gap is, in newton metres, not only in the noise's units.
            harm.append(own.after**2 / max((1.0 + WORSE_GUESS) * own.before**2, 1e-300))
        if trial is not None:
            j = trial.misfit
            chance = STOP * max(1.0, j.before / max(j.floor, 1.0))
            harm += [
                j.after / (j.before + chance + j.allowed + WORSE * max(j.before - j.floor, 0.0)),
                _harm_of(trial.grown, j.before, j.after, j.floor),
            ]
        checked = Checked(effects, max(harm), own, sight, trial)
        if trial is None or checked.seconded(search.verdict) is not Verdict.UNKNOWN:
            return checked
        # Causes that this log knows may be true though another motion hardly shows them; guesses have to help there.
        there = _grown_beyond(trial.shrink)
        return dataclasses.replace(checked, harm=max(checked.harm, there))

    def order(checked: Checked) -> tuple[bool, float]:
        """Those that the other motion bears out wholly first; then by what the log itself says of them."""
        wholly = checked.seconded(search.verdict) is search.verdict
        price = sum(c.price(pool.evidence.rows) for c in checked.chosen)
        return not wholly, misfit(pool, checked.chosen) / noise + price

    now = tried(search.chosen)
    if now.refuted(search.verdict):
        borne_out = [
            dataclasses.replace(trial, notes=(_told(c, x),))
            for c, x, effects in instead(search, now.chosen)
            if not (trial := tried(effects)).refuted(search.verdict)
        ]
        now = min(borne_out, key=order, default=now)
    while now.chosen and now.harm > 1.0:
        fewer = ([x for x in now.chosen if x is not c] for c in now.chosen)
        now = min(map(tried, fewer), key=lambda x: x.harm)
    return now


def _told(refuted: Candidate, stands: Candidate) -> str:
    one, two = (named(c.family.name, c.place) for c in (refuted, stands))
    return f"this log cannot tell {one} from {two}: the other motion speaks against the first, not the second"
