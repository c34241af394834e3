"""report.html of a whole-robot diagnosis: one file, nothing in it is fetched, nothing in it runs."""

from jax_inertia.diagnosis.report import figures
from jax_inertia.diagnosis.report.detectable_sizes import by_family
from jax_inertia.diagnosis.report.drawing import fan
from jax_inertia.diagnosis.report.next_motion import next_step, to_record
from jax_inertia.diagnosis.result import Diagnosis
from jax_inertia.diagnosis.simulate.corrected import Correction
from jax_inertia.diagnosis.simulate.rollout import Rollouts
from jax_inertia.logs.log import Log
from jax_inertia.text.report_page import rendered
from jax_inertia.text.words import chance, interval, number, percent, plain, where

COLUMNS = (
    ("viscous_friction", "viscous friction [N m s/rad]"),
    ("coulomb_friction", "dry friction [N m]"),
    ("armature", "rotor inertia [kg m²]"),
    ("torque_bias", "torque offset [N m]"),
)
"""Of the joints' table."""


def page(
    found: Diagnosis,
    correction: Correction,
    log: Log,
    names: tuple[str, str],
    report: dict,
    rolled: Rollouts | None,
) -> str:
    """The report as HTML, every name in it escaped; `names`: of log and model."""
    filters = {f.__name__: f for f in (plain, number, percent, chance, where, interval)}
    wanted = to_record(found, correction.extra)
    worst = max(found.checked.per_joint, key=lambda n: found.checked.per_joint[n][0])
    remains = max(found.remainder.where, key=lambda n: found.remainder.where[n])
    shown = remains != worst and found.remainder.where[remains] > 0
    return rendered(
        "jax_inertia.diagnosis.report",
        filters,
        found=found,
        correction=correction,
        log=log,
        names=names,
        report=report,
        columns=COLUMNS,
        checked="the other run" if found.test is not None else "held-out rows",
        joints_figure=figures.joints(found),
        torques=figures.torques(found),
        worst=worst,
        worst_figure=figures.along_time(found, worst),
        state_figure=figures.along_state(found, worst),
        wanted=wanted,
        next_step=next_step(found, wanted),
        rolled=rolled,
        fan=None if rolled is None else fan(rolled),
        undetectable=by_family(found.undetectable_below),
        remains=remains,
        remains_figure=figures.along_time(found, remains) if shown else None,
    )
