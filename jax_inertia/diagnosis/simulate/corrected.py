"""Found effects put into a MuJoCo model: attributes where MJCF has them, a step law for the rest.

What each changes is its own `Effect.edit`; what no attribute can say is listed in <custom> and done by `step_law`.
"""

import itertools
import warnings
from collections.abc import Sequence

from jax_inertia.diagnosis.effects.base import Edit, Effect
from jax_inertia.diagnosis.effects.identified import Identified
from jax_inertia.diagnosis.effects.registry import known
from jax_inertia.diagnosis.result import Correction
from jax_inertia.model.load import ModelWarning, compile_spec
from jax_inertia.model.mujoco_types import MjModel, MjSpec

STEP_LAW = "jax_inertia.diagnosis.simulate.step_law"


def corrected(
    spec: MjSpec, effects: Sequence[Identified], extra: Sequence[Effect] = ()
) -> Correction:
    """Add effects to a spec, which is changed; it must compile. `extra`: effects of your own.

    Raises ValueError for a joint or body that the model does not have.
    """
    with warnings.catch_warnings():
        # Said when the model was loaded; from here on the spec compiles as it is.
        warnings.simplefilter("ignore", ModelWarning)
        model = compile_spec(spec)
    _name_all(spec, model)
    for key in list(spec.keys):
        spec.delete(key)
    inside, outside, neither, notes = [], [], [], []
    # A model that was corrected before has texts of its own.
    taken = {text.name for text in spec.texts}
    names = (name for k in itertools.count() if (name := f"gap_effect_{k}") not in taken)
    in_order = sorted(effects, key=lambda found: _takes_over(known(found.family, extra)))
    for name, found in zip(names, in_order, strict=False):
        effect = known(found.family, extra)
        edit = (effect and effect.edit(spec, spec.compile(), found)) or Edit(whole=False)
        if edit.whole:
            inside.append(found)
            where = "in the model's attributes"
        elif effect is not None and effect.by_step:
            outside.append(found)
            where = f"by {STEP_LAW}"
        else:
            neither.append(found)
            where = "not in this model"
        if edit.remark:
            notes.append(edit.remark)
        # MuJoCo writes texts as CDATA, which a name must not end.
        text = f"{found}; {where}".replace("]]>", "]] >")
        spec.add_text(name=name, data=text)
    spec.compile()
    every = tuple(inside), tuple(outside), tuple(neither), tuple(notes)
    return Correction(spec, *every, tuple(extra))


def _takes_over(effect: Effect | None) -> bool:
    return effect is not None and effect.takes_over


def _name_all(spec: MjSpec, model: MjModel) -> None:
    """Names for what has none, as `load_model` calls it."""
    for k, body in enumerate(spec.bodies):
        if not body.name:
            body.name = f"body_{k}"
    for k, joint in enumerate(spec.joints):
        if not joint.name:
            joint.name = f"joint_{k}"
