"""What stands against a verdict besides the errors that it is about, and how probable that makes it."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.certainty.probability import log_odds
from jax_inertia.diagnosis.result import Verdict


@runtime_checkable
class HasOdds(Protocol):
    """An effect of either engine."""

    @property
    def log_odds(self) -> float:
        """That it is there [nats]."""
        ...


class Doubts(NamedTuple):
    """What else there may be."""

    another: float = 0.0
    """Odds that one more effect is there."""
    refuted: bool = False
    """Numbers of the model are further off than their tolerance, or it lacks its joints' ordinary physics."""
    unnamed: float | None = None
    """Log odds that an effect is there that no name is known for, where one is carried [nats]."""

    def against(self, named: bool) -> Iterator[str]:
        """What stands against a verdict that leaves nothing open."""
        if not named and self.refuted:
            yield "numbers of the model are further off than their tolerances"
        if named and self.another > 1.0:
            yield "one more effect is more likely there than not"
        if named and self.unnamed is not None:
            yield "what remains is distinct and has no name"


def odds_of_verdict(
    within: Float[np.ndarray, " m"], given: Verdict, effects: Sequence[HasOdds], doubts: Doubts
) -> float:
    """Log odds that a verdict is right, as the search has it [nats].

    `within`: log odds of each output that moves that its error is within the border of the verdict (`odds_within`).
    Against `no_gap` and `explained` stands that one is not, that an effect is not there, that another one is. `partly`
    and `unknown` have the best of their reasons.
    """
    another = np.log(max(doubts.another, 1e-300))
    unnamed = -np.inf if doubts.unnamed is None else doubts.unnamed
    beyond = -float(np.min(within, initial=np.inf))
    if given in (Verdict.NO_GAP, Verdict.EXPLAINED):
        against = (-another, *within.tolist())
    else:
        against = (max(beyond, unnamed, another if given is Verdict.PARTLY else -np.inf),)
    return log_odds((*(f.log_odds for f in effects), *against))
