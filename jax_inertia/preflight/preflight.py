"""Look at a log before anything is fitted to it: what would make results wrong, and what would make
them poor.

Each finding is one line: what, where, what would be right. Errors are for logs that give wrong
answers (a velocity of the wrong sign, joints the model does not have); warnings for what an
engineer would look at first.
"""

from collections.abc import Iterator, Sequence
from typing import Protocol, runtime_checkable

import equinox as eqx
import numpy as np

from jax_inertia.logs.findings import Finding, Severity
from jax_inertia.logs.joint_names import proposal
from jax_inertia.logs.log import Log, LogError, TorqueUnit
from jax_inertia.logs.schema import check_time
from jax_inertia.model.robot import Robot
from jax_inertia.preflight import cross_channel as consistency
from jax_inertia.preflight import single_channel as channels
from jax_inertia.preflight.against_model import judged
from jax_inertia.preflight.joint_ranges import end_stops, impossible_motion, joint_ranges
from jax_inertia.preflight.position_targets import position_targets
from jax_inertia.signals.filtering import gap_limit, mask
from jax_inertia.text.closest_names import listed, suggestion

__all__ = ["Finding", "Names", "Preflight", "Severity", "preflight", "require_usable"]

_GAP_PERIODS = 3.0
_JITTER_NOTE, _JITTER_WARNING = 0.05, 0.3
_FEW_SAMPLES, _SHORT_SECONDS = 10, 1.0
_SLOWEST, _FASTEST = 10.0, 2e4
_NO_MOTION = 0.5
NO_TORQUE = (
    "the log has no torque (tau), which this needs; of a position-controlled robot, `jax-inertia diagnose` and "
    "`jax-inertia replay` need only qpos_target and qpos"
)
"""What who needs torque says of a log without."""


@runtime_checkable
class Names(Protocol):
    """What a robot calls its joints and bodies; `Robot` satisfies it."""

    @property
    def joint_names(self) -> tuple[str, ...]: ...
    @property
    def joint_type(self) -> tuple[str, ...]: ...
    @property
    def body_names(self) -> tuple[str, ...]: ...


class Preflight(eqx.Module):
    """The findings on one log, the gravest first."""

    findings: tuple[Finding, ...] = eqx.field(static=True)
    confirmed: bool = eqx.field(static=True, default=False)
    """Whether the log's torque shows that its positions are what the model takes them for."""

    def of(self, severity: Severity) -> tuple[Finding, ...]:
        """The findings of one severity."""
        return tuple(finding for finding in self.findings if finding.severity is severity)

    def only(self, check: str) -> "Preflight":
        """The findings of one check."""
        return Preflight(tuple(finding for finding in self.findings if finding.check == check))

    @property
    def ok(self) -> bool:
        """Whether nothing was found that makes results wrong."""
        return not self.of(Severity.ERROR)

    def raise_for_errors(self) -> None:
        """Raise `LogError` with the first error, and how many more there are."""
        errors = self.of(Severity.ERROR)
        if len(errors) > 0:
            others = len(errors) - 1
            more = f" (and {others} more error{'s' * (others > 1)})" if others else ""
            raise LogError(errors[0].message + more)

    def __str__(self) -> str:
        return "\n".join(map(str, self.findings)) or "nothing found"


def preflight(log: Log, robot: Names | None = None, fixed: Sequence[str] = ()) -> Preflight:
    """Check a log, and where a robot is given its names against it.

    Of a `Robot` the torque is compared with the model's, too (`against_model`).
    `fixed` names joints of the robot that the log may lack. Values are looked at after bridging
    what is not finite, so that one dropout is one finding. Raises nothing.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.preflight.preflight import preflight
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> found = preflight(swing().select(["elbow"]), load_model(double_pendulum()))
    >>> found.ok, found.findings[0].check
    (False, 'joint_missing')
    """
    findings = [Finding(Severity.NOTE, "reader", note) for note in log.notes]
    findings += _unit(log)
    if robot is not None:
        findings += _names(log, robot, fixed)
    time = np.asarray(log.time, dtype=float)
    stamps = list(_stamps(time))
    findings += stamps
    # Rates and intervals mean nothing while the stamps are wrong.
    if not any(finding.severity is Severity.ERROR for finding in stamps):
        # Absurd values may overflow; what is then not a number fails its check's comparison.
        with np.errstate(all="ignore"):
            findings += list(_values(log, time, robot))
    # Counts of an encoder are a unit of which the model's torque knows more.
    sound = all(f.severity is not Severity.ERROR or f.check == "counts" for f in findings)
    confirmed = False
    if sound and not fixed and isinstance(robot, Robot):
        findings, confirmed = _with_model(findings, log, robot)
    order = list(Severity)
    findings = sorted(findings, key=lambda finding: order.index(finding.severity))
    return Preflight(tuple(findings), confirmed)


