"""All effects, in the order in which ties are broken."""

from collections.abc import Sequence

from jax_inertia.diagnosis.effects import (
    actuator,
    dry_friction,
    encoder,
    environment,
    external_force,
    generic,
    generic_forms,
    inertial,
    joint,
    transmission,
)
from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.logs.log import Log
from jax_inertia.logs.schema import TorqueKind

EFFECTS: tuple[Effect, ...] = (
    joint.ViscousFriction(),
    dry_friction.CoulombFriction(),
    joint.Armature(),
    joint.TorqueBias(),
    dry_friction.AsymmetricCoulomb(),
    dry_friction.StribeckFriction(),
    dry_friction.LoadFriction(),
    joint.AsymmetricViscous(),
    joint.QuadraticViscous(),
    joint.FrictionDrift(),
    joint.JointSpring(),
    joint.Cogging(),
    actuator.TorqueGain(),
    actuator.TorqueSaturation(),
    actuator.TorqueSpeed(),
    actuator.TimeDelay(),
    actuator.ActuatorLag(),
    actuator.TorqueFilter(),
    encoder.EncoderOffset(),
    encoder.EncoderScale(),
    encoder.JointElasticity(),
    encoder.Backlash(),
    transmission.JointCoupling(),
    environment.GravityTilt(),
    environment.ContactForceScale(),
    inertial.Payload(),
    inertial.ComShift(),
    inertial.LinkInertia(),
    external_force.ConstantForce(),
    external_force.Drag(),
    external_force.Push(),
    generic.OfPosition(),
    generic.OfSpeed(),
    generic.OfTime(),
    generic.FrictionOfPosition(),
    generic.MemoryOfPosition(),
    generic.Swinging(),
    generic.PathOfTorque(),
    generic_forms.OtherLength(),
    generic_forms.WarpedEncoder(),
    generic_forms.SoftStop(),
    generic_forms.GainOfPosition(),
    generic_forms.DriftingClock(),
    generic_forms.LoadRipple(),
)
NAMES = tuple(sorted(e.name for e in EFFECTS if e.named))
BY_CURRENT: tuple[Effect, ...] = tuple(
    actuator.DriveGain() if isinstance(e, actuator.TorqueGain) else e for e in EFFECTS
)
"""The same where torques are currents times constants."""
LEVEL_OF = {e.name: e.level for e in EFFECTS if e.level}
"""Of each law that holds an ordinary effect's number too, that effect."""


def effects_of(log: Log) -> tuple[Effect, ...]:
    """Effects that a log's torques may show."""
    return BY_CURRENT if log.tau_kind is TorqueKind.CURRENT else EFFECTS


def known(family: str, extra: Sequence[Effect] = ()) -> Effect | None:
    """The effect of that name, a user's own among them; None where there is none."""
    return next((e for e in (*EFFECTS, *extra) if e.name == family), None)
