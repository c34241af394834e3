"""Physically consistent inertial estimation and sim-to-real gap diagnosis in JAX.

    import jax_inertia as ji

    robot, log = ji.load_model("arm.xml"), ji.read_log("log.npz")
    print(ji.estimate(robot, log, ["hand"]))    # masses, centres of mass, inertias, with 95 % intervals
    print(ji.diagnose(robot, log).headline)     # which effects the model lacks

A name's module is imported when the name is first used, so that `import jax_inertia` itself takes no time.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jax_inertia.dynamics.rigid_body import (
        body_jacobian,
        body_poses,
        condensed_dynamics,
        contact_torque,
        inverse_dynamics,
        mass_matrix,
        passive_torque,
        torque_regressor,
    )
    from jax_inertia.estimation.checkpoint import StateError, load_state, save_state
    from jax_inertia.estimation.excitation import suggest_motion
    from jax_inertia.estimation.inertial_filter import Estimator, make_estimator
    from jax_inertia.estimation.log_estimate import LogEstimate
    from jax_inertia.estimation.log_filter import observe
    from jax_inertia.estimation.motion_limits import Limits
    from jax_inertia.estimation.online.exact_memory import make_exact_estimator
    from jax_inertia.estimation.online.load_bank import make_load_bank
    from jax_inertia.estimation.pipeline import estimate
    from jax_inertia.estimation.priors import Load
    from jax_inertia.estimation.stream import Stream
    from jax_inertia.logs.log import Log, LogError
    from jax_inertia.logs.log_files import read_log, write_log
    from jax_inertia.maths.inertial_parameters import (
        centre_of_mass,
        from_com,
        from_log_cholesky,
        is_physical,
        pseudo_inertia,
        to_log_cholesky,
    )
    from jax_inertia.model.load import ModelError, ModelWarning, load_model
    from jax_inertia.model.robot import Robot
    from jax_inertia.replay.entry import diagnose, to_report
    from jax_inertia.signals.differences import Observation

__all__ = [
    "Estimator",
    "Limits",
    "Load",
    "Log",
    "LogError",
    "LogEstimate",
    "ModelError",
    "ModelWarning",
    "Observation",
    "Robot",
    "StateError",
    "Stream",
    "body_jacobian",
    "body_poses",
    "centre_of_mass",
    "condensed_dynamics",
    "contact_torque",
    "diagnose",
    "estimate",
    "from_com",
    "from_log_cholesky",
    "inverse_dynamics",
    "is_physical",
    "load_model",
    "load_state",
    "make_estimator",
    "make_exact_estimator",
    "make_load_bank",
    "mass_matrix",
    "observe",
    "passive_torque",
    "pseudo_inertia",
    "read_log",
    "save_state",
    "suggest_motion",
    "to_log_cholesky",
    "to_report",
    "torque_regressor",
    "write_log",
]

# As above, for when it runs; a test holds the two together.
_MODULES = {
    "dynamics.rigid_body": """body_jacobian body_poses condensed_dynamics contact_torque inverse_dynamics mass_matrix
        passive_torque torque_regressor""",
    "estimation.checkpoint": "StateError load_state save_state",
    "estimation.online.exact_memory": "make_exact_estimator",
    "estimation.excitation": "suggest_motion",
    "estimation.inertial_filter": "Estimator make_estimator",
    "estimation.online.load_bank": "make_load_bank",
    "estimation.log_estimate": "LogEstimate",
    "estimation.log_filter": "observe",
    "estimation.motion_limits": "Limits",
    "estimation.pipeline": "estimate",
    "estimation.priors": "Load",
    "estimation.stream": "Stream",
    "logs.log": "Log LogError",
    "logs.log_files": "read_log write_log",
    "maths.inertial_parameters": """centre_of_mass from_com from_log_cholesky is_physical pseudo_inertia
        to_log_cholesky""",
    "model.load": "ModelError ModelWarning load_model",
    "model.robot": "Robot",
    "replay.entry": "diagnose to_report",
    "signals.differences": "Observation",
}
_PLACES = {name: module for module, names in _MODULES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        from jax_inertia.text.closest_names import suggestion

        raise AttributeError(f"jax_inertia has no {name!r}; {suggestion(name, __all__)}")
    value = getattr(importlib.import_module(f"{__name__}.{_PLACES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
