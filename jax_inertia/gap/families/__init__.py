"""A plan of search for every effect that the search for single ones knows."""

from jax_inertia.diagnosis.effects.actuator import ActuatorLag, TimeDelay
from jax_inertia.gap.families import body, drive, encoder, force, friction, joint, world
from jax_inertia.gap.families.base import Family

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
    joint.TorqueBias(),
    drive.TorqueSaturation(),
    drive.Late(TimeDelay()),
    drive.Late(ActuatorLag()),
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
