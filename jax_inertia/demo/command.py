"""`jax-inertia demo`: the whole story on built-in data."""

import argparse
from pathlib import Path

_DESCRIPTION = """
A seven-joint arm, simulated in MuJoCo, moves, picks up a load that its model knows nothing of, and puts it down. A
Kalman filter on plain parameters and extended Kalman filters on physical ones weigh it as they go. Writes log.npz,
model.xml and demo.png.
"""


def add_parser(subparsers) -> None:
    """Add `demo` to the command line."""
    parser = subparsers.add_parser(
        "demo", help="the whole story on built-in data", description=_DESCRIPTION
    )
    add = parser.add_argument
    add("--out", type=Path, default=Path("out/demo"), metavar="DIR", help="default: out/demo")
    add("--show", action="store_true", help="open the figure in a window")
    add(
        "--seed",
        type=_whole,
        default=0,
        metavar="N",
        help="another motion and other noise (default 0)",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate, estimate, draw, print."""
    from jax_inertia._console import output_folder, stages
    from jax_inertia.demo import comparison, figure, simulation
    from jax_inertia.log import write_log

    scenario = simulation.Scenario(seed=args.seed)
    with stages() as stage, output_folder(args.out) as folder:
        stage("simulating 14 s of an arm in MuJoCo")
        recording = simulation.simulate(scenario)
        write_log(recording.log, folder / "log.npz")
        (folder / "model.xml").write_text(recording.model_xml)
        stage("estimating (most of the time is compiling)")
        compared = comparison.compare(recording, scenario)
        stage("drawing")
        figure.draw(compared).savefig(folder / "demo.png", dpi=110)
    _print(compared, args.out)
    if args.show:
        _show(compared)
    return 0


def _print(compared, out: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    scenario, console = compared.scenario, Console()
    table = Table(
        title=f"a load of {scenario.load.mass} kg, picked up at {scenario.pick_up:g} s, put down at "
        f"{scenario.put_down:g} s",
        title_justify="left",
    )
    for column in (
        "filter",
        "found in",
        "rms error",
        "let go in",
        "unphysical",
    ):
        table.add_column(column, justify="left" if column == "filter" else "right")
    for one in compared.runs:
        score = one.score
        table.add_row(
            one.name,
            _seconds(score.found_after),
            f"{1e3 * score.rms:.0f} g" if score.rms < scenario.load.mass else "diverged",
            _seconds(score.let_go_after),
            f"{score.unphysical} of {len(compared.time)}",
        )
    console.print(table)
    console.print(
        "Found: the load's mass right to 5 %, and it stays so; rms error: over the second half of the carrying; "
        "unphysical: samples whose estimate no body can have."
    )
    console.print(f"Figure: {out / 'demo.png'}", soft_wrap=True)
    again = f"jax-inertia estimate {out / 'log.npz'} --model {out / 'model.xml'} --bodies hand"
    console.print(f"The same log through the main command:\n  {again}", soft_wrap=True)


def _seconds(value: float | None) -> str:
    return "not" if value is None else f"{value:.2f} s"


def _show(compared) -> None:
    import matplotlib.pyplot as plt
    from matplotlib.backends.registry import BackendFilter, backend_registry

    from jax_inertia._console import warn
    from jax_inertia.demo.figure import draw

    windows = backend_registry.list_builtin(BackendFilter.INTERACTIVE)
    if plt.get_backend().lower() not in windows:
        warn("no window can be opened here; the figure is in the file above")
        return
    draw(compared, plt.figure(figsize=(9.0, 9.5), layout="constrained"))
    plt.show()


def _whole(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number")
    return int(text)
