"""The arrays behind a diagnosis, on the chain's slow grid: what figures, bootstraps and places are computed from."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.gap.energies import Counted
from jax_inertia.gap.families.force import hardest
from jax_inertia.gap.pool import Pool
from jax_inertia.gap.shrink import Sight


@dataclasses.dataclass(frozen=True)
class BodyForce:
    """The missing torque projected back to one body as a world force at its centre of mass."""

    body: str
    share: float
    """Of the gap's energy, what a force that is constant over half a second explains; 0 for no more than chance."""
    peak: float
    """Largest force of any half second [N]."""


@dataclasses.dataclass(frozen=True)
class Trace:
    """Signals of a diagnosis: R samples, nv rows; time [s] counts from the log's first sample."""

    time: Float[np.ndarray, " R"]
    rows: tuple[str, ...]
    """The joint's name for hinges and slides, `base[k]` for the others."""
    units: tuple[str, ...]
    """Of each row's torque: N m, or N."""
    q: Float[np.ndarray, "R nv"]
    v: Float[np.ndarray, "R nv"]
    tau: Float[np.ndarray, "R nv"]
    rest: Bool[np.ndarray, "R nv"]
    """Where friction at rest makes the torque arbitrary, or nothing was measured, and just after: left out of every
    mean."""
    missing: Float[np.ndarray, "R nv"]
    """Missing torque y [N m; N on slides]."""
    effects: tuple[Float[np.ndarray, "R nv"], ...]
    """Torque of each finding, fitted to the whole log [N m]."""
    left: tuple[Float[np.ndarray, "R nv"], ...]
    """y after one, two ... findings, each stretch predicted from the others [N m]."""
    noise: Float[np.ndarray, " nv"]
    """Standard deviation of y's noise [N m]."""
    torque_noise: Float[np.ndarray, " nv"] | None
    """Of each sample of the torque, where the log states none and shows another than its samples do [N m]."""
    turning: Float[np.ndarray, " nv"]
    """Over which displacement each joint's dry friction turns round after a reversal [rad], or `turning.CREEPS`."""
    excused: Float[np.ndarray, "R nv"]
    """What the nominal model's own errors most likely have in y, beside all findings [N m]."""
    erring: Float[np.ndarray, "R nv"]
    """The same once friction turns round over `turning`."""
    energy: Float[np.ndarray, "R nv"]
    """Squared whitened missing torque: about one where there is no gap; zero where a sample is not used."""
    forces: tuple[BodyForce, ...]
    """The most telling body first."""
    gap: tuple[int, ...]
    """Rows that hold the gap, in units of their noise or in N m: those that the shrink is of."""
    counted: Counted
    """Samples and frequencies of those rows that the shrink is of."""


def collect(
    pool: Pool,
    effects: tuple[np.ndarray, ...],
    left: tuple[np.ndarray, ...],
    excused: Float[np.ndarray, "R nv"],
    erring: Float[np.ndarray, "R nv"],
    turning: Float[np.ndarray, " nv"],
    torque_noise: Float[np.ndarray, " nv"] | None,
    replicas: Float[np.ndarray, "K R nv"],
    sight: Sight,
) -> Trace:
    """Gather the signals of one run; `effects`, `left`, `excused` and `erring` are finished torques as in `Trace`."""
    context, evidence = pool.context, pool.evidence
    prepared = context.prepared
    missing = prepared.finish_torque(prepared.missing)
    noise = np.sqrt(np.mean(np.asarray(replicas) ** 2, axis=(0, 1)))
    return Trace(
        time=context.time[prepared.kept],
        rows=context.row_names,
        units=tuple("N m" if r else "N" for r in context.robot.topology.dof_rotates),
        q=prepared.finish(context.joint_position),
        v=prepared.finish(context.v),
        tau=prepared.finish(context.tau),
        rest=~evidence.used,
        missing=missing,
        effects=effects,
        left=left,
        noise=noise,
        torque_noise=torque_noise,
        turning=turning,
        excused=excused,
        erring=erring,
        energy=evidence.unflatten(evidence.raw[:, 0]) ** 2,
        forces=_forces(pool, missing / noise, noise),
        gap=tuple(sight.rows),
        counted=sight.on(pool.evidence),
    )


def _forces(pool: Pool, y: np.ndarray, noise: np.ndarray, window: float = 0.5) -> tuple:
    """Least squares of y/σ over each window by Jᵀ f/σ, f constant; energies above the noise's own.

    Along what hardly turns a joint in its window a force may have any size: there it stays small beside the hardest.
    """
    context = pool.context
    weak = np.eye(3) * (3.0 / hardest(context)) ** 2
    prepared = context.prepared
    time = context.time[prepared.kept]
    label = ((time - time[0]) / window).astype(int)
    excess = max(float(np.sum(y**2) - y.size), 1e-300)
    out = []
    for index, body in enumerate(context.robot.body_names):
        rows = prepared.finish_torque(context.force_rows[:, index]) / noise[None, :, None]
        explained, peak, count = 0.0, 0.0, 0
        for k in range(label[-1] + 1):
            a, b = rows[label == k].reshape(-1, 3), y[label == k].ravel()
            if len(b) < 12:
                continue
            force = np.linalg.solve(a.T @ a + weak, a.T @ b)
            left = b - a @ force
            explained += float(b @ b - left @ left)
            peak, count = max(peak, float(np.linalg.norm(force))), count + 1
        # Three free numbers a window take three units of noise with them.
        share = (explained - 3 * count) / excess
        out.append(BodyForce(body, float(np.clip(share, 0.0, 1.0)), peak))
    return tuple(sorted(out, key=lambda f: -f.share))


@dataclasses.dataclass(frozen=True)
class Region:
    """Where in a signal of one row the gap's energy lies."""

    row: str
    signal: str
    """'q', 'v' or 'tau'."""
    edges: Float[np.ndarray, " E"]
    """Quintiles of the signal over the log."""
    share: Float[np.ndarray, " B"]
    """Of the row's energy above noise, by quintile: 0.2 each where the signal does not matter."""


def regions(trace: Trace) -> tuple[Region, ...]:
    """The loudest row's excess energy against its own q, v and τ, by quintiles."""
    loud = int(np.argmax(trace.energy.sum(axis=0)))
    excess = np.maximum((trace.missing[:, loud] / trace.noise[loud]) ** 2 - 1.0, 0.0)
    out = []
    for signal in ("q", "v", "tau"):
        x = getattr(trace, signal)[:, loud]
        edges = np.quantile(x, np.linspace(0, 1, 6))
        place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, 4)
        energy = np.bincount(place, weights=excess, minlength=5)
        share = energy / max(energy.sum(), 1e-300)
        out.append(Region(trace.rows[loud], signal, edges, share))
    return tuple(out)
