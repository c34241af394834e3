"""How far a model's numbers may be from the robot's, all together: as arrays, and as texts in an MJCF file.

What a log leaves open it leaves open jointly: a hand that is heavier than believed and a sensor offset that is smaller
may fit it alike. The covariance of the numbers says so; standard deviations of each do not.
"""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from jax_inertia.model.file_safety import ModelError
from jax_inertia.model.mujoco_types import MjModel, MjSpec

JOINT_NUMBERS = ("damping", "frictionloss", "armature", "offset")
"""[N m s/rad, N m, kg m², N m]; offset: logged torque less the joint's."""
_BODY, _JOINT = "errors_of_body/", "errors_of_joint/"


class ModelErrors(eqx.Module):
    """The robot's numbers are the model's + `pi` z and + `joints` z, with z (k,) standard normal."""

    pi: Float[Array, "nb 10 k"]
    """Of each body's π [kg, kg m, kg m²]."""
    joints: Float[Array, "nv 4 k"]
    """Of each row's `JOINT_NUMBERS`."""

    def __check_init__(self) -> None:
        if self.pi.shape[-1] != self.joints.shape[-1]:
            raise ValueError(
                f"pi has {self.pi.shape[-1]} columns, joints {self.joints.shape[-1]}; they share their unknowns"
            )

    def of(self, bodies: Sequence[int], rows: Sequence[int]) -> "ModelErrors":
        """Those of some bodies and rows alone, all others exact, in as few unknowns as that takes."""
        pi, joints = np.zeros(self.pi.shape), np.zeros(self.joints.shape)
        pi[list(bodies)] = np.asarray(self.pi)[list(bodies)]
        joints[list(rows)] = np.asarray(self.joints)[list(rows)]
        nb, nv, k = len(pi), len(joints), pi.shape[-1]
        root = lower_root(np.concatenate([pi.reshape(-1, k), joints.reshape(-1, k)]))
        return ModelErrors(
            jnp.asarray(root[: 10 * nb].reshape(nb, 10, -1)),
            jnp.asarray(root[10 * nb :].reshape(nv, 4, -1)),
        )


def lower_root(root: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n r"]:
    """Another root of the covariance `root rootᵀ` with at most n columns, those that are zero left out."""
    if root.shape[1] == 0:
        return root
    lower = np.asarray(np.linalg.qr(root.T, mode="r")).T
    size = np.abs(lower).max(axis=0)
    return lower[:, size > 1e-12 * size.max(initial=0.0)]


class NamedErrors(NamedTuple):
    """`ModelErrors` by the names of bodies and joints."""

    bodies: Mapping[str, Float[np.ndarray, "10 k"]]
    joints: Mapping[str, Float[np.ndarray, "4 k"]]

    def add_to(self, spec: MjSpec) -> None:
        """Write them into a spec as texts, row by row; those that are there already are replaced."""
        for text in list(spec.texts):
            if text.name.startswith((_BODY, _JOINT)):
                spec.delete(text)
        every = [*self.bodies.values(), *self.joints.values()]
        root = lower_root(np.concatenate(every)) if every else np.zeros((0, 0))
        if not root.size:
            # A diagnosis that kept no number says nothing of the model's.
            return
        parts = np.split(root, np.cumsum([len(x) for x in every])[:-1])
        names = [*(_BODY + n for n in self.bodies), *(_JOINT + n for n in self.joints)]
        for name, part in zip(names, parts, strict=True):
            spec.add_text(name=name, data=" ".join(f"{x:.7g}" for x in part.ravel()))


NO_ERRORS = NamedErrors({}, {})


def errors_in(
    model: MjModel, bodies: Sequence[str], joints: Mapping[str, int], nv: int
) -> ModelErrors | None:
    """What a compiled model says of its own errors; None where it says nothing.

    `joints` are the rows of joints of one degree of freedom. What the texts do not name is exact. Raises ModelError for
    texts that are no numbers, or not as many for all.
    """
    found = {name: text for name, text in _texts(model) if name.startswith((_BODY, _JOINT))}
    if not found:
        return None
    columns = {name: _numbers(name, text) for name, text in found.items()}
    counts = {x.shape[1] for x in columns.values()}
    if len(counts) > 1:
        raise ModelError(
            f"texts {_BODY}… and {_JOINT}… hold {sorted(counts)} columns; all must hold as many: write the model anew, "
            "or remove these texts"
        )
    k = counts.pop()
    pi, rows = np.zeros((len(bodies), 10, k)), np.zeros((nv, 4, k))
    for b, name in enumerate(bodies):
        pi[b] = columns.get(_BODY + name, 0.0)
    for name, row in joints.items():
        rows[row] = columns.get(_JOINT + name, 0.0)
    return ModelErrors(jnp.asarray(pi), jnp.asarray(rows))


def _texts(model: MjModel):
    for i in range(model.ntext):
        start, size = int(model.text_adr[i]), int(model.text_size[i])
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, i)
        yield name or "", bytes(model.text_data[start : start + size]).rstrip(b"\0").decode()


def _numbers(name: str, text: str) -> Float[np.ndarray, "n k"]:
    rows = 10 if name.startswith(_BODY) else len(JOINT_NUMBERS)
    words = re.split(r"[\s,]+", text.strip())
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.zeros(0)
    if not values.size or values.size % rows or not np.all(np.isfinite(values)):
        raise ModelError(
            f"text {name!r} holds no {rows} rows of finite numbers; write the model anew, or remove this text"
        )
    return values.reshape(rows, -1)