def _with_model(findings: list[Finding], log: Log, robot: Robot) -> tuple[list[Finding], bool]:
    """The findings with those of a comparison with the model: of its torque, or else of its joints' ranges.

    And whether the torque confirms the positions.
    """
    found, confirmed = judged(log, robot)
    if confirmed:
        findings = [f for f in findings if f.check != "degrees"]
    more = [*found]
    if not (confirmed or found or any(f.check == "counts" for f in findings)):
        more += joint_ranges(log, robot)
        if not more:
            more += impossible_motion(log, robot)
    if not any(f.severity is Severity.ERROR for f in more):
        more += end_stops(log, robot)
    if any(f.severity is Severity.ERROR and f.check in POSITIONS for f in more):
        findings = [f for f in findings if f.check not in ("counts", "degrees")]
    return [*findings, *more], confirmed


POSITIONS = ("counts", "degrees", "unit", "range", "order")
"""Checks of the comparison that say in which unit, and in whose column, positions are."""


def require_usable(
    log: Log, robot: Names, *, any_unit: bool = False, of_many: bool = False
) -> None:
    """Raise `LogError` where a log is not of this robot, or its numbers cannot be reckoned with.

    What every way from a log to a result asks of it, in Python as on the command line: torques in N m (unless
    `any_unit`: gains are to be applied), joints and contacts of the model, stamps that increase, and channels that
    were measured for the most part. One chunk `of_many` may be short, and miss a channel.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.preflight.preflight import require_usable
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> require_usable(swing(), load_model(double_pendulum()))
    """
    if log.tau is None:
        raise LogError(NO_TORQUE)
    if not any_unit and log.tau_unit is not TorqueUnit.NEWTON_METRE:
        raise LogError(
            f"tau is in {log.tau_unit_text[:60]!r}, not N m; apply one gain per joint first: "
            "log.with_torque_gains(N m per unit)"
        )
    time = np.asarray(log.time, dtype=float)
    findings = list(_names(log, robot, ()))
    if not of_many:
        findings += [*_stamps(time), *channels.dropped(log, time)]
    elif time.size > 1:
        check_time(time)
    Preflight(tuple(findings)).raise_for_errors()


def _values(log: Log, time: np.ndarray, robot: Names | None) -> Iterator[Finding]:
    yield from channels.dropped(log, time)
    log = mask(log).log
    kinds = {} if robot is None else dict(zip(robot.joint_names, robot.joint_type, strict=True))
    yield from channels.frozen(log, time)
    yield from channels.repeated(log, time)
    yield from channels.saturated(log, time)
    yield from channels.registers(log)
    yield from channels.spikes(log, time)
    yield from channels.degrees(log, kinds)
    yield from channels.wrapped(log, time, kinds)
    yield from channels.still(log)
    for finding in position_targets(log, kinds):
        # Who has torque need not know what the targets are.
        grave = finding.severity is Severity.ERROR and log.tau is None
        yield finding if grave else finding._replace(severity=Severity.WARNING)
    yield from consistency.velocity(log, time, kinds)
    yield from consistency.quaternion(log)
    yield from consistency.base_frames(log, time)
    yield from consistency.accelerometer(log)


def _unit(log: Log) -> Iterator[Finding]:
    if log.tau_unit is not TorqueUnit.NEWTON_METRE:
        message = (
            f"tau is in {log.tau_unit_text!r}, not N m; give one gain per joint in N m per unit, "
            "or have gains estimated"
        )
        yield Finding(Severity.WARNING, "torque_unit", message)


def _names(log: Log, robot: Names, fixed: Sequence[str]) -> Iterator[Finding]:
    kinds = dict(zip(robot.joint_names, robot.joint_type, strict=True))
    scalar = [name for name, kind in kinds.items() if kind in ("slide", "hinge")]
    if scalar and not set(log.joint_names) & set(scalar):
        pairs = proposal(log.joint_names, scalar) or "FILE=MODEL"
        message = (
            f"the model has none of the log's joints, {listed(log.joint_names, 8)}, but {listed(scalar, 8)}; where "
            f"they are the same: jax-inertia convert IN OUT --rename '{pairs}'"
        )
        yield Finding(Severity.ERROR, "joint_name", message)
        return
    for name in log.joint_names:
        if name not in scalar:
            message = f"the model has no hinge or slide {name!r}; {suggestion(name, scalar)}"
            yield Finding(Severity.ERROR, "joint_name", message)
    for name in (name for name, kind in kinds.items() if kind == "ball" and name not in fixed):
        message = f"joint {name!r} of the model is a ball, and a log holds hinges and slides: use three hinges for it"
        yield Finding(Severity.ERROR, "joint_kind", message)
    needed = [name for name in scalar if name not in fixed]
    if missing := [name for name in needed if name not in log.joint_names]:
        message = (
            f"the log lacks joints of the model: {', '.join(missing)}; log them, or hold each where it was: "
            f"--fix {missing[0]}=VALUE [rad, m]"
        )
        yield Finding(Severity.ERROR, "joint_missing", message)
    if loops := getattr(robot, "loops", ()):
        message = (
            f"the model has a closed loop ({listed(loops)}), whose constraint carries torque that no log of joints "
            "tells: such robots cannot be judged; take the constraint out only if the real robot has none"
        )
        yield Finding(Severity.ERROR, "loop", message)
    for driven in getattr(robot, "driven", ()):
        after = f"follows {driven.master!r}" if driven.master else "is kept in its place"
        message = (
            f"joint {driven.joint!r} {after} in the model (joint equality, mimic), by a constraint whose torque no log "
            "of joints tells: hold both where they stand still (`jax_inertia.model.joint_match.same_joints` does), or "
            "take the constraint out if the real robot has none"
        )
        yield Finding(Severity.ERROR, "coupled", message)
    floating = [name for name, kind in kinds.items() if kind == "free" and name not in fixed]
    yield from _base(log, floating[0] if floating else None)
    if log.imu_body and log.imu_body not in robot.body_names:
        message = (
            f"the model has no body {log.imu_body!r} (imu_body); "
            f"{suggestion(log.imu_body, robot.body_names)}"
        )
        yield Finding(Severity.ERROR, "imu_body", message)
    for name in log.contact_bodies:
        if name not in robot.body_names:
            message = (
                f"the model has no body {name!r} (contact); {suggestion(name, robot.body_names)}"
            )
            yield Finding(Severity.ERROR, "contact_body", message)


