"""Every family of effects that the diagnosis knows."""

from jax_inertia.gap.families import body, drive, encoder, force, friction, joint, world
from jax_inertia.gap.families.base import Columns, Family, Parameter, Place

LIBRARY: tuple[Family, ...] = (
    joint.ViscousFriction(),
    friction.CoulombFriction(),
    friction.AsymmetricCoulomb(),
    friction.StribeckFriction(),
    friction.LoadFriction(),
    joint.FrictionDrift(),
    joint.Armature(),
    joint.JointSpring(),
    joint.Cogging(),
    drive.TorqueGain(),
    drive.TorqueBias(),
    drive.TorqueSaturation(),
    drive.TimeDelay(),
    drive.ActuatorLag(),
    encoder.EncoderOffset(),
    encoder.EncoderScale(),
    encoder.JointElasticity(),
    encoder.Backlash(),
    world.GravityTilt(),
    world.ContactForceScale(),
    body.Payload(),
    body.ComShift(),
    body.LinkInertia(),
    force.ConstantForce(),
    force.Drag(),
    force.Push(),
)

NAMES = tuple(sorted(f.name for f in LIBRARY))

__all__ = ["LIBRARY", "NAMES", "Columns", "Family", "Parameter", "Place"]
