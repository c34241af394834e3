"""`jax-inertia watch`: the mass of chosen bodies while a log is being written."""

import argparse
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from jax_inertia.cli.conventions import add_model, add_prior_mass, positive

if TYPE_CHECKING:
    from jax_inertia.estimation.stream import Part, Stream
    from jax_inertia.logs.log import Log
    from jax_inertia.model.robot import Robot

_DESCRIPTION = """
Follow FILE, a .csv that is still being written (columns as in jax-inertia convert, velocities among them), and print
mass and centre of mass of BODIES as they come, with the normalised innovation squared (NIS) of the filter against its
gate. The noise of each joint is learned from the first seconds. Ends when the file has not grown for a while, or by
Ctrl-C.
"""
_EXAMPLES = """
examples:
  what does the hand weigh right now?
    jax-inertia watch run.csv --model arm.xml --bodies hand

  in a window, from a recorder that writes a CSV
    jax-inertia watch /tmp/joints.csv --model corrected.xml --bodies hand --show

  a line of JSON every tenth of a second, for another program
    jax-inertia watch run.csv --model arm.xml --bodies hand --every 0.1 --json
"""
RATE = 100.0
"""Observations a second that the filter gets, the grid on which `estimate` differentiates: means over longer windows
are not the torque of the mean motion where joints turn at several rad/s."""
ROWS = 64
"""Of a chunk: checks of a chunk cost as much as filtering so many samples."""


