"""Figures of a whole-robot report, as SVG. Colours are Okabe and Ito's, which colour-blind readers tell apart."""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from jax_inertia.diagnosis.report.drawing import BLUE, GREY, ORANGE, STYLE, embedded
from jax_inertia.diagnosis.result import Diagnosis, Trace
from jax_inertia.text.words import from_start

WIDTH = 5.2
SHOWN_SECONDS = 6.0
"""Of a run, about the moment that the nominal model misses most: lines of a whole run lie on each other [s]."""


def joints(found: Diagnosis) -> str:
    """Torque error of each joint before and after, on a logarithmic scale."""
    shrink = found.checked
    names = list(shrink.per_joint)
    before, after = (np.array([shrink.per_joint[n][k] for n in names]) for k in (0, 1))
    with rc_context(STYLE):
        figure = Figure((WIDTH, 1.1 + 0.3 * len(names)), layout="constrained")
        axes = figure.subplots()
        at = np.arange(len(names))
        axes.hlines(at, after, before, color=GREY, linewidth=1.2)
        axes.plot(before, at, "o", color=ORANGE, label="nominal model")
        axes.plot(after, at, "s", color=BLUE, label="with what was found")
        axes.set_xscale("log")
        axes.xaxis.set_minor_formatter(NullFormatter())
        # Mathematics is off, since names come from files.
        axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        axes.set_yticks(at, names)
        axes.invert_yaxis()
        axes.set_xlabel("torque error, rms of moving rows [N m]")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return embedded(figure)


def torques(found: Diagnosis) -> list[tuple[str, str]]:
    """(joint, figure) of every joint: its torque measured, by the nominal model, and with what was found."""
    trace = found.trace
    part = _worst_part(trace)
    time, axis = from_start(trace.time[part])
    out = []
    for name in (n for n in found.joints if n in trace.rows):
        row = trace.rows.index(name)
        measured = trace.state["tau"][part, row]
        lines = (
            (measured, GREY, 3.0, "measured"),
            (measured + trace.before[part, row], ORANGE, 1.0, "nominal model"),
            (measured + trace.after[part, row], BLUE, 1.0, "with what was found"),
        )
        with rc_context(STYLE):
            figure = Figure((WIDTH, 2.0), layout="constrained")
            axes = figure.subplots()
            for values, colour, width, label in lines:
                axes.plot(time, values, color=colour, linewidth=width, label=label)
            axes.set(xlabel=axis, ylabel=f"torque [{found.units[name]}]")
            axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
            out.append((name, embedded(figure)))
    return out


def _worst_part(trace: Trace) -> slice:
    """The rows of `SHOWN_SECONDS` in which the nominal model errs most, each joint by its own error."""
    error = trace.moving * trace.before**2
    size = (error / np.maximum(error.mean(axis=0), 1e-300)).sum(axis=1)
    count = int(np.searchsorted(trace.time - trace.time[0], SHOWN_SECONDS, side="right"))
    if count >= len(size):
        return slice(0, len(size))
    start = int(np.argmax(np.convolve(size, np.ones(count), mode="valid")))
    return slice(start, start + count)


def along_state(found: Diagnosis, joint: str) -> str:
    """Torque residual of one joint against its position, velocity and torque, before and after."""
    trace = found.trace
    row = trace.rows.index(joint)
    moves = trace.moving[:, row] >= 0.5
    slides = found.units[joint] == "N"
    angle = "m" if slides else "rad"
    labels = {
        "q": f"position [{angle}]",
        "v": f"velocity [{angle}/s]",
        "tau": f"torque [{found.units[joint]}]",
    }
    with rc_context(STYLE):
        figure = Figure((WIDTH, 2.6), layout="constrained")
        every = figure.subplots(1, len(labels), sharey=True)
        for axes, (signal, label) in zip(every, labels.items(), strict=True):
            x = trace.state[signal][moves, row]
            for values, colour, size in ((trace.before, ORANGE, 2.6), (trace.after, BLUE, 1.3)):
                axes.plot(x, values[moves, row], ".", ms=size, color=colour, rasterized=True)
            axes.set_xlabel(label)
            axes.xaxis.set_major_locator(MaxNLocator(3))
        every[0].set_ylabel(f"torque residual [{found.units[joint]}]")
    return embedded(figure)


def along_time(found: Diagnosis, joint: str) -> str:
    """Torque residual of one joint along the checked run, before and after."""
    trace = found.trace
    row = trace.rows.index(joint)
    with rc_context(STYLE):
        figure = Figure((WIDTH, 2.6), layout="constrained")
        axes = figure.subplots()
        rests = trace.moving[:, row] < 0.5
        for values, colour, label in (
            (trace.before, ORANGE, "nominal model"),
            (trace.after, BLUE, "with what was found"),
        ):
            y = np.where(rests, np.nan, values[:, row])
            time, axis = from_start(trace.time)
            axes.plot(time, y, color=colour, linewidth=1.0, label=label)
        axes.set_xlabel(axis)
        axes.set_ylabel(f"torque residual [{found.units[joint]}]")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.2), ncols=2)
    return embedded(figure)
