"""Where a fit starts: at the nominal numbers, with gains and times that are looked for."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.replay.fitting.errors import replay_errors
from jax_inertia.replay.loop import ALL, Parameter
from jax_inertia.replay.record import Record
from jax_inertia.replay.simulation.plant import Plant

# Of the log, for the first look at kp and delay [s].
_LOOK = 12.0
_GUESSED = np.array([-5.0, -4.5, -4.0, -3.5, -3.0, -2.4, -1.8, -1.2, -0.6, 0.0])
_SAID = np.array([-0.8, -0.4, -0.2, 0.0, 0.2])
_DELAYS = (0.0, 0.015, 0.03, 0.06, 0.12)


def start(
    plant: Plant, table: Sequence[Parameter], records: Sequence[Record], guessed: bool
) -> Float[np.ndarray, " P"]:
    """The nominal numbers, with the kp of each joint and the times whose replays of the first seconds err least.

    A least-squares step does not find its way over an order of magnitude of kp, nor over a period of the motion.
    """
    theta = np.array([p.nominal for p in table])
    gains = [k for k, p in enumerate(table) if p.family == "kp_scale"]
    late = next(
        (k for k, p in enumerate(table) if p.family == "target_delay" and p.joint == ALL), None
    )
    scales = _GUESSED if guessed else _SAID
    delays = [{}] if late is None else [{late: d} for d in _DELAYS]
    lead = [k for k, p in enumerate(table) if p.family == "torque_lead"]
    if late is not None and lead:
        delays += [{lead[0]: d} for d in _DELAYS[1:]]
    tries = np.repeat(theta[None], len(scales) * len(delays), axis=0)
    for k, (times, s) in enumerate((d, s) for d in delays for s in scales):
        tries[k, gains] = s
        tries[k, list(times)] = list(times.values())
    short = [r.between(0, int(np.searchsorted(r.time, _LOOK))) for r in records]
    square = np.mean(replay_errors(plant.quick, table, tries, short) ** 2, axis=1).reshape(
        len(delays), len(scales), -1, len(plant.names)
    )
    # Outputs in units of their own best; a joint's are its position and, where logged, its torque.
    relative = np.log(square + 1e-8).sum(axis=2)
    best = int(np.argmin(relative.min(axis=1).sum(axis=-1)))
    theta[gains] = scales[np.argmin(relative[best], axis=0)][[table[k].joint for k in gains]]
    theta[list(delays[best])] = list(delays[best].values())
    return theta