def _base(log: Log, floating: str | None) -> Iterator[Finding]:
    """Whether a log tells of its base what the model asks, and what it tells besides."""
    of_base = [
        name
        for name in ("base_pos", "base_quat", "base_linvel", "base_angvel", "base_linacc")
        if getattr(log, name) is not None
    ]
    if floating is None:
        if of_base:
            message = f"the log has {listed(of_base)} but the model's base is fixed: not used"
            yield Finding(Severity.WARNING, "base", message)
        return
    if log.base_quat is None:
        message = (
            f"the model's base floats (joint {floating!r}) but the log lacks base_quat (its attitude, wxyz); log it "
            "with base_angvel and base_linacc of an IMU, or with base_pos; of a robot that hung in the air: "
            "--fix-base"
        )
        yield Finding(Severity.ERROR, "base", message)
        return
    unused = []
    if log.base_pos is None:
        means = "base_linacc (IMU)" if log.base_linacc is not None else "feet that stand"
        message = (
            f"the log has no base_pos: how the base accelerates is taken from {means}, which is all that the equations "
            "of motion need"
        )
        yield Finding(Severity.NOTE, "base", message)
    else:
        unused += ["base_linacc"] * (log.base_linacc is not None)
    if log.base_pos is not None or log.contact_wrench is not None:
        unused += [n for n in ("contact_force", "contact_flag") if getattr(log, n) is not None]
    if unused:
        message = f"read and not used, since the log holds better data: {listed(unused)}"
        yield Finding(Severity.NOTE, "unused", message)


def _stamps(time: np.ndarray) -> Iterator[Finding]:
    if time.size < _FEW_SAMPLES:
        message = f"the log holds {time.size} samples; at least {_FEW_SAMPLES}, better thousands"
        yield Finding(Severity.ERROR, "short", message)
        return
    period = np.diff(time)
    if (back := ~(period > 0)).any():
        k = int(np.argmax(back)) + 1
        message = (
            f"time does not increase at sample {k} ({time[k]:.6g} s after {time[k - 1]:.6g} s), "
            f"{back.sum()} times in all; sort the rows and drop repeated stamps"
        )
        yield Finding(Severity.ERROR, "stamps", message)
        return
    typical = float(np.median(period))
    if time[-1] - time[0] < _SHORT_SECONDS:
        message = f"the log lasts {time[-1] - time[0]:.3g} s; a fit needs some seconds of motion"
        yield Finding(Severity.WARNING, "short", message)
    if not _SLOWEST <= 1 / typical <= _FASTEST:
        message = (
            f"the median period is {typical:.3g} s ({time[-1] - time[0]:.6g} s in all): are stamps in another unit? "
            "--time-unit says which"
        )
        # A sample a second or fewer holds no motion of a robot.
        grave = typical >= _NO_MOTION
        yield Finding(Severity.ERROR if grave else Severity.WARNING, "rate", message)
    gaps = period > _GAP_PERIODS * typical
    if gaps.any():
        k = int(np.argmax(period))
        masked = int(np.sum(period > gap_limit(time)))
        fate = f"{masked} of them will be masked" if masked else "short enough to be bridged"
        message = (
            f"time has {gaps.sum()} gap{'s' * bool(gaps.sum() > 1)} above three periods, "
            f"the longest {1e3 * period[k]:.3g} ms at {time[k]:.4g} s (period {1e3 * typical:.3g} ms); {fate}"
        )
        yield Finding(Severity.WARNING if masked else Severity.NOTE, "gap", message)
    low, high = np.percentile(period, [5, 95])
    if (high - low) > _JITTER_NOTE * typical:
        grave = (high - low) > _JITTER_WARNING * typical
        message = (
            f"stamps jitter: 5-95 % of the periods lie in {1e3 * low:.3g}-{1e3 * high:.3g} ms "
            f"(median {1e3 * typical:.3g}); resample to a uniform grid before differentiating"
        )
        yield Finding(Severity.WARNING if grave else Severity.NOTE, "jitter", message)
