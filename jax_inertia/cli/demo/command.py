"""`jax-inertia demo`: the whole story on built-in data."""

import argparse
import dataclasses
import json
import math
import textwrap
from pathlib import Path

_DESCRIPTION = """
A seven-joint arm, simulated in MuJoCo, moves, picks up a load that its model knows nothing of, and puts it down. A
Kalman filter on plain parameters and extended Kalman filters on physical ones weigh it as they go. Then the same arm
with a hidden effect, drawn by the seed, is diagnosed. Writes log.npz, model.xml, demo.png, and of the diagnosis
hidden.npz, hidden_test.npz, report.json, report.html and corrected.xml.
"""
_EXAMPLES = """
examples:
  a minute and a half of it, into out/demo
    jax-inertia demo

  another load's motion and another hidden effect, shown in a window
    jax-inertia demo --seed 7 --out seven --show

  its own files through the other commands
    jax-inertia estimate out/demo/log.npz --model out/demo/model.xml --bodies hand
    jax-inertia diagnose out/demo/hidden.npz --model out/demo/model.xml --test-log out/demo/hidden_test.npz
"""


def add_parser(subparsers) -> None:
    """Add `demo` to the command line."""
    parser = subparsers.add_parser(
        "demo",
        help="the whole story on built-in data",
        description=textwrap.dedent(_DESCRIPTION),
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
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
    add("--json", action="store_true", help="print numbers for scripts instead of the tables")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate, estimate, draw, print."""
    from jax_inertia.cli import diagnose_run
    from jax_inertia.cli.console import output_folder
    from jax_inertia.cli.demo import comparison, figure, hidden, simulation
    from jax_inertia.cli.running.stages import stages
    from jax_inertia.logs.log_files import write_log

    scenario = simulation.Scenario(seed=args.seed)
    with stages() as stage, output_folder(args.out) as folder:
        stage("simulating 14 s of an arm in MuJoCo")
        recording = simulation.simulate(scenario)
        write_log(recording.log, folder / "log.npz")
        (folder / "model.xml").write_text(recording.model_xml, encoding="utf-8")
        stage("estimating (most of the time is compiling)")
        compared = comparison.compare(recording, scenario)
        stage("drawing")
        figure.draw(compared).savefig(folder / "demo.png", dpi=110)
        stage("simulating the arm with a hidden effect")
        case = hidden.draw(args.seed)
        write_log(case.log, folder / "hidden.npz")
        write_log(case.test_log, folder / "hidden_test.npz")
        inputs = diagnose_run.read(
            folder / "model.xml", folder / "hidden.npz", folder / "hidden_test.npz", []
        )
        found, report = diagnose_run.by_torque(folder, inputs, [], None, stage)
    if args.json:
        numbers = _numbers(compared, case.secret, found, report)
        print(json.dumps(numbers, indent=1, allow_nan=False))
    else:
        _print(compared, args.out)
        _print_diagnosis(case.secret, found, report, args.out)
    if args.show:
        _show(compared)
    return 0


def _numbers(compared, secret, found, report: dict) -> dict:
    scenario = compared.scenario
    return {
        "schema": 1,
        "load": {
            "mass_kg": scenario.load.mass,
            "picked_up_s": scenario.pick_up,
            "put_down_s": scenario.put_down,
        },
        "samples": len(compared.time),
        "filters": [
            {
                "name": one.name,
                "found_after_s": one.score.found_after,
                "let_go_after_s": one.score.let_go_after,
                "rms_kg": one.score.rms if math.isfinite(one.score.rms) else None,
                "unphysical": one.score.unphysical,
            }
            for one in compared.runs
        ],
        "hidden": {**dataclasses.asdict(secret), "judged": judged(secret, found)},
        "diagnosis": report,
    }


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


def _print_diagnosis(secret, found, report: dict, out: Path) -> None:
    from rich.console import Console

    from jax_inertia.cli import diagnose_output

    console = Console()
    console.print("\nThe same arm, with one effect that its model lacks:")
    diagnose_output.show(found, report, out, as_json=False)
    console.print(f"Hidden was: {secret}. {judged(secret, found)}", soft_wrap=True)
    again = (
        f"jax-inertia diagnose {out / 'hidden.npz'} --model {out / 'model.xml'} "
        f"--test-log {out / 'hidden_test.npz'}"
    )
    console.print(f"The same through the main command:\n  {again}", soft_wrap=True)


def judged(secret, found) -> str:
    """Whether a diagnosis found the secret, in a sentence; a number off by a quarter is not right."""
    doubt = " It trusts none of its own candidates." if str(found.verdict) == "unknown" else ""
    for finding in found.found:
        if (finding.family, finding.place.name) == (secret.family, secret.place):
            value = next(iter(finding.parameters.values())).value
            error = abs(value - secret.size) / abs(secret.size)
            if error > 0.25:
                return f"The diagnosis has the right effect and place, and a wrong number ({value:.3g}).{doubt}"
            return f"The diagnosis was right; its number is off by {100 * error:.1f} %.{doubt}"
        ties = {(t.family, t.place.name) for t in finding.equivalent}
        if (secret.family, secret.place) in ties:
            return f"The diagnosis has it among what it cannot tell apart in this motion.{doubt}"
    if any(f.place.name == secret.place for f in found.found):
        return f"The diagnosis was wrong about the effect, and right about the place.{doubt}"
    return f"The diagnosis was wrong.{doubt}"


def _seconds(value: float | None) -> str:
    return "not" if value is None else f"{value:.2f} s"


def _show(compared) -> None:
    import matplotlib.pyplot as plt
    from matplotlib.backends.registry import BackendFilter, backend_registry

    from jax_inertia.cli.console import warn
    from jax_inertia.cli.demo.figure import draw

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
