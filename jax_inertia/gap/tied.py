"""What a log cannot tell from what was found in it."""

import copy
from collections.abc import Iterator

import numpy as np

from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.families.friction import DRY
from jax_inertia.gap.outcome import Search
from jax_inertia.gap.pool import Pool
from jax_inertia.gap.propose import propose
from jax_inertia.gap.select import settle, windows
from jax_inertia.gap.verdict import ties


def rivals(search: Search, chosen: list[Candidate], i: int) -> list[Candidate]:
    """Candidates for the i-th effect's part beside the others, best first."""
    others = [c for k, c in enumerate(chosen) if k != i]
    if not others:
        return search.ranking
    pool, floor = search.pool, search.noise_by_row
    # Beside all that is chosen nothing may stand out any more that could have happened in passing elsewhere.
    pool.look_again(windows(pool, others, floor))
    return propose(pool, others, floor)


def tied(search: Search, c: Candidate, among: list[Candidate]) -> list[Candidate]:
    """Those of an effect's rivals that explain the log as well."""
    return ties(c, among, search.misfits, search.noise)


def kind_of_tie(pool: Pool, a: Candidate, b: Candidate) -> str:
    """'exact' where the two effects are the same torque whatever the motion: a load on bodies welded to each other."""
    welded = pool.context.robot.topology.welded
    if a.family is b.family and a.family.rigid and welded(a.place.index, b.place.index):
        return "exact"
    gap = np.linalg.norm(a.effect - b.effect) / max(np.linalg.norm(a.effect), 1e-300)
    if any(c.family.law_of == DRY and not _turns_round(pool, c.place.index) for c in (a, b)):
        return "motion_limited"
    return "exact" if gap < 1e-6 else "motion_limited"


def _turns_round(pool: Pool, row: int) -> bool:
    """Whether a joint moves both ways: a friction is a constant torque until it does."""
    side = pool.context.side[:, row]
    return bool(side.min() < 0.0 < side.max())


def instead(
    search: Search, chosen: list[Candidate]
) -> Iterator[tuple[Candidate, Candidate, list[Candidate]]]:
    """Each effect, one that the log cannot tell from it, and the effects with that in its place, fitted to this log.

    What happened in passing is left as it is: its place in time is the log's own.
    """
    for i, c in enumerate(chosen):
        if c.family.passing:
            continue
        for other in tied(search, c, rivals(search, chosen, i)):
            if other.family.passing or any(other.key == x.key for x in chosen):
                continue
            # `settle` moves the numbers of what it is given.
            trial = [copy.copy(other if x is c else x) for x in chosen]
            yield c, other, settle(search.pool, trial, search.noise_by_row)
