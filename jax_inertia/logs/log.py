"""A robot's log: time, joint positions, velocities and torques, and what is known about them.

`Log` is a pytree, so that simulated and measured logs go through the same code; files are for
`jax_inertia.logs.log_files`. What is structurally wrong raises `LogError`; what is only suspicious is for
`jax_inertia.preflight.preflight` to say. Units: s, rad (m on slide joints), rad/s, N m; base as in MuJoCo (position
and linear velocity in the world, quaternion wxyz, angular velocity in the body).
"""

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.schema import (
    CHANNELS,
    SHAPES,
    TorqueKind,
    TorqueUnit,
    check_finite,
    check_structure,
    check_time,
)
from jax_inertia.text.closest_names import listed
from jax_inertia.text.notebook_page import has_numbers, line, table

__all__ = ["Log", "LogError", "TorqueKind", "TorqueUnit"]

AnyArray = np.ndarray | jax.Array


def _unit(unit: TorqueUnit | str) -> TorqueUnit:
    parsed = TorqueUnit.parse(str(unit))
    if parsed is TorqueUnit.UNKNOWN and unit != TorqueUnit.UNKNOWN:
        raise LogError(
            f"tau_unit is {str(unit)[:60]!r}; expected {listed(list(TorqueUnit))} (other words go into "
            "tau_unit_text)"
        )
    return parsed


def _kind(kind: TorqueKind | str) -> TorqueKind:
    if kind not in list(TorqueKind):
        raise LogError(f"tau_kind is {str(kind)[:60]!r}; expected {listed(list(TorqueKind))}")
    return TorqueKind(kind)


def _tuple(field: str, texts: Iterable[str]) -> tuple[str, ...]:
    if isinstance(texts, str):
        raise LogError(f"{field} is the text {texts[:60]!r}; expected a tuple: ({texts[:60]!r},)")
    return tuple(map(str, texts))


