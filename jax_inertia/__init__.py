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
    from jax_inertia.diagnosis.effects.identified import effects_in
    from jax_inertia.diagnosis.result import Diagnosis, Verdict
    from jax_inertia.diagnosis.simulate.step_law import callback as step_callback
    from jax_inertia.diagnosis.simulate.step_law import mjx_callback as mjx_step_callback
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
    from jax_inertia.estimation.batch_fit import fit as batch_fit
    from jax_inertia.estimation.checkpoint import (
        StateError,
        load_state,
        load_stream,
        save_state,
        save_stream,
    )
    from jax_inertia.estimation.identifiability import knowledge
    from jax_inertia.estimation.inertial_filter import Estimator, State, Step, Trace, make_estimator
    from jax_inertia.estimation.log_estimate import LogEstimate
    from jax_inertia.estimation.log_filter import observe, thinned
    from jax_inertia.estimation.log_filter import online as make_log_filter
    from jax_inertia.estimation.log_filter import run as run_log_filter
    from jax_inertia.estimation.online.exact_memory import make_exact_estimator
    from jax_inertia.estimation.online.exported_step import export_step, write_c_step
    from jax_inertia.estimation.online.load_bank import make_load_bank
    from jax_inertia.estimation.physical_estimate import Estimate
    from jax_inertia.estimation.pipeline import estimate
    from jax_inertia.estimation.priors import Load
    from jax_inertia.estimation.stream import Stream
    from jax_inertia.estimation.suggest.excitation import suggest_motion
    from jax_inertia.estimation.suggest.motion_limits import Limits
    from jax_inertia.logs.chunks import read_chunks
    from jax_inertia.logs.findings import Severity
    from jax_inertia.logs.log import Log, LogError
    from jax_inertia.logs.log_files import read_log, write_log
    from jax_inertia.logs.readers.options import Options
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
    from jax_inertia.model.spec import load_spec, set_inertials
    from jax_inertia.model.urdf_write import write_urdf
    from jax_inertia.preflight.preflight import preflight as check_log
    from jax_inertia.replay.entry import diagnose, to_report
    from jax_inertia.replay.result import Diagnosis as ReplayDiagnosis
    from jax_inertia.signals.differences import Observation
    from jax_inertia.signals.generalised_motion import Motion

__all__ = [
    "Diagnosis",
    "Estimate",
    "Estimator",
    "Limits",
    "Load",
    "Log",
    "LogError",
    "LogEstimate",
    "ModelError",
    "ModelWarning",
    "Motion",
    "Observation",
    "Options",
    "ReplayDiagnosis",
    "Robot",
    "Severity",
    "State",
    "StateError",
    "Step",
    "Stream",
    "Trace",
    "Verdict",
    "batch_fit",
    "body_jacobian",
    "body_poses",
    "centre_of_mass",
    "check_log",
    "condensed_dynamics",
    "contact_torque",
    "diagnose",
    "effects_in",
    "estimate",
    "export_step",
    "from_com",
    "from_log_cholesky",
    "inverse_dynamics",
    "is_physical",
    "knowledge",
    "load_model",
    "load_spec",
    "load_state",
    "load_stream",
    "make_estimator",
    "make_exact_estimator",
    "make_load_bank",
    "make_log_filter",
    "mass_matrix",
    "mjx_step_callback",
    "observe",
    "passive_torque",
    "pseudo_inertia",
    "read_chunks",
    "read_log",
    "run_log_filter",
    "save_state",
    "save_stream",
    "set_inertials",
    "step_callback",
    "suggest_motion",
    "thinned",
    "to_log_cholesky",
    "to_report",
    "torque_regressor",
    "write_c_step",
    "write_log",
    "write_urdf",
]

# As above, for when it runs (`name=public name` where these differ); a test compares the two.
_MODULES = {
    "diagnosis.effects.identified": "effects_in",
    "diagnosis.result": "Diagnosis Verdict",
    "diagnosis.simulate.step_law": "callback=step_callback mjx_callback=mjx_step_callback",
    "dynamics.rigid_body": """body_jacobian body_poses condensed_dynamics contact_torque inverse_dynamics mass_matrix
        passive_torque torque_regressor""",
    "estimation.batch_fit": "fit=batch_fit",
    "estimation.checkpoint": "StateError load_state load_stream save_state save_stream",
    "estimation.suggest.excitation": "suggest_motion",
    "estimation.online.exported_step": "export_step write_c_step",
    "estimation.identifiability": "knowledge",
    "estimation.inertial_filter": "Estimator State Step Trace make_estimator",
    "estimation.log_estimate": "LogEstimate",
    "estimation.log_filter": "observe online=make_log_filter run=run_log_filter thinned",
    "estimation.suggest.motion_limits": "Limits",
    "estimation.online.exact_memory": "make_exact_estimator",
    "estimation.online.load_bank": "make_load_bank",
    "estimation.physical_estimate": "Estimate",
    "signals.generalised_motion": "Motion",
    "estimation.pipeline": "estimate",
    "estimation.priors": "Load",
    "estimation.stream": "Stream",
    "logs.chunks": "read_chunks",
    "logs.findings": "Severity",
    "logs.log": "Log LogError",
    "logs.log_files": "read_log write_log",
    "logs.readers.options": "Options",
    "maths.inertial_parameters": "centre_of_mass from_com from_log_cholesky is_physical pseudo_inertia to_log_cholesky",
    "model.load": "ModelError ModelWarning load_model",
    "model.robot": "Robot",
    "model.spec": "load_spec set_inertials",
    "model.urdf_write": "write_urdf",
    "preflight.preflight": "preflight=check_log",
    "replay.entry": "diagnose to_report",
    "replay.result": "Diagnosis=ReplayDiagnosis",
    "signals.differences": "Observation",
}
_PLACES = {
    entry.rpartition("=")[2]: (module, entry.partition("=")[0])
    for module, entries in _MODULES.items()
    for entry in entries.split()
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        from jax_inertia.text.closest_names import suggestion

        raise AttributeError(f"jax_inertia has no {name!r}; {suggestion(name, __all__)}")
    module, own = _PLACES[name]
    value = getattr(importlib.import_module(f"{__name__}.{module}"), own)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