def add_parser(subparsers) -> None:
    """Add `watch` to the command line."""
    parser = subparsers.add_parser(
        "watch",
        help="what bodies weigh, while a log is written",
        description=textwrap.dedent(_DESCRIPTION),
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("file", metavar="FILE", type=Path, help=".csv, being written or whole")
    add_model(add, "MJCF or URDF with the bodies as known beforehand")
    add("--bodies", nargs="+", required=True, metavar="B", help="bodies to estimate, by name")
    learn_help = "estimate the noise from the first S seconds (default 3)"
    add("--learn", type=positive, default=3.0, metavar="S", help=learn_help)
    add_prior_mass(add)
    add("--every", type=positive, default=1.0, metavar="S", help="time between lines (default 1 s)")
    idle_help = "end when the file has not grown for S seconds (default 10)"
    add("--idle", type=positive, default=10.0, metavar="S", help=idle_help)
    add("--show", action="store_true", help="draw mass and NIS in a window")
    add("--json", action="store_true", help="a line of JSON for each line")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Do it; raises ValueError with one line where file, model or bodies cannot be used."""
    from jax_inertia.logs.chunks import followed, read_chunks
    from jax_inertia.model.load import load_model
    from jax_inertia.text.closest_names import suggestion

    robot = load_model(args.model)
    for name in args.bodies:
        if name not in robot.body_names:
            known = suggestion(name, robot.body_names)
            raise ValueError(f"{args.model} has no moving body {name!r}; {known}")
    more = followed(args.file, args.idle)
    chunks = read_chunks(args.file, rows=ROWS, names=robot, more=more)
    window, due = _Window(args.bodies) if args.show else None, None
    for part in parts(robot, chunks, args):
        if window is not None:
            window.draw(part)
        if due is None or part.time[-1] >= due:
            due = part.time[-1] + args.every
            print(_line(args, part), flush=True)
    return 0


def parts(robot: "Robot", chunks: "Iterator[Log]", args: argparse.Namespace) -> "Iterator[Part]":
    """The stream's parts as the chunks come, from its first sample on.

    ValueError where too little has come, or what has come is not of this robot and in its units.
    """
    from jax_inertia.cli.console import warn
    from jax_inertia.estimation.stream import joined, looked_at, looked_at_again
    from jax_inertia.preflight.mended import unmeasured

    first = next(chunks)
    for chunk in chunks:
        first = joined(first, chunk)
        if first.duration >= args.learn:
            break
    for finding in looked_at(first, robot).findings:
        warn(f"{args.file}: {finding.message}")
    first, _ = unmeasured(first)
    stream = learned(robot, first, args)
    state, part = stream.feed(stream.start(), first)
    if part is not None:
        yield part
    for chunk in looked_at_again(first, chunks, robot):
        state, part = stream.feed(state, chunk)
        if part is not None:
            yield part
    state, part = stream.finish(state)
    if part is not None:
        yield part


def learned(robot: "Robot", log: "Log", args: argparse.Namespace) -> "Stream":
    """A filter whose noise is what a batch fit of the first seconds leaves."""
    import numpy as np

    from jax_inertia.estimation import batch_fit, log_filter
    from jax_inertia.estimation.priors import Load
    from jax_inertia.estimation.stream import Stream

    mass = 0.1 * float(np.sum(robot.pi[:, 0])) if args.prior_mass is None else args.prior_mass
    prior = Load(mass)
    window = max(1, round(log.rate / RATE))

    def stream(noise: np.ndarray) -> Stream:
        # A quarter of a second at a time: later than that nobody wants to know, and calls have a cost of their own.
        return Stream(
            log_filter.online(robot, args.bodies, noise, prior=prior),
            window,
            block=25,
            look=args.learn,
        )

    observation = stream(np.ones(robot.nv)).observed(log)
    fit = batch_fit.fit(robot, [observation], args.bodies, prior=prior)
    return stream(np.maximum(fit.noise, 1e-9))


def _line(args: argparse.Namespace, part: "Part") -> str:
    """What is known now."""
    import json

    import numpy as np

    now, innovation = part.trace.estimate, part.trace.innovation
    nis, gate = float(np.mean(innovation.nis)), float(part.trace.threshold[-1])
    rejected = int(np.sum(np.asarray(innovation.rejected)))
    bodies = {
        name: (float(now.pi[-1, i, 0]), 1.96 * float(now.sigma_pi[-1, i, 0]), now.com[-1, i])
        for i, name in enumerate(args.bodies)
    }
    if args.json:
        told = {
            name: {"mass_kg": mass, "ci95_half_width_kg": half, "com_m": np.asarray(com).tolist()}
            for name, (mass, half, com) in bodies.items()
        }
        more = {"nis": nis, "gate": gate, "rejected": rejected, "of": len(part.time)}
        return json.dumps({"schema": 1, "time_s": float(part.time[-1]), "bodies": told, **more})
    said = "; ".join(
        f"{name} {mass:.3f} ± {half:.3f} kg, centre {', '.join(f'{1e3 * x:.0f}' for x in com)} mm"
        for name, (mass, half, com) in bodies.items()
    )
    refused = f", {rejected} of {len(part.time)} samples refused" if rejected else ""
    opened = ", gate reopened: a new load" if np.any(part.trace.reopened) else ""
    return f"{part.time[-1]:9.2f} s  {said}  NIS {nis:.1f} (gate {gate:.0f}){refused}{opened}"


class _Window:
    """Mass and NIS over time, redrawn as they come."""

    def __init__(self, bodies: list[str]) -> None:
        from matplotlib import pyplot

        self.plt, self.bodies, self.seen = pyplot, bodies, []
        pyplot.ion()
        self.figure, self.axes = pyplot.subplots(2, 1, sharex=True, layout="constrained")

    def draw(self, part: "Part") -> None:
        import numpy as np

        trace = part.trace
        values = trace.estimate.pi[:, :, 0], trace.estimate.sigma_pi[:, :, 0], trace.innovation.nis
        self.seen.append((part.time, *values, trace.threshold))
        time, mass, sigma, nis, gate = (np.concatenate(x) for x in zip(*self.seen, strict=True))
        for ax in self.axes:
            ax.clear()
        for i, name in enumerate(self.bodies):
            low, high = mass[:, i] - 2 * sigma[:, i], mass[:, i] + 2 * sigma[:, i]
            self.axes[0].fill_between(time, low, high, alpha=0.25, lw=0)
            self.axes[0].plot(time, mass[:, i], label=name.replace("$", r"\$"))
        self.axes[0].set_ylabel("mass, ± 2 σ [kg]")
        self.axes[0].legend(loc="upper left")
        self.axes[1].semilogy(time, nis, ".", ms=4)
        self.axes[1].semilogy(time, gate, "k-", lw=1)
        self.axes[1].set(xlabel="time [s]", ylabel="NIS, and its gate")
        self.plt.pause(0.001)
