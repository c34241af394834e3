"""What each stratum holds: families, motions, noise, how wrong the nominal model is."""

from __future__ import annotations

from dataclasses import dataclass

FRICTION = ("coulomb_friction", "asymmetric_coulomb", "stribeck_friction", "load_friction")
ARM = (
    *FRICTION,
    *("viscous_friction", "friction_drift", "armature", "joint_spring", "cogging"),
    *("torque_gain", "torque_bias", "torque_saturation", "encoder_offset", "encoder_scale"),
    *("joint_elasticity", "backlash", "time_delay", "actuator_lag", "gravity_tilt", "payload"),
    *("com_shift", "link_inertia", "constant_force", "push", "drag"),
)
LEGGED = (
    *("contact_force_scale", "payload", "coulomb_friction", "gravity_tilt", "torque_gain"),
    *("com_shift", "viscous_friction", "push", "encoder_offset", "armature", "constant_force"),
    *("torque_bias", "time_delay", "joint_spring", "actuator_lag", "stribeck_friction"),
    *("asymmetric_coulomb", "torque_saturation", "load_friction", "link_inertia"),
    *("joint_elasticity",),
)
UNKNOWN = (
    *("joint_coupling", "quadratic_friction", "load_ripple"),
    *("stop_cushion", "length_error", "clock_skew"),
)


@dataclass(frozen=True)
class Stratum:
    """`wrong`, `loud`, `ordinary`: chances of a wrong nominal model, noise x 4, everyday motion.

    `chi2`: the least visibility of each effect, `distinct`: the same after nuisances (check.py);
    `slip`: the longest presliding distance, rad.
    """

    number: int
    families: tuple[str, ...]
    wrong: float = 0.3
    loud: float = 0.0
    ordinary: float = 0.0
    count: int = 1
    small: bool = False
    chi2: float = 300.0
    distinct: float = 150.0
    slip: float = 1e-3
    legged: bool = False


STRATA = {
    "exciting": Stratum(1, ARM),
    "ordinary": Stratum(2, ARM, wrong=0.5, ordinary=1.0),
    "hard": Stratum(
        3, ARM, wrong=1.0, loud=0.5, ordinary=0.3, small=True, chi2=150.0, distinct=100.0
    ),
    "none": Stratum(4, (), wrong=0.6, loud=0.4, ordinary=0.5, count=0),
    "presliding": Stratum(5, FRICTION, wrong=0.5, ordinary=0.5, slip=3e-3),
    "backlash": Stratum(6, ("backlash",), wrong=0.5, ordinary=0.5),
    "legged": Stratum(7, LEGGED, wrong=0.5, loud=0.2, legged=True),
    "unknown": Stratum(8, UNKNOWN, wrong=0.3, ordinary=0.4),
    "pair": Stratum(9, ARM, wrong=0.3, ordinary=0.4, count=2),
    "mixed": Stratum(10, ARM, wrong=0.6, loud=0.3, ordinary=0.5, chi2=200.0),
    "legged_none": Stratum(11, (), wrong=0.6, loud=0.3, count=0, legged=True),
}
