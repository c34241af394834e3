"""Which log holds what: strata, robots, engines, motions, rates. Everything about log k follows from the seed and k."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from world.draw import ARM, FLOATING
from world.unknowns import UNKNOWN

STRATA = {"none": 0.28, "unknown": 0.16, "pair": 0.21, "single": 0.35}
ROBOTS = {"two": 0.11, "six": 0.33, "seven": 0.33, "dog": 0.13, "humanoid": 0.10}
ALIKE = ({"time_delay", "actuator_lag"}, {"joint_elasticity", "backlash"})
"""Families of which a pair would be one effect in two disguises: no fair question."""
SECOND_ENGINE = {"dog": 0.3}
"""Share of logs by Pinocchio and our contacts, where it is not half."""


@dataclass(frozen=True)
class Setting:
    """One log before anything random about its physics. `key` (words) seeds it."""

    key: tuple[int, ...]
    stratum: str
    families: tuple[str, ...]
    robot: str
    engine: str
    motions: tuple[str, str]
    rate: int
    wrong: bool
    loud: float
    duration: float
    test_duration: float


def dealt(shares: dict[str, float], count: int, rng: np.random.Generator) -> list[str]:
    """`count` cards in these shares (largest remainders), shuffled."""
    exact = {k: s * count for k, s in shares.items()}
    cards = [k for k, x in exact.items() for _ in range(int(x))]
    rest = sorted(exact, key=lambda k: exact[k] % 1.0, reverse=True)
    cards += rest[: count - len(cards)]
    return [str(x) for x in rng.permutation(cards)]


def _fair(pair: set[str], known: tuple[str, ...]) -> bool:
    return len(pair) == 2 and pair <= set(known) and not any(a <= pair for a in ALIKE)


def plan(
    words: tuple[int, ...], count: int, robots: dict[str, float] | None = None
) -> list[Setting]:
    """All settings of a sealed set; `words` is its seed."""
    rng = np.random.default_rng([*words, 0])
    strata = dealt(STRATA, count, rng)
    machines = dealt(robots or ROBOTS, count, rng)
    wrong = iter(np.arange(count) % 2 == 0)
    decks: dict[str, list[str]] = {}

    def card(name: str, families: tuple[str, ...]) -> str:
        """From a deck that is shuffled anew when empty: every family comes as often as any other."""
        if not decks.get(name):
            decks[name] = [str(x) for x in rng.permutation(families)]
        return decks[name].pop()

    out = []
    for k, (stratum, robot) in enumerate(zip(strata, machines, strict=True)):
        floating = robot in ("dog", "humanoid")
        known = FLOATING if floating else ARM
        where = "floating" if floating else "arm"
        families: tuple[str, ...] = ()
        if stratum == "single":
            families = (card(f"single {where}", known),)
        elif stratum == "unknown":
            families = (card("unknown", UNKNOWN),)
        elif stratum == "pair":
            first, second = card("pair", known), card("pair", known)
            while not _fair({first, second}, known):
                first, second = str(rng.choice(known)), str(rng.choice(known))
            families = (first, second)
        if robot == "dog":
            kinds = rng.choice(["dance", "squat", "crawl"], 2, p=[0.4, 0.3, 0.3])
        else:
            first = "ordinary" if rng.random() < 0.5 else "exciting"
            other = {"ordinary": "exciting", "exciting": "ordinary"}[first]
            kinds = (first, first if rng.random() < 0.65 else other)
        rates = [250, 500] if floating or robot == "seven" else [250, 500, 1000]
        odds = [0.9, 0.1] if len(rates) == 2 else [0.84, 0.12, 0.04]
        out.append(
            Setting(
                key=(*words, 1, k),
                stratum=stratum,
                families=families,
                robot=robot,
                engine="pinocchio" if rng.random() < SECOND_ENGINE.get(robot, 0.5) else "mujoco",
                motions=(str(kinds[0]), str(kinds[1])),
                rate=int(rng.choice(rates, p=odds)),
                wrong=bool(next(wrong)) if stratum == "none" else bool(rng.random() < 0.5),
                loud=float(rng.choice([1.0, 3.0], p=[0.75, 0.25])),
                duration=6.5 if floating else 8.0,
                test_duration=4.5 if floating else 5.0,
            )
        )
    return out
