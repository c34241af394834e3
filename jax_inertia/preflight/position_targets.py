"""Position targets against positions: in the same words, or as raw actions, differences, in another unit or order.

A sound loop follows its targets: at each joint qpos is about qpos_target, a little later, whatever its gains. What else
a channel of targets holds is said from regressions of one on the other, joint by joint, before anything is fitted.
"""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.logs.findings import Finding, Severity
from jax_inertia.logs.log import Log
from jax_inertia.model.robot import HINGE
from jax_inertia.preflight.cross_channel import lag_of
from jax_inertia.preflight.units import POSITIONS, per_joint

# Share of the variance that a joint's targets leave of its positions: of a loop that follows closely, that follows, and
# that does not.
_CLOSE, _FOLLOWS, _LOST = 0.1, 0.25, 0.5
# A loop that carries its joint gives at least half of what is asked, and resonates to no more than twice that.
_LEAST, _MOST = 0.5, 2.0
# A unit is a factor that is met within this share; a loop's own gain at the frequencies of a log is within it, too.
_NEAR = 0.35
_MOVES = 0.02
"""What a joint moves by at least, to be judged [rad, m]."""
_STILL = 0.1
"""What joints move by at least that are not held where they are [rad, m]."""
_LATE, _EARLY = 0.3, 0.1
"""The longest delay of targets that a fit of replays looks for; and what targets that a controller makes of measured
positions are later than these [s]."""
_FAR = 0.3
"""What few loops sag by [rad, m]."""
_SEARCHED = 1.0
"""The longest delay, either way, at which positions are compared with targets [s]."""
_BETTER = 0.25
"""What a delay leaves of what positions at the same moment leave, to be believed."""
_FEW = 20


class _Line(NamedTuple):
    """A regression: slope, offset, and the share of the variance that it leaves."""

    slope: float
    offset: float
    left: float
    delay: float = 0.0
    """By which positions were taken later [s]."""

    @property
    def plain(self) -> bool:
        """Whether the one follows the other as it is, however poorly."""
        return self.left < _LOST and abs(self.slope - 1.0) < _NEAR


class _Channels(NamedTuple):
    """Positions and targets of a log's joints in the rows that hold both, and each joint's regression."""

    names: tuple[str, ...]
    hinges: tuple[bool, ...]
    period: float
    q: Float[np.ndarray, "T n"]
    target: Float[np.ndarray, "T n"]
    moving: list[int]
    own: dict[int, _Line]

    def lines(self, joints: Sequence[int]) -> str:
        """The regressions of some joints in words."""
        return ", ".join(
            f"{self.names[j]} follows {self.own[j].slope:.3g} qpos_target {self.own[j].offset:+.3g}"
            for j in joints
        )


