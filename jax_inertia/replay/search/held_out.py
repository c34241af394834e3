"""How far replays of runs that played no part in a fit err, output by output."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.replay import checks
from jax_inertia.replay.fitting.errors import Weights, likelier, replay_errors
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.record import Record
from jax_inertia.replay.search.unnamed import Shapes
from jax_inertia.replay.simulation.plant import Plant

WORSE = 1.02
"""Of an output's error, what passes for no worse."""
LISTED, _RETURNS = 0.01, 0.45
"""An odd effect is listed whose return takes up so much of the gap, or adds so much of the corrected replay's error (in
squares: it errs a tenth more)."""


class Unseen:
    """Runs that played no part: mean squares of their positions [rad²] and, where logged, of their torques.

    The latter in units of what the loop's torque errs by though nothing is wrong, and no less than 1: joints are of
    very different strength, and what a clock does to a torque is no merit of a model.
    """

    def __init__(
        self, plant: Plant, records: Sequence[Record], least: Float[np.ndarray, " m"] | None = None
    ):
        """`least`: what replays err by for no reason, next to what encoders leave; none where nobody looked."""
        self._plant, self._records, self._floor, self._least = plant, records, None, least
        if records[0].torque is not None:
            self._floor = checks.torque_floor(records, plant.loop)

    @cached_property
    def floor(self) -> Float[np.ndarray, " m"]:
        """What encoders, the steps of the simulation and the clocks of torques leave of each output, rms."""
        least = checks.floor(self._records)
        if self._least is not None:
            least = np.maximum(least, self._least[: len(least)])
        return least if self._floor is None else np.concatenate([least, self._floor])

    def missed(self, found: Fit) -> Float[np.ndarray, " k"]:
        """Of a fit; one number, or two."""
        return self.misses(found.table, found.theta[None])[0]

    def misses(
        self, table: Sequence[Parameter], thetas: Float[np.ndarray, "B P"]
    ) -> Float[np.ndarray, "B k"]:
        """Of every vector."""
        return self.missed_by(replay_errors(self._plant, table, thetas, self._records))

    def missed_by(self, errors: Float[np.ndarray, "B N m"]) -> Float[np.ndarray, "B k"]:
        """Of the errors of replays."""
        return np.array([self.squares(np.mean(e**2, axis=0)) for e in errors])

    def errors(self, found: Fit) -> Float[np.ndarray, "N m"]:
        """Of the replays of a fit."""
        return self.errors_of(found.table, found.theta)

    def errors_of(
        self, table: Sequence[Parameter], theta: Float[np.ndarray, " P"]
    ) -> Float[np.ndarray, "N m"]:
        """Of the replays of a vector."""
        return replay_errors(self._plant, table, theta[None], self._records)[0]

    def likelier(
        self, new: Float[np.ndarray, "N m"], old: Float[np.ndarray, "N m"], fitted: Weights
    ) -> float:
        """By how much these runs are likelier by errors of one fit's replays than by another's, in twice nats.

        Correlated as `fitted` at least. What a fit brings to its own logs and this are one evidence:
        p(logs, runs) = p(logs) p(runs | logs).
        """
        return likelier(new, old, self.floor, fitted.correlated)[0]

    @cached_property
    def _shapes(self) -> Shapes:
        return Shapes(self._plant.names, self._records)

    def unnamed(
        self, with_it: Float[np.ndarray, "N m"], without: Float[np.ndarray, "N m"], numbers: int
    ) -> float:
        """By how much shapes of the motion in an effect's place cost more than its `numbers`, in twice nats."""
        n = len(self._plant.names)
        return self._shapes.cost(with_it[:, :n], without[:, :n], self.floor[:n], numbers)

    def taken_back(
        self, found: Fit, effects: Sequence[tuple[int, ...]]
    ) -> Float[np.ndarray, "B N m"]:
        """Errors of the replay, and of those without each effect, by its rows in the table."""
        thetas = np.repeat(found.theta[None], len(effects) + 1, axis=0)
        for b, rows in enumerate(effects):
            thetas[b + 1, list(rows)] = [found.table[k].nominal for k in rows]
        return replay_errors(self._plant, found.table, thetas, self._records)

    def shown(self, errors: Float[np.ndarray, "B N m"]) -> Bool[np.ndarray, " E"]:
        """Which effects, of the errors of `taken_back`, change the replay by what sensors resolve.

        That is, rms over the runs, at some joint a step of its encoder (√12 of its deviation) or, where logged, what
        its torque errs by though nothing is wrong. An effect below both is a guess about what remains, and no cause.
        """
        least = np.sqrt(12.0) * np.max([checks.encoder_noise(r.q) for r in self._records], axis=0)
        if self._floor is not None:
            least = np.concatenate([least, self._floor])
        return np.any(_apart(errors[1:], errors[:1]) >= least, axis=1)

    def moved(self, new: Float[np.ndarray, "N m"], old: Float[np.ndarray, "N m"]) -> bool:
        """Whether replays of two fits, by their errors, differ in some output by more than the `floor`."""
        return bool(np.any(_apart(new, old) > self.floor))

    def squares(self, square: Float[np.ndarray, " m"]) -> Float[np.ndarray, " k"]:
        """Of the mean square of each output."""
        n = len(self._plant.names)
        position = float(np.mean(square[:n]))
        if self._floor is None:
            return np.array([position])
        torque = square[n:] / np.maximum(self._floor, 1e-12) ** 2
        return np.array([position, max(float(np.mean(torque)), 1.0)])


def _apart(new: Float[np.ndarray, "... N m"], old: Float[np.ndarray, "... N m"]) -> np.ndarray:
    """By how much replays differ, rms of each output, of their errors."""
    return np.sqrt(np.mean((new - old) ** 2, axis=-2))


def least_share(before: float, after: float, floor: float) -> float:
    """Of a gap, what an odd effect takes that is listed; rms errors of the nominal replay and the corrected one.

    The remainder counts no less than the floor: a tenth of an error that nobody would notice is no cause of a gap.
    """
    return min(LISTED, (_RETURNS * max(after, floor) / before) ** 2)


def shown_in(
    plant: Plant,
    found: Fit,
    effects: Sequence[tuple[int, ...]],
    records: Sequence[Record],
    floor: Float[np.ndarray, " m"],
) -> list[tuple[int, ...]]:
    """Which odd effects show in the runs that were fitted, by what sensors resolve and by their share of the gap there.

    Another motion may have no occasion for one that this log asks for: a limit, at which it hardly is.
    """
    run = Unseen(plant, records, floor)
    energy = run.misses(found.table, np.array([[p.nominal for p in found.table]]))[0]
    errors = run.taken_back(found, effects)
    square = run.missed_by(errors)
    floors = run.squares(run.floor**2)
    least = np.array(
        [least_share(*x) for x in np.sqrt(np.stack([energy, square[0], floors], axis=1))]
    )
    large = np.any((square[1:] - square[0]) / energy > least, axis=1) & run.shown(errors)
    return [rows for rows, shown in zip(effects, large, strict=True) if shown]


def carries_over(new: np.ndarray, old: np.ndarray, least: float) -> bool:
    """Whether one output errs `least` times as much at most, and none more than `WORSE` times."""
    return bool(np.all(new <= max(WORSE, least) ** 2 * old) and np.any(new <= least**2 * old))
