"""A log's torque against its model's, less friction: the shares of energy by which readings of the log are judged."""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
import scipy.linalg
import scipy.optimize
from jaxtyping import Bool, Float, Int

from jax_inertia.preflight.torque_parts import Parts

# Joints with less than this share of the largest torque are not judged.
_SLIGHT = 0.02
# Joints that carry: gravity is more than this share of what they need.
_CARRIES = 0.3
# A reading leaves less than this share of the logged torque (root mean square).
_UNEXPLAINED = 0.5
# A joint that is read wrongly misses this share of what joints miss in the mean.
_ALIKE = 0.5
# Mean share of the joints' energy that a load as heavy as the robot must explain.
_AS_HEAVY = 0.1


@dataclasses.dataclass(frozen=True)
class Compared:
    """Torques of R rows and n joints [N m], and the sizes that differences are measured by."""

    parts: Parts
    tau: Float[np.ndarray, "R n"]
    weight: Float[np.ndarray, "R n"]
    inertia: Float[np.ndarray, "R n"]
    shifts: np.ndarray
    """Samples of the grid by which each joint's torque was put later."""

    @classmethod
    def of(cls, parts: Parts) -> "Compared":
        """As logged."""
        weight, inertia = (parts.less_friction(x) for x in (parts.weight, parts.inertia))
        shifts = np.zeros(len(parts.names), int)
        return cls(parts, parts.logged(shifts), weight, inertia, shifts)

    def shifted(self, shifts: np.ndarray) -> "Compared":
        """The same with each torque so many samples later."""
        return dataclasses.replace(self, tau=self.parts.logged(shifts), shifts=shifts)

    def reordered(self, motion: Sequence[int], torque: Sequence[int]) -> "Compared":
        """The same log with its columns in another order (`Parts.reordered`)."""
        other = Compared.of(self.parts.reordered(motion, torque))
        return other.shifted(self.shifts[list(torque)])

    @functools.cached_property
    def load(self) -> Float[np.ndarray, "R n masses"]:
        """Against each of some point masses at the robot's ends."""
        return self.parts.less_friction(self.parts.load)

    @functools.cached_property
    def raw(self) -> Float[np.ndarray, "R n"]:
        """As logged, friction and all."""
        parts = self.parts
        columns = [parts.torque[parts.index + s, j] for j, s in enumerate(self.shifts)]
        return np.stack(columns, axis=1)

    @functools.cached_property
    def needed(self) -> Float[np.ndarray, "R n"]:
        """What the model needs."""
        return self.weight + self.inertia

    @functools.cached_property
    def size(self) -> Float[np.ndarray, " n"]:
        """The larger of each joint's two torques (norm over all rows), and no trifle of its kind's or its own log's.

        Of a rail that does little but speed its own mass up friction leaves next to nothing, which noise hides. A
        slide's N are no measure of a hinge's N m: by them hinges read in mrad missed nothing.
        """
        logged = norm(np.where(self.parts.used, self.raw - self.raw.mean(axis=0), 0.0))
        size, hinge = np.maximum(norm(self.tau), norm(self.needed)), self.parts.hinges
        largest = np.where(
            hinge, size.max(initial=0.0, where=hinge), size.max(initial=0.0, where=~hinge)
        )
        least = np.maximum(_SLIGHT * largest, 1e-300)
        return np.maximum(np.maximum(size, _SLIGHT * logged), least)

    @functools.cached_property
    def judged(self) -> Bool[np.ndarray, " n"]:
        """Joints whose model's torque is no trifle."""
        needed = norm(self.needed)
        return needed > _SLIGHT * needed.max(initial=0.0)

    @functools.cached_property
    def carrying(self) -> Bool[np.ndarray, " n"]:
        """Judged joints that carry a weight."""
        return self.judged & (norm(self.weight) > _CARRIES * norm(self.needed))

    def missed(self, residual: Float[np.ndarray, "R n"]) -> Float[np.ndarray, " n"]:
        """Share of each joint's energy that is in what a reading leaves."""
        return (norm(residual) / self.size) ** 2

    @functools.cached_property
    def gains(self) -> Float[np.ndarray, " n"]:
        """Factor of each joint's torque at what the model needs."""
        square = np.maximum(np.sum(self.needed**2, axis=0), 1e-300)
        return np.sum(self.tau * self.needed, axis=0) / square

    @functools.cached_property
    def weighing(self) -> Bool[np.ndarray, " n"]:
        """Judged joints that would carry a weight if gravity pointed some way."""
        pull = 9.81 * np.sqrt(
            np.sum(self.parts.less_friction(self.parts.gravity) ** 2, axis=(0, 2))
        )
        return self.judged & (pull > _CARRIES * norm(self.inertia))

    def left(
        self,
        needed: Float[np.ndarray, "R n"],
        tau: Float[np.ndarray, "R n"] | None = None,
        joints: Bool[np.ndarray, " n"] | None = None,
    ) -> float:
        """The mean of that over the judged (or some) joints if they need so much, once the best load is carried.

        All is left where that does not explain what was logged, or is next to nothing against it: then the load alone,
        or nothing at all, would be the reading.
        """
        judged = self.judged if joints is None else joints
        tau = self.tau if tau is None else tau
        logged = np.linalg.norm(tau[:, judged])
        if np.linalg.norm(needed[:, judged]) < _CARRIES * logged:
            return np.inf
        unexplained = self.carried(tau - needed)[:, judged]
        if np.linalg.norm(unexplained) > _UNEXPLAINED * logged:
            return np.inf
        return self.left_beside_load(tau - needed, joints)

    def left_beside_load(
        self, residual: Float[np.ndarray, "R n"], joints: Bool[np.ndarray, " n"] | None = None
    ) -> float:
        """`left` of what is to be explained by a load alone; one as heavy as the robot counts as `_AS_HEAVY`."""
        masses = self.masses(residual)
        share = self.missed(residual - self.load @ masses)[
            self.judged if joints is None else joints
        ]
        return float(np.mean(share) + _AS_HEAVY * np.sum((masses / self.mass) ** 2))

    def as_it_stands(self, joints: Bool[np.ndarray, " n"] | None = None) -> float:
        """What the plain model leaves of all joints or some; of a loop, whose gains may be off, with free ones.

        >>> from jax_inertia import load_model
        >>> from jax_inertia.preflight.compared import Compared
        >>> from jax_inertia.preflight.torque_parts import parts
        >>> from jax_inertia.robots.pendulum import double_pendulum, swing
        >>> split = parts(swing(), load_model(double_pendulum()))
        >>> Compared.of(split).as_it_stands() < 0.05
        True
        """
        left = self.left_beside_load(self.tau - self.needed, joints)
        if self.parts.kp is None:
            return left
        free = self.needed * np.maximum(self.gains, 0.0)
        some = self.judged if joints is None else joints
        return min(left, self.left_of_torque(self.tau - free, some))

    @functools.cached_property
    def off(self) -> Int[np.ndarray, " off"]:
        """Joints of which the plain model misses as much as of the others: any that is logged as another is of them."""
        missed = self.missed(self.carried(self.tau - self.needed))
        return np.flatnonzero(missed >= _ALIKE * np.mean(missed[self.judged]))

    def left_of_torque(self, residual: Float[np.ndarray, "R n"], joints: np.ndarray) -> float:
        """The mean share of some joints' logged torque alone: for readings that say that it is tiny, or huge."""
        # Infinite of a torque that is 0.
        with np.errstate(over="ignore"):
            share = (norm(residual) / np.maximum(norm(self.tau), 1e-300)) ** 2
        return float(np.mean(share[joints]))

    def carried(self, residual: Float[np.ndarray, "R n"]) -> Float[np.ndarray, "R n"]:
        """Torques less the best load at the robot's ends."""
        return residual - self.load @ self.masses(residual)

    def masses(
        self, residual: Float[np.ndarray, "R n"], free: bool = False
    ) -> Float[np.ndarray, " masses"]:
        """The load, of no negative mass, that explains torques best [kg]; none where that is not found.

        What is heavy compared with the robot must explain the more, unless it is `free`.
        """
        columns, wanted = self._load_columns, (residual / self.size).ravel()
        try:
            if free:
                basis, triangle = np.linalg.qr(columns)
                aim = basis.T @ wanted
            else:
                triangle = self._load
                aim = scipy.linalg.solve_triangular(triangle, columns.T @ wanted, trans=1)
            return scipy.optimize.nnls(triangle, aim)[0]
        except (RuntimeError, np.linalg.LinAlgError):
            return np.zeros(self.load.shape[-1])

    @functools.cached_property
    def mass(self) -> float:
        """Of the robot [kg]."""
        return max(float(np.asarray(self.parts.robot.pi)[:, 0].sum()), 1e-12)

    @functools.cached_property
    def _load_columns(self) -> np.ndarray:
        return (self.load / self.size[:, None]).reshape(-1, self.load.shape[-1])

    @functools.cached_property
    def _load(self) -> np.ndarray:
        """Root of the normal equations of a load that costs what its mass is: far quicker than orthogonal columns."""
        columns = self._load_columns
        cost = _AS_HEAVY * self.judged.sum() / self.mass**2
        return scipy.linalg.cholesky(columns.T @ columns + cost * np.eye(columns.shape[1]))

    def factors(self, tau: Float[np.ndarray, "R n"] | None = None) -> tuple[float, float]:
        """Factors at gravity's and inertia's torque, both free at every joint that carries, weighed by its torque."""
        tau = self.tau if tau is None else tau
        top, bottom = np.zeros(2), np.zeros(2)
        for j in np.flatnonzero(self.carrying).tolist():
            columns = np.stack([self.weight[:, j], self.inertia[:, j]], axis=1)
            energy = np.sum(columns**2, axis=0)
            gain = np.linalg.lstsq(columns, tau[:, j], rcond=None)[0]
            top, bottom = top + energy * gain, bottom + energy
        out = top / np.maximum(bottom, 1e-300)
        return float(out[0]), float(out[1])

    def called(self, some) -> str:
        """Names of joints by index."""
        return ", ".join(self.parts.names[j] for j in some)


def norm(x: Float[np.ndarray, "R *n"]) -> Float[np.ndarray, "*n"]:
    """Root of the sum of squares over the rows."""
    return np.sqrt(np.sum(x**2, axis=0))
