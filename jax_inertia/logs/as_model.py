"""Joints as the model has them: their names, hinges without jumps by whole turns."""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np

from jax_inertia.logs.joint_names import fitted, note_of
from jax_inertia.logs.unwrap import beside, unwrapped
from jax_inertia.text.closest_names import listed


@runtime_checkable
class JointNames(Protocol):
    """What a robot calls its joints; `Robot` satisfies it."""

    @property
    def joint_names(self) -> tuple[str, ...]: ...
    @property
    def joint_type(self) -> tuple[str, ...]: ...


def kinds_of(names: JointNames | None) -> dict[str, str]:
    """hinge, slide ... of the robot's joints, by name; empty without a robot."""
    return {} if names is None else dict(zip(names.joint_names, names.joint_type, strict=True))


def as_model(
    fields: Mapping[str, Any], names: JointNames | None, before: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """The fields of a log, checked, with the model's joint names and angles laid end to end, and notes on both.

    `before` are the last positions of what came before [rad], by joint.
    """
    out, notes = dict(fields), list(fields.get("notes", ()))
    wanted = [name for name, kind in kinds_of(names).items() if kind != "free"]
    if renamed := fitted(out["joint_names"], wanted):
        out["joint_names"] = tuple(renamed.get(name, name) for name in out["joint_names"])
        notes.append(note_of(renamed))
    notes += _lay_out(out, names, before or {})
    return {**out, "notes": tuple(notes)}


def _lay_out(
    fields: dict[str, Any], names: JointNames | None, before: Mapping[str, float]
) -> list[str]:
    """Unwrap positions, and targets with them, in place; notes. Without a model velocities must confirm a jump."""
    kinds, time, told = kinds_of(names), fields["time"], []
    qpos, qvel, target = fields["qpos"].copy(), fields.get("qvel"), fields.get("qpos_target")
    for j, name in enumerate(fields["joint_names"]):
        own = None if qvel is None else qvel[:, j]
        if kinds.get(name, "slide" if kinds or own is None else "hinge") != "hinge":
            continue
        laid, jumps = unwrapped(time, qpos[:, j], own, before.get(name))
        if jumps or not np.array_equal(laid, qpos[:, j], equal_nan=True):
            qpos[:, j] = laid
            if target is not None:
                target = target.copy()
                target[:, j] = beside(target[:, j], laid)
            told.append(f"{name} ({jumps} jumps)")
    if not told:
        return []
    fields |= {"qpos": qpos} if target is None else {"qpos": qpos, "qpos_target": target}
    return [f"angles wrapped at a whole turn were laid end to end: {listed(told)}"]
