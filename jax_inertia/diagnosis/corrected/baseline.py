"""Plain least squares of four terms a joint, what an engineer writes in an hour, for comparison with every result.

    τ − model = d q̇ + F sign q̇ + I q̈ + b

joint by joint, on rows in which it moves. Nothing is chosen, and nothing has a prior.
"""

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.checks import HeldOut, OtherRun
from jax_inertia.diagnosis.residual import Residual

SIGN = 0.003
"""Speed within which sign q̇ turns round, as tanh [rad/s; slides in 0.1 m/s]: a tenth of what counts as rest."""


def terms(residual: Residual) -> Float[np.ndarray, "R n 4"]:
    """q̇, sign q̇, q̈ and one, filtered as a row's torque is."""
    c = residual.context
    whole = (c.v, np.tanh(c.v / c.radian / SIGN), c.a, np.ones_like(c.v))
    return np.stack([residual.prepared.finish_torque(x) for x in whole], axis=-1)


def left_by_least_squares(own: Residual, run: HeldOut | OtherRun) -> Float[np.ndarray, "R n"]:
    """Residual of a run's rows by terms fitted to the log's, or to its other parts [N m]."""
    columns, there = terms(own), terms(run.residual)
    out = run.residual.y.copy()
    for j in own.context.joint_dofs.values():
        for trained, judged in run.parts(own.weight):
            root = np.sqrt(trained[:, j])
            theta = np.linalg.lstsq(columns[:, j] * root[:, None], own.y[:, j] * root, rcond=None)
            out[judged[:, j], j] -= there[judged[:, j], j] @ theta[0]
    return out
