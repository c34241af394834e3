"""Effects that fit worse than the model alone are no causes: held out on the log itself, or on another motion."""

from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.energies import Shrink
from jax_inertia.gap.other_motion import OtherMotion, Trial, grown
from jax_inertia.gap.propose import STOP
from jax_inertia.gap.search import Search
from jax_inertia.gap.shrink import Sight, held_out, misfit_held_out, what_is_left

# A share of the gap, and of the missing torque, that the nominal model's own errors may add on another motion: an
# effect may be true and yet undo some of them. More is no cause.
WORSE, WORSE_TORQUE = 0.1, 1.3


def _harm_of(growth: float, before: float, after: float, floor: float) -> float:
    """Harm of torques that have grown, beside the misfit before and after.

    None where the most of the misfit is gone: noise of columns that hold accelerations is no harm in the noise's units.
    """
    return 0.0 if after - floor < 0.5 * (before - floor) else growth / WORSE_TORQUE


def without_harm(
    search: Search, other: OtherMotion | None, rows: list[int]
) -> tuple[list[Candidate], Shrink, Sight, Trial | None]:
    """The effects but for those that fit worse than the model alone, held out or on another motion.

    With them, the shrink on the log itself, each fifth of it predicted from the other four, where that was measured,
    and the trial on the other motion.
    """
    pool, chosen, prepared = search.pool, search.chosen, search.pool.context.prepared
    before = prepared.finish_torque(prepared.missing)
    alone = float(pool.evidence.y @ pool.evidence.y)

    def tried(effects: list[Candidate]) -> tuple[float, Shrink, Sight, Trial | None]:
        after = what_is_left(pool, effects)
        own, sight = held_out(pool, rows, effects, before, after, search.replicas)
        trial = None if other is None else other.trial(effects, sight)
        left = misfit_held_out(pool, effects)
        harm = [
            # On stretches that it was not fitted to, an effect has to bring half of what it had to on all of them.
            left / max(alone - 0.5 * STOP, 1.0),
            _harm_of(grown(pool.evidence, before, after), alone, left, search.floor),
        ]
        if trial is not None:
            j = trial.misfit
            chance = STOP * max(1.0, j.before / max(j.floor, 1.0))
            harm += [
                j.after / (j.before + chance + j.allowed + WORSE * max(j.before - j.floor, 0.0)),
                _harm_of(trial.grown, j.before, j.after, j.floor),
            ]
        return max(harm), own, sight, trial

    now = tried(chosen)
    while chosen and now[0] > 1.0:
        fewer = [[x for k, x in enumerate(chosen) if k != i] for i in range(len(chosen))]
        chosen, now = min(((rest, tried(rest)) for rest in fewer), key=lambda x: x[1][0])
    return chosen, *now[1:]
