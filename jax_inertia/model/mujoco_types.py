"""MuJoCo's classes for annotations.

A type checker learns nothing of them from the mujoco package, and what is unknown in a signature is an error in a
user's strict code. There they count as `Any`; at run time they are what they are.
"""

from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    MjModel: TypeAlias = Any
    MjData: TypeAlias = Any
    MjSpec: TypeAlias = Any
else:
    from mujoco import MjData, MjModel, MjSpec

__all__ = ["MjData", "MjModel", "MjSpec"]
