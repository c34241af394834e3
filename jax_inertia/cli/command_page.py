"""What torques say of a position loop, drawn, as a part of a page about torque and motion."""

import base64
import io

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from jax_inertia.logs.log import Log
from jax_inertia.replay import command
from jax_inertia.replay.loop import Loop
from jax_inertia.replay.output.figures import BLUE, GREY, ORANGE
from jax_inertia.text.report_page import rendered
from jax_inertia.text.words import number

_SHOWN = 4000
"""Points of a joint at most."""


def part(halves: tuple[command.Half, ...], log: Log, loop: Loop | None, effects: list[dict]) -> str:
    """A section of HTML: effects in words, a figure, every joint's numbers; names in it are escaped."""
    out = io.BytesIO()
    figure(halves, log, loop).savefig(out, format="svg", metadata={"Date": None})
    picture = "data:image/svg+xml;base64," + base64.b64encode(out.getvalue()).decode()
    return rendered(
        "jax_inertia.replay",
        {"number": number, "pm": _with_spread},
        template="command.html",
        halves=halves,
        picture=picture,
        lines=[command.sentence(e) for e in effects],
    )


def _with_spread(value: float, sd: float) -> str:
    return f"{number(value)} ± {number(1.96 * sd)}"


def figure(halves: tuple[command.Half, ...], log: Log, loop: Loop | None) -> Figure:
    """Each joint's torque over the error of its position, and the lines of kp as stated and as fitted."""
    rows = command.rows_of(log, loop)
    wide = min(len(halves), 3)
    high = -(-len(halves) // wide)
    with rc_context({"text.parse_math": False, "font.size": 8.5}):
        out = Figure((3.6 * wide, 0.5 + 2.6 * high), layout="constrained")
        for axes, half in zip(
            out.subplots(high, wide, squeeze=False).ravel(), halves, strict=False
        ):
            j = list(log.joint_names).index(half.joint)
            miss, torque = spring(rows[j], half)
            every = max(len(miss) // _SHOWN, 1)
            axes.plot(miss[::every], torque[::every], ".", ms=2, color=GREY, rasterized=True)
            ends = np.array([np.min(miss), np.max(miss)])
            if loop is not None:
                axes.plot(ends, loop.kp[j] * ends, color=ORANGE, lw=1.1, label="kp as stated")
            law = half.kp * (ends - np.clip(ends, -half.dead_band, half.dead_band))
            axes.plot(ends, law, "--", color=BLUE, lw=1.1, label="as fitted")
            for limit in () if half.limit is None else (half.limit, -half.limit):
                axes.axhline(limit, color=BLUE, lw=0.7, ls=":")
            axes.set_title(half.joint, fontsize=8.5, loc="left")
            axes.set_xlabel("target − position [rad]")
            axes.set_ylabel("N m")
            axes.legend(frameon=False)
    return out


def spring(rows: command.Rows, half: command.Half) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the position [rad] and torques without damping, bias and what is fed forward [N m]."""
    columns, tau = rows.at(half.delay)
    return columns[:, 0], tau - half.kd * columns[:, 1] - half.bias
