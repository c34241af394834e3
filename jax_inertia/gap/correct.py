"""Found effects put into a MuJoCo model: attributes where MJCF has them, a callback for the rest.

Attributes of corrected.xml: damping, frictionloss, armature, stiffness and springref, ref (encoder offset), gravity,
inertials, a second hinge in line with the first (elasticity, backlash; where friction is the link's, a tendon along
both), an actuator's gain and delay, its joint's `actuatorfrcrange` (`edits`). What no attribute can say is listed in
<custom> and done by `callbacks`.
"""

import dataclasses
import warnings
from collections.abc import Sequence

from jax_inertia.gap.edits import EDITS
from jax_inertia.gap.effect import Effect
from jax_inertia.model.load import ModelWarning, compile_spec
from jax_inertia.model.mujoco_types import MjModel, MjSpec


@dataclasses.dataclass(frozen=True)
class Correction:
    """A nominal model with effects added."""

    spec: MjSpec
    in_model: tuple[Effect, ...]
    """Done by attributes alone."""
    by_callback: tuple[Effect, ...]
    """Need `callbacks`, at least for torques given by `qfrc_applied`."""
    notes: tuple[str, ...]


def corrected(spec: MjSpec, effects: Sequence[Effect]) -> Correction:
    """Add effects to a spec, which is changed; it must compile.

    Raises ValueError for a joint or body that the model does not have.
    """
    with warnings.catch_warnings():
        # Said when the model was loaded; from here on the spec compiles as it is.
        warnings.simplefilter("ignore", ModelWarning)
        model = compile_spec(spec)
    _name_all(spec, model)
    for key in list(spec.keys):
        spec.delete(key)
    inside, outside, notes = [], [], []
    for effect in effects:
        edit = EDITS.get(effect.family)
        whole, remark = (False, "") if edit is None else edit(spec, spec.compile(), effect)
        (inside if whole else outside).append(effect)
        if remark:
            notes.append(remark)
    for k, effect in enumerate(effects):
        where = "in the model's attributes" if effect in inside else "by jax_inertia.gap.callbacks"
        # MuJoCo writes texts as CDATA, which a name must not end.
        text = f"{effect}; {where}".replace("]]>", "]] >")
        spec.add_text(name=f"gap_effect_{k}", data=text)
    spec.compile()
    return Correction(spec, tuple(inside), tuple(outside), tuple(notes))


def _name_all(spec: MjSpec, model: MjModel) -> None:
    """Names for what has none, as `load_model` calls it."""
    for k, body in enumerate(spec.bodies):
        if not body.name:
            body.name = f"body_{k}"
    for k, joint in enumerate(spec.joints):
        if not joint.name:
            joint.name = f"joint_{k}"
