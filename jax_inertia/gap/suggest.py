"""The motion that would tell apart what this log cannot, of a diagnosis of single effects."""

import numpy as np

from jax_inertia.diagnosis.report import next_motion
from jax_inertia.diagnosis.report.next_motion import Suggestion
from jax_inertia.gap.finding import Diagnosis


def suggestions(found: Diagnosis) -> tuple[Suggestion, ...]:
    """One for each tie that another motion would split, without repeats; none where nothing ties."""
    pairs = (
        (finding.family, finding.place, tie.family, tie.place)
        for finding in found.findings
        for tie in finding.equivalent
        if tie.kind == "motion_limited"
    )
    return next_motion.suggestions(pairs, lambda joint: _peak(found, joint))


def _peak(found: Diagnosis, joint: str) -> float:
    """Fastest usual speed of a joint in this log, of all rows where the place is no joint [rad/s]."""
    trace = found.trace
    v = np.abs(trace.v)
    if joint in trace.rows:
        v = v[:, [trace.rows.index(joint)]]
    return float(np.percentile(v, 99))