def position_targets(
    log: Log, kinds: Mapping[str, str] = MappingProxyType({})
) -> Iterator[Finding]:
    """What the targets are where they are not the positions that the joints go to; an error for each kind.

    `kinds`: hinge or slide, by name.
    """
    if log.qpos_target is None:
        return
    q, target = np.asarray(log.qpos, float), np.asarray(log.qpos_target, float)
    rows = np.isfinite(q).all(axis=1) & np.isfinite(target).all(axis=1)
    if rows.sum() < _FEW:
        return
    q, target = q[rows], target[rows]
    # A step before the log's beginning has been followed by its middle.
    if not np.ptp(target, axis=0).any() and np.ptp(q[len(q) // 2 :], axis=0).max() > _STILL:
        yield _error("qpos_target never changes, and the joints move: no targets were logged")
        return
    period = float(np.median(np.diff(np.asarray(log.time, float))))
    if not period > 0:
        return
    hinges = tuple(kinds.get(name, HINGE) == HINGE for name in log.joint_names)
    own = {
        j: _best_line(target[:, j], q[:, j], period)
        for j in range(q.shape[1])
        if np.ptp(q[:, j]) > _MOVES and np.ptp(target[:, j]) > 0
    }
    # Targets that hardly change are of a joint that others shake, unless it follows them.
    moving = [j for j, line in own.items() if np.ptp(target[:, j]) > _MOVES or line.left < _CLOSE]
    if not moving:
        return
    c = _Channels(log.joint_names, hinges, period, q, target, moving, own)
    # Given a loop's gains, how far it sags is the model's to say.
    last = (_elsewhere,) if log.kp is None else ()
    for reading in (_differences, _scaled, _turned, _swapped, _in_time, *last):
        if found := list(reading(c)):
            yield from found
            return


def _line(x: np.ndarray, y: np.ndarray) -> _Line:
    """The regression of y on x."""
    slope = float(np.cov(x, y)[0, 1] / max(np.var(x, ddof=1), 1e-300))
    offset = float(y.mean() - slope * x.mean())
    return _Line(slope, offset, float(np.var(y - slope * x - offset) / max(np.var(y), 1e-300)))


def _best_line(x: np.ndarray, y: np.ndarray, period: float) -> _Line:
    """The regression of y on x at the delay at which y follows x or minus x best, if that is far better than none."""
    plain = best = _line(x, y)
    for sign in (1.0, -1.0):
        lag, _ = lag_of(sign * x, y, int(_SEARCHED / period))
        later = round(lag)
        a, b = (x[: len(x) - later], y[later:]) if later >= 0 else (x[-later:], y[:later])
        line = _line(a, b)._replace(delay=later * period)
        # Half a period later a wave is minus itself, about.
        if line.left < _BETTER * best.left and sign * line.slope > 0:
            best = line
    return best if best.left < _BETTER * plain.left else plain


def _scaled(c: _Channels) -> Iterator[Finding]:
    """Joints that follow a multiple of their targets closely: another unit, a policy's raw actions."""
    off = [
        j
        for j in c.moving
        if c.own[j].slope > 0
        and not _LEAST < c.own[j].slope < _MOST
        and c.own[j].left < (_FOLLOWS if len(c.moving) > 1 else _CLOSE)
    ]
    if not off or any(c.own[j].left > _FOLLOWS for j in c.moving):
        return
    for kind in (True, False):
        scaled = [j for j in off if c.hinges[j] == kind]
        factors = {f"is in {unit.name}": unit.size for unit in POSITIONS[kind]}
        factors |= {f"was taken for {unit.name}": 1.0 / unit.size for unit in POSITIONS[kind]}
        for what, factor in factors.items():
            if scaled and all(abs(c.own[j].slope / factor - 1.0) < _NEAR for j in scaled):
                names = [c.names[j] for j in scaled]
                yield _error(
                    f"qpos of {', '.join(names)} follows {factor:.4g} times its targets: qpos_target {what}; give it "
                    f"in {'rad' if kind else 'm'}: jax-inertia convert --target-scale "
                    f"{per_joint(factor, names, c.names)}"
                )
                off = [j for j in off if j not in scaled]
                break
    if off:
        yield _error(
            f"{c.lines(c.moving)}: qpos_target is not where the joints go to (a policy's raw actions?); give target = "
            "default + scale · action: jax-inertia convert --target-scale (scale) --target-offset (JOINT=default)"
        )


def _turned(c: _Channels) -> Iterator[Finding]:
    """Joints that follow minus their targets, which no loop that is stable does."""
    names = [c.names[j] for j in c.moving if c.own[j].slope < 0 and c.own[j].left < _FOLLOWS]
    if names:
        yield _error(
            f"qpos of {', '.join(names)} follows minus its targets: the sign of qpos_target is turned, or of qpos; "
            f"for the former: jax-inertia convert --target-scale {' '.join(f'{name}=-1' for name in names)}"
        )


def _swapped(c: _Channels) -> Iterator[Finding]:
    """Joints that follow another joint's targets."""
    lost = [j for j in c.moving if not c.own[j].plain]
    pairs = []
    for j in lost:
        best = min(c.moving, key=lambda k: _line(c.target[:, k], c.q[:, j]).left)
        follows = _line(c.target[:, best], c.q[:, j]).left < _FOLLOWS
        if best != j and follows and c.own[j].left > _LOST:
            pairs.append(f"{c.names[j]} follows the targets of {c.names[best]}")
    if pairs and len(pairs) == len(lost):
        yield _error(f"{'; '.join(pairs)}: columns go in the order of joint_names")


def _differences(c: _Channels) -> Iterator[Finding]:
    """Targets that are counted from the position at their moment.

    By a loop's law q* − q = a q̈ + b q̇ + c q + d, where c is the load's stiffness over the loop's: of a target's
    difference from q that part is small, and of the target itself c is near 1.
    """
    for j in c.moving:
        q, given = c.q[:, j], c.target[:, j]
        speed = np.gradient(q)
        law = np.stack([np.gradient(speed), speed, q, np.ones_like(q)], axis=1)
        fit = np.linalg.lstsq(law, given, rcond=None)[0]
        explained = np.var(given - law @ fit) < _FOLLOWS * np.var(given)
        small = abs(fit[2]) < _LEAST and np.var(fit[2] * q) < _FOLLOWS * np.var(given)
        if not (explained and small):
            return
    yield _error(
        f"qpos of {', '.join(c.names[j] for j in c.moving)} follows qpos + qpos_target: targets are differences from "
        "the position; give where the joints go to: jax-inertia convert --relative-targets"
    )


def _elsewhere(c: _Channels) -> Iterator[Finding]:
    """Joints that follow closely, far from where they should be."""
    off = {j: float(np.mean(c.q[:, j] - c.target[:, j])) for j in c.moving}
    far = [j for j in c.moving if abs(off[j]) > _FAR and c.own[j].left < _CLOSE]
    if far:
        text = ", ".join(f"{c.names[j]} {off[j]:+.2f}" for j in far)
        yield _warning(
            f"qpos follows qpos_target from afar ({text} rad, m in the mean): targets of another zero (a policy's "
            "default?), or a soft loop that sags; for the former: jax-inertia convert --target-offset "
            f"{' '.join(f'{c.names[j]}={off[j]:.3g}' for j in far)}"
        )


def _in_time(c: _Channels) -> Iterator[Finding]:
    """Positions that are ahead of their targets, or later than any loop makes them; a clock is every joint's."""
    delays = [c.own[j].delay for j in c.moving]
    if any(c.own[j].left > _CLOSE for j in c.moving):
        return
    text = ", ".join(f"{c.names[j]} {1e3 * abs(c.own[j].delay):.0f} ms" for j in c.moving)
    way = "were stamped at different ends, or rows are shifted; put each target at the row from which it holds"
    if max(delays) < -_EARLY:
        yield _error(f"qpos runs ahead of qpos_target ({text}): they {way}")
    elif min(delays) > _LATE:
        yield _warning(f"qpos runs behind qpos_target ({text}): they {way}")


def _error(message: str) -> Finding:
    return Finding(Severity.ERROR, "targets", message)


def _warning(message: str) -> Finding:
    return Finding(Severity.WARNING, "targets", message)
