"""What the log leaves open of the corrected model's numbers, all together."""

import dataclasses

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.corrected.intervals import joint_slopes
from jax_inertia.diagnosis.effects.identified import Identified
from jax_inertia.diagnosis.effects.inertial import ComShift, LinkInertia, Payload
from jax_inertia.diagnosis.effects.tolerances import inertial_changes
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.model.model_errors import NamedErrors

STEP = 1e-3
"""Of a number's posterior standard deviation, of central differences [1]."""


def model_errors(selection: Selection) -> NamedErrors:
    """Errors of bodies' π and of joints' damping, dry friction, armature and offset, in unknowns of unit variance.

    J L with L Lᵀ = C + V: C the posterior's covariance, V its spread over the log (`Selection.spread`), J the slopes of
    the numbers as corrected.xml holds them. A joint's friction errs, besides, by what its equation may.
    """
    selection = _as_far_off(selection)
    now = selection.posterior
    value, axes = np.linalg.eigh(now.covariance + selection.spread)
    root = axes * np.sqrt(np.maximum(value, 0.0))
    joints, own = {}, {}
    for name, row in selection.residual.context.joint_dofs.items():
        slopes = joint_slopes(selection, name, row)
        viscous, dry, rotor, bias = (
            slopes[f] for f in ("viscous_friction", "coulomb_friction", "armature", "torque_bias")
        )
        # A bias is what acts besides the motor: the logged torque is less by it.
        joints[name] = np.array([viscous[0], dry[0], rotor[0], -bias[0]]) @ root
        own[name] = np.diag([viscous[1], dry[1], rotor[1], bias[1]])
    bodies = {name: slope @ root for name, slope in _body_slopes(selection).items()}
    return _with_own(bodies, joints, own)


def _as_far_off(selection: Selection) -> Selection:
    """With tolerances as large as the numbers that the log determines are off, kind by kind, if that is larger.

    λ² = (1 + Σ z²) / (1 + Σ γ) as in the search (`ordinary`), where few numbers far off are kept from widening a
    tolerance lest it swallow an effect. Numbers that no log determined are no better than those that one did.
    """
    now = selection.posterior
    wide = []
    for h, part in zip(now.chosen, now.slices, strict=True):
        error, learned = now.mean[part] * h.scale, 1.0 - np.diag(now.covariance)[part]
        kinds, scale = h.effect.kinds(h.count), h.scale.copy()
        for kind in np.unique(kinds[kinds >= 0]):
            of = kinds == kind
            size = np.sqrt((1.0 + np.sum(error[of] ** 2)) / (1.0 + np.sum(learned[of])))
            scale[of] = np.maximum(scale[of], size)
        wide.append(dataclasses.replace(h, scale=scale))
    posterior = selection.evidence.posterior(tuple(wide))
    return dataclasses.replace(selection, posterior=posterior)


def _with_own(
    bodies: dict[str, np.ndarray], joints: dict[str, np.ndarray], own: dict[str, np.ndarray]
) -> NamedErrors:
    """With unknowns of each joint's own after those that all share."""
    wide = 4 * len(own)
    out = {}
    for k, (name, shared) in enumerate(joints.items()):
        out[name] = np.pad(shared, ((0, 0), (0, wide)))
        out[name][:, shared.shape[1] + 4 * k : shared.shape[1] + 4 * k + 4] = own[name]
    return NamedErrors({n: np.pad(x, ((0, 0), (0, wide))) for n, x in bodies.items()}, out)


def _body_slopes(selection: Selection) -> dict[str, Float[np.ndarray, "10 p"]]:
    """Of each body's π as it is handed over, by the posterior's numbers."""
    now, context = selection.posterior, selection.residual.context
    out = {
        name: np.zeros((10, len(now.mean)))
        for name, pi in zip(context.robot.body_names, context.pi, strict=True)
        if pi[0] > 0
    }
    base = next((h for h in now.chosen if h.family == "tolerances"), None)
    if base is not None:
        at = now.part(base).start
        for change, name, _ in inertial_changes(context, base.shape):
            size = change.shape[1]
            # The tolerances' torque is what the model needs too much.
            scale = base.scale[at - now.part(base).start :][:size]
            out[name][:, at : at + size] -= change * scale
            at += size
    for h in now.chosen:
        effect, name = h.effect, h.place.name
        if isinstance(effect, Payload | ComShift | LinkInertia) and name in out:
            out[name][:, now.part(h)] += _slope_of(selection, h, effect)
    return out


def _slope_of(
    selection: Selection, h: Hypothesis, effect: Payload | ComShift | LinkInertia
) -> Float[np.ndarray, "10 k"]:
    """Of a body's π by the numbers of an effect on it, in units of their scales."""
    context, part = selection.residual.context, selection.posterior.part(h)
    pi, mean = context.pi[h.place.index], selection.posterior.mean[part] * h.scale
    sigma = np.sqrt(np.diag(selection.posterior.covariance)[part]) * h.scale

    def change(theta: np.ndarray) -> np.ndarray:
        values = {n: p.value for n, p in h.numbers(selection.residual, theta).items()}
        return effect.change(pi, Identified(h.family, "body", h.place.name, values))

    steps = STEP * np.maximum(sigma, 1e-9) * np.eye(h.count)
    slopes = [(change(mean + s) - change(mean - s)) / (2.0 * s.sum()) for s in steps]
    return np.stack(slopes, axis=1) * h.scale
