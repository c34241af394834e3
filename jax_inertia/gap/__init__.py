"""Diagnosis of the sim-to-real gap: where it lies, which unmodelled effect causes it, how far it shrinks."""

from jax_inertia.gap.diagnosis import diagnose
from jax_inertia.gap.finding import Diagnosis, Finding
from jax_inertia.gap.nuisance import Tolerance
from jax_inertia.gap.verdict import Verdict

__all__ = ["Diagnosis", "Finding", "Tolerance", "Verdict", "diagnose"]