class Log(eqx.Module):
    """One log of T samples and n joints, every joint column in the order of `joint_names`.

    `contact_wrench` (C contacts) is the force [N] and moment [N m] on the robot in world axes, the
    moment about the frame origin of the body named in `contact_bodies`; those bodies without it may
    touch something, and nobody measured how: perhaps `contact_force`, a scalar in any unit that grows
    with the load, or `contact_flag`, 1 where a foot stands. A floating base that has no `base_pos` has
    an IMU: its attitude `base_quat`, its rate `base_angvel`, and `base_linacc`, the specific force
    [m/s²] at `imu_pos` [m] on `imu_body` (where absent: at the base's origin), in that body's axes.
    `tau` may be absent where there is a `contact_wrench`,
    or `qpos_target`: the position targets of the joints, each from its stamp on, by a loop of
    gains `kp` [N m/rad] and `kd` [N m s/rad], with velocities `qvel_target` and torques `tau_command`
    fed forward. `sigma_*` are standard deviations of one sample.
    `tau_unit_text` is the unit in the log's own words. Raises `LogError` where shapes, names or
    units do not fit together, or a stamp is not finite; other values are not looked at, and it may
    be traced.

    >>> import numpy as np
    >>> from jax_inertia import Log
    >>> time = np.arange(200) * 0.01
    >>> angle = np.sin(time)[:, None]
    >>> Log(time=time, joint_names=("elbow",), qpos=angle, tau=-2.0 * angle).between(0.5, 1.0)
    Log(0.5 s at 100 Hz, 51 samples; joints elbow; qpos, tau; torque unknown in N m)
    """

    time: Float[AnyArray, "T"]
    joint_names: tuple[str, ...] = eqx.field(static=True, converter=partial(_tuple, "joint_names"))
    qpos: Float[AnyArray, "T n"]
    tau: Float[AnyArray, "T n"] | None = None
    qvel: Float[AnyArray, "T n"] | None = None
    tau_kind: TorqueKind = eqx.field(static=True, converter=_kind, default=TorqueKind.UNKNOWN)
    tau_unit: TorqueUnit = eqx.field(static=True, converter=_unit, default=TorqueUnit.NEWTON_METRE)
    tau_unit_text: str = eqx.field(static=True, default="")
    tau_command: Float[AnyArray, "T n"] | None = None
    qpos_target: Float[AnyArray, "T n"] | None = None
    qvel_target: Float[AnyArray, "T n"] | None = None
    kp: Float[AnyArray, "n"] | None = None
    kd: Float[AnyArray, "n"] | None = None
    sigma_qpos: Float[AnyArray, "n"] | None = None
    sigma_tau: Float[AnyArray, "n"] | None = None
    base_pos: Float[AnyArray, "T 3"] | None = None
    base_quat: Float[AnyArray, "T 4"] | None = None
    base_linvel: Float[AnyArray, "T 3"] | None = None
    base_angvel: Float[AnyArray, "T 3"] | None = None
    base_linacc: Float[AnyArray, "T 3"] | None = None
    imu_body: str = eqx.field(static=True, default="")
    imu_pos: Float[AnyArray, "3"] | None = None
    contact_wrench: Float[AnyArray, "T C 6"] | None = None
    contact_force: Float[AnyArray, "T C"] | None = None
    contact_flag: Float[AnyArray, "T C"] | None = None
    contact_bodies: tuple[str, ...] = eqx.field(
        static=True, converter=partial(_tuple, "contact_bodies"), default=()
    )
    notes: tuple[str, ...] = eqx.field(static=True, converter=partial(_tuple, "notes"), default=())

    def __post_init__(self) -> None:
        self.tau_unit_text = self.tau_unit_text or str(self.tau_unit)

    def __check_init__(self) -> None:
        check_structure(vars(self))
        if has_numbers(self.time):
            # Stamps that do not increase are for `preflight` to report.
            check_finite(np.asarray(self.time))
        if (said := TorqueUnit.parse(self.tau_unit_text)) is not self.tau_unit:
            raise LogError(
                f"tau_unit is {self.tau_unit}, but tau_unit_text {self.tau_unit_text[:60]!r} says "
                f"{said}; give both alike"
            )

    @property
    def duration(self) -> float:
        """From the first stamp to the last, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def rate(self) -> float:
        """Samples per second, from the median period: gaps do not count.

        Raises `LogError` naming the first stamp that does not come after the one before.
        """
        time = np.asarray(self.time, dtype=float)
        check_time(time)
        return float(1.0 / np.median(np.diff(time)))

    def between(self, start: float | int, stop: float | int) -> "Log":
        """Keep the samples with start ≤ time ≤ stop [s]; raises `ValueError` where fewer than two
        remain.
        """
        time = np.asarray(self.time)
        rows = np.flatnonzero((time >= start) & (time <= stop))
        if rows.size < 2:
            raise ValueError(
                f"{rows.size} samples lie between {start} and {stop} s; "
                f"the log spans {time[0]:g} to {time[-1]:g} s"
            )
        return self.map_channels(lambda x: x[rows], time=self.time[rows])

    def select(self, joints: Sequence[str]) -> "Log":
        """Keep the named joints, in the order given; raises `ValueError` for one that the log does
        not have.
        """
        if missing := [name for name in joints if name not in self.joint_names]:
            raise ValueError(f"the log has no joint {missing}; it has {list(self.joint_names)}")
        columns = np.array([self.joint_names.index(name) for name in joints], dtype=int)
        per_joint = [name for name, spec in SHAPES.items() if spec[-1] == "n"]
        return dataclasses.replace(
            self,
            joint_names=tuple(joints),
            **{
                name: value[..., columns]
                for name in per_joint
                if (value := getattr(self, name)) is not None
            },
        )

    def with_torque_gains(
        self, gains: Float[AnyArray, "n"] | Sequence[float] | float | int
    ) -> "Log":
        """Turn currents or counts into torques, τ = g · i, by one gain per joint in N m per logged
        unit.

        Raises `ValueError` where the torque is in N m already, or the gains are not one per joint.
        """
        if self.tau_unit is TorqueUnit.NEWTON_METRE:
            raise ValueError("tau is in N m already; gains are for currents and counts")
        if self.tau is None:
            raise ValueError("the log has no tau to give gains to")
        gain = gains if isinstance(gains, jax.Array) else np.asarray(gains, dtype=float)
        if gain.shape not in ((), (len(self.joint_names),)):
            raise ValueError(
                f"gains have shape {gain.shape}; expected one for each of the joints "
                f"{list(self.joint_names)}"
            )
        return dataclasses.replace(
            self,
            tau=self.tau * gain,
            sigma_tau=None if self.sigma_tau is None else self.sigma_tau * abs(gain),
            tau_unit=TorqueUnit.NEWTON_METRE,
            tau_unit_text=f"N m (gains applied to: {self.tau_unit_text})",
        )

    def map_channels(self, function: Callable[[Any], AnyArray], **changes) -> "Log":
        """Apply one function to every channel over time alike (not to `time`), and replace other
        fields.
        """
        mapped = {
            name: function(value) for name in CHANNELS if (value := getattr(self, name)) is not None
        }
        return dataclasses.replace(self, **{**mapped, **changes})

    @property
    def _span(self) -> str:
        if not has_numbers(self.time):
            return "traced"
        if len(self.time) < 2:
            return "no duration"
        period = float(np.median(np.diff(np.asarray(self.time, dtype=float))))
        rate = f"{1.0 / period:.4g} Hz" if period > 0 else "stamps that do not increase"
        return f"{self.duration:.4g} s at {rate}"

    def __repr__(self) -> str:
        names = [name for name in CHANNELS if getattr(self, name) is not None]
        has, torque = ", ".join(names), f"torque {self.tau_kind} in {self.tau_unit_text}"
        text = (
            f"Log({self._span}, {len(self.time)} samples; joints {', '.join(self.joint_names)}; {has}; "
            + (torque if "tau" in names else "no torque")
        )
        if self.contact_bodies:
            text += f"; contacts {', '.join(self.contact_bodies)}"
        return text + (f"; {len(self.notes)} notes)" if self.notes else ")")

    def _repr_html_(self) -> str:
        """For notebooks: the range of each joint's channels, and what the reader noted."""
        if not has_numbers(self.time):
            return line(repr(self))
        names = [n for n in CHANNELS if SHAPES[n][-1] == "n" and getattr(self, n) is not None]
        rows = [
            (joint, *(_range_of(np.asarray(getattr(self, name))[:, j]) for name in names))
            for j, joint in enumerate(self.joint_names)
        ]
        notes = "".join(line(note) for note in self.notes)
        return line(repr(self)) + table(("joint", *names), rows) + notes


def _range_of(x: np.ndarray) -> str:
    """Least and most of what is finite, and how much is not."""
    ok = x[np.isfinite(x)]
    lost = f" ({x.size - ok.size} missing)" if ok.size < x.size else ""
    return (f"{ok.min():.3g} … {ok.max():.3g}" if ok.size else "–") + lost
