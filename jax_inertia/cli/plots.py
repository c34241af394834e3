"""Figures of estimates. Colours are Okabe and Ito's, which colour-blind readers tell apart."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from jax_inertia.estimation.inertial_filter import Trace
from jax_inertia.estimation.log_estimate import LogEstimate
from jax_inertia.estimation.suggest.excitation import Suggestion
from jax_inertia.estimation.suggest.motion_limits import Limits
from jax_inertia.maths.inertial_parameters import PI_NAMES
from jax_inertia.text.words import from_start

BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#CC79A7",
    "#56B4E9",
)
GREY = "#666666"
_AXES = ((BLUE, "-", "x"), (VERMILION, "--", "y"), (GREEN, "-.", "z"))


def estimate_figure(found: LogEstimate) -> Figure:
    """Mass, centre of mass and inertia with ±2 σ of every body, physical check, NIS with gate, residuals."""
    bodies, e = len(found.bodies), found.trace.estimate
    time, axis_of_time = from_start(found.time)
    figure = Figure(figsize=(max(9.5, 4.6 * bodies), 12.0), layout="constrained")
    top, bottom = np.asarray(figure.subfigures(2, 1, height_ratios=[3.4, 1.6]))
    grid = top.subplots(
        4, bodies, squeeze=False, sharex=True, gridspec_kw={"height_ratios": [4, 4, 4, 0.7]}
    )
    pi, sigma = np.asarray(e.pi), np.asarray(e.sigma_pi)
    com, com_sigma = np.asarray(e.com), np.asarray(e.sigma_com)
    for i, name in enumerate(found.bodies):
        model = np.asarray(found.robot.pi)[found.robot.body_index(name)]
        mass, centre, inertia, strip = grid[:, i]
        mass.set_title(name, fontweight="bold")
        _mass(mass, found, i, model[0])
        for k, (colour, line, axis) in enumerate(_AXES):
            band(centre, time, 1e3 * com[:, i, k], 1e3 * com_sigma[:, i, k], colour, line, axis)
            j = PI_NAMES.index(f"I{axis}{axis}")
            band(inertia, time, pi[:, i, j], sigma[:, i, j], colour, line, PI_NAMES[j])
        moments = [PI_NAMES.index(k) for k in ("Ixx", "Iyy", "Izz")]
        limits(mass, pi[:, i, 0], sigma[:, i, 0])
        limits(centre, 1e3 * com[:, i], 1e3 * com_sigma[:, i])
        limits(inertia, pi[:, i, moments], sigma[:, i, moments])
        centre.set_ylabel("centre of mass [mm]" if i == 0 else "")
        inertia.set_ylabel("inertia about the\nbody's origin [kg m²]" if i == 0 else "")
        for axes in (centre, inertia):
            legend_above(axes, 3)
        physical_strip(strip, time, [found.physical[:, i]], [""])
        strip.set_ylabel("physical" if i == 0 else "", rotation=0, ha="right", va="center")
        strip.set_xlabel(axis_of_time)
    left, right = bottom.subplots(1, 2, gridspec_kw={"width_ratios": [1.4, 1]})
    nis_axes(left, time, found.trace, axis_of_time)
    _residual_marks(right, found)
    return figure


def band(
    axes: Axes,
    time: Float[np.ndarray, " T"],
    value: Float[np.ndarray, " T"],
    sigma: Float[np.ndarray, " T"],
    colour: str,
    line: str = "-",
    label: str = "",
) -> None:
    """A line with its ±2 σ band."""
    axes.plot(time, value, color=colour, ls=line, lw=1.3, label=label)
    axes.fill_between(time, value - 2 * sigma, value + 2 * sigma, color=colour, alpha=0.2, lw=0)


def physical_strip(
    axes: Axes,
    time: Float[np.ndarray, " T"],
    physical: Sequence[Bool[np.ndarray, " T"]],
    labels: Sequence[str],
) -> None:
    """One row for each run: light where the estimate is a physical body, dark where it is none."""
    image = np.array([~row for row in physical], float)
    extent = (time[0], time[-1], len(labels) - 0.5, -0.5)
    colours = ListedColormap(["#cfe8f7", "#222222"])
    axes.imshow(
        image, aspect="auto", extent=extent, cmap=colours, vmin=0, vmax=1, interpolation="nearest"
    )
    axes.set_yticks(range(len(labels)), labels)
    axes.grid(False)
    held = np.concatenate(list(physical))
    axes.text(
        1.01,
        0.5,
        f"{np.sum(held)} of\n{held.size}" if len(labels) == 1 else "",
        transform=axes.transAxes,
        va="center",
    )


def nis_axes(
    axes: Axes, time: Float[np.ndarray, " T"], trace: Trace, axis_of_time: str = "time [s]"
) -> None:
    """Normalised innovation squared of every sample, with the gate and what it rejected."""
    nis, rows, accepted, rejected = (
        np.asarray(x)
        for x in (
            trace.innovation.nis,
            trace.innovation.rows,
            trace.innovation.accepted,
            trace.innovation.rejected,
        )
    )
    threshold, reopened = np.asarray(trace.threshold), np.asarray(trace.reopened)
    floor = 1e-2
    shown = np.maximum(nis, floor)
    axes.semilogy(time[accepted], shown[accepted], ".", ms=3, color=BLUE, label="accepted")
    if np.any(rejected):
        axes.semilogy(time[rejected], shown[rejected], "x", ms=5, color=VERMILION, label="rejected")
    for k, at in enumerate(time[reopened]):
        axes.axvline(at, color=PURPLE, lw=1, ls=":", label="gate reopened" if k == 0 else None)
    if np.any(np.isfinite(threshold)):
        axes.semilogy(time, threshold, color="black", lw=1, label="gate")
    axes.semilogy(time, np.maximum(rows, floor), color=GREY, ls="--", lw=1, label="expected mean")
    axes.set(xlabel=axis_of_time, ylabel="NIS of a sample [–]")
    legend_above(axes, 5)


def _mass(axes: Axes, found: LogEstimate, i: int, model: float) -> None:
    e = found.trace.estimate
    pi, sigma = np.asarray(e.pi)[:, i, 0], np.asarray(e.sigma_pi)[:, i, 0]
    band(axes, from_start(found.time)[0], pi, sigma, BLUE, "-", "filter, ± 2 σ")
    axes.axhline(model, color=GREY, ls=":", lw=1.2, label="model")
    if not found.changed:
        whole = float(found.fit.estimate.pi[i, 0])
        axes.axhline(whole, color=ORANGE, ls="--", lw=1.4, label="batch, whole log")
    axes.set_ylabel("mass [kg]" if i == 0 else "")
    legend_above(axes, 3)


def _residual_marks(axes: Axes, found: LogEstimate) -> None:
    rows = found.row_names
    marks = [
        (found.fit.rms_before, GREY, "s", "model"),
        (found.online_rms, VERMILION, "D", "filter, one sample ahead"),
    ]
    if not found.changed:
        marks.append((found.fit.rms_after, BLUE, "o", "batch fit"))
    at = np.arange(len(rows))
    values = np.array([value for value, *_ in marks])
    axes.hlines(at, values.min(axis=0), values.max(axis=0), color=GREY, lw=0.8)
    for value, colour, marker, label in marks:
        axes.plot(value, at, marker, color=colour, label=label, ms=6)
    axes.set_yticks(at, rows, fontsize=8)
    axes.invert_yaxis()
    axes.set_xscale("log")
    low, high = values[values > 0].min(initial=np.inf), values.max()
    if low < high:
        axes.set_xlim(10 ** np.floor(np.log10(low)), 10 ** np.ceil(np.log10(high)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(axis="x", which="both", color="#dddddd", lw=0.6)
    axes.set_xlabel("residual, rms [N m; N on slides]")
    legend_above(axes, 2)


def legend_above(axes: Axes, columns: int) -> None:
    """A legend that hides no data."""
    axes.legend(
        loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=columns, fontsize=8, frameon=False,
        columnspacing=1.2, handletextpad=0.4,
    )  # fmt: skip


def limits(axes: Axes, value: Float[np.ndarray, "T *k"], sigma: Float[np.ndarray, "T *k"]) -> None:
    """Show the lines but for the wildest hundredth, and as much of the bands as they wear when settled."""
    low, high = np.nanpercentile(value, [1, 99])
    margin = max(3 * float(np.nanmedian(sigma)), 0.15 * (high - low), 1e-9)
    axes.set_ylim(low - margin, high + margin)


def suggestion_figure(found: Suggestion, bounds: Limits) -> Figure:
    """A suggested motion with its limits, and what a log of it would leave uncertain."""
    figure = Figure(figsize=(10.5, 6.4), layout="constrained")
    left, right = np.asarray(figure.subfigures(1, 2, width_ratios=[1.35, 1]))
    top, middle, bottom = left.subplots(3, 1, sharex=True)
    colours = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, GREY)
    for j, name in enumerate(found.joint_names):
        style = {"color": colours[j % 7], "ls": ("-", "--", ":")[j // 7 % 3], "lw": 1.2}
        top.plot(found.time, found.q[:, j], label=name, **style)
        middle.plot(found.time, found.v[:, j] / bounds.velocity[j], **style)
        size = bounds.torque[j] if np.isfinite(bounds.torque[j]) else np.abs(found.tau[:, j]).max()
        bottom.plot(found.time, found.tau[:, j] / max(size, 1e-12), **style)
    for axes in (middle, bottom):
        axes.axhline(1.0, color=GREY, lw=0.8, ls=":")
        axes.axhline(-1.0, color=GREY, lw=0.8, ls=":")
    top.set_ylabel("position [rad, m]")
    middle.set_ylabel("velocity / limit")
    bottom.set(ylabel="torque / limit", xlabel="time [s]")
    if len(found.joint_names) <= 14:
        legend_above(top, min(4, len(found.joint_names)))
    known = found.known
    names = [f"{body}.{name}" for body in known.bodies for name in PI_NAMES]
    at = np.arange(len(names))
    axes = right.subplots()
    prior = known.prior_sigma.ravel()
    shares = [(found.random.sigma.ravel() / prior, GREY, "s", "a random motion")]
    shares.append((known.sigma.ravel() / prior, BLUE, "o", "the suggested one"))
    axes.hlines(at, shares[1][0], shares[0][0], color="#bbbbbb", lw=1.0)
    for value, colour, marker, label in shares:
        axes.plot(value, at, marker, color=colour, label=label, ms=6)
    axes.axvline(1.0, color=GREY, ls=":", lw=1.0)
    axes.set_xscale("log")
    axes.set_yticks(at, names, fontsize=8 if len(names) <= 30 else 5)
    axes.invert_yaxis()
    axes.grid(axis="x", which="major", color="#dddddd", lw=0.6)
    axes.set_xlabel("posterior σ, as a share of the prior's")
    legend_above(axes, 2)
    return figure
