"""What messages advise works: options that they name exist, and lead from a faulty log to one that is used."""

import argparse
import ast
import dataclasses
import re
import shlex
from pathlib import Path

import mujoco
import numpy as np
import pytest

from jax_inertia.cli import estimate
from jax_inertia.cli import main as command_line
from jax_inertia.logs.log import Log
from jax_inertia.logs.log_files import read_log, write_log
from jax_inertia.robots.pendulum import double_pendulum, swing
from jax_inertia.signals.corrections import with_later_torque
from jax_inertia.text.remedies import with_commands

PACKAGE = Path(__file__).parents[1] / "jax_inertia"
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]+")
# Of other programs, which messages name with theirs.
OTHERS = {"--compression-mode"}


def parsers() -> dict[str, argparse.ArgumentParser]:
    commands = argparse.ArgumentParser().add_subparsers(dest="command")
    for command in command_line._COMMANDS:
        command.add_parser(commands)
    return commands.choices


KNOWN = {name: frozenset(one._option_string_actions) for name, one in parsers().items()}


def harvested() -> set[tuple[str, str]]:
    """(module, option) of every text in the package that names an option."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found |= {(path.stem, option) for option in OPTION.findall(node.value)}
    return found


def test_every_option_that_a_text_names_is_one():
    known = set().union(*KNOWN.values()) | {"--no-cache", "--print-completion", "--version"}
    named = harvested()
    assert len(named) > 50
    assert {one for one in named if one[1] not in known | OTHERS} == set()


@pytest.mark.parametrize("command", KNOWN)
def test_a_command_that_lacks_an_option_names_one_that_has_it(command):
    for option in sorted(set().union(*KNOWN.values()) - {"--help"}):
        said = with_commands(f"wrong; give {option} 2", command, KNOWN)
        if option in KNOWN[command]:
            assert said == f"wrong; give {option} 2"
        else:
            first = re.findall(rf"{option} is an option of jax-inertia ([a-z-]+)", said)
            assert option in KNOWN[first[0]]
    # What a message hands to another command is that command's.
    said = "in degrees: jax-inertia convert --degrees; or else --shift-torque 1"
    assert with_commands(said, "estimate", KNOWN) == said


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("remedies")
    mujoco.mj_saveLastXML(str(path / "arm.xml"), double_pendulum())
    return path


def wrong(**channels) -> Log:
    return dataclasses.replace(swing(), **channels)


def motion(factor: float, zero: float = 0.0) -> Log:
    log = swing()
    return wrong(qpos=np.asarray(log.qpos) * factor + zero, qvel=np.asarray(log.qvel) * factor)


def counts() -> Log:
    log = motion(4096 / (2 * np.pi), 2048)
    return dataclasses.replace(log, qpos=np.round(log.qpos))


def targets(change) -> Log:
    """A loop 40 ms behind its targets, by no simulator: a filter of a motion."""
    time = 0.01 * np.arange(1200)
    rng = np.random.default_rng(5)
    rows = [(a, w, p) for a, w, p in rng.uniform((0.1, 1.0, 0.0), (0.4, 4.0, 6.0), (6, 3))]
    wave = sum(a * np.sin(w * time + p) for a, w, p in rows[:3])
    other = sum(a * np.sin(w * time + p) for a, w, p in rows[3:])
    both = np.stack([wave, other], axis=1)
    q, target = both[:-4], both[4:]
    return wrong(time=time[:-4], qpos=q, qvel=None, tau=None, qpos_target=change(q, target))


CONVERTED = {
    "degrees": motion(180 / np.pi),
    "turns": motion(0.5 / np.pi),
    "mrad": motion(1000.0),
    "counts": counts(),
    "one joint in turns": wrong(
        qpos=swing().qpos / np.array([1.0, 2 * np.pi]),
        qvel=swing().qvel / np.array([1.0, 2 * np.pi]),
    ),
    "degrees but not velocities": wrong(qpos=np.degrees(swing().qpos)),
    "targets in degrees": targets(lambda q, t: np.degrees(t)),
    "targets in turns": targets(lambda q, t: t / (2 * np.pi)),
    "targets turned": targets(lambda q, t: t * [1, -1]),
    "targets relative": targets(lambda q, t: t - q),
}


def run(capsys, *arguments: object) -> tuple[int, str]:
    status = command_line.main([str(x) for x in arguments])
    # Beside stages, where the machine is slow.
    lines = capsys.readouterr().err.splitlines()
    return status, "\n".join(x for x in lines if x.startswith("jax-inertia:"))


def looked_at(capsys, log: Path, model: Path, *options: object) -> tuple[int, str]:
    """What the command that takes such a log says of it, before it computes anything."""
    if read_log(log).tau is None:
        out = log.with_suffix("")
        return run(capsys, "replay", log, "--model", model, "--kp", 50, "--kd", 5, "--out", out)
    arguments = ["estimate", log, "--model", model, "--bodies", "lower", *options]
    args = argparse.ArgumentParser().add_subparsers(dest="command")
    estimate.add_parser(args)
    try:
        estimate.read(args.choices["estimate"].parse_args([str(x) for x in arguments[1:]]))
    except ValueError as error:
        return 2, str(error)
    return 0, ""


@pytest.mark.parametrize("fault", CONVERTED)
def test_a_printed_conversion_makes_a_log_that_is_used(fault, folder, capsys):
    path, better = folder / f"{fault}.npz", folder / f"{fault} better.npz"
    write_log(CONVERTED[fault], path)
    status, said = looked_at(capsys, path, folder / "arm.xml")
    assert status == 2
    (advice,) = re.findall(r"jax-inertia convert (--[^;()\n]+?)(?= \(and|;|\n|$)", said)
    status, error = run(capsys, "convert", path, better, *shlex.split(advice))
    assert (status, error) == (0, "")
    status, error = looked_at(capsys, better, folder / "arm.xml")
    assert (status, error) == (0, "")


ESTIMATED = {
    "N mm": wrong(tau=1000.0 * np.asarray(swing().tau)),
    "a motor's side": wrong(tau=np.asarray(swing().tau) / 40.0),
    "turned": wrong(tau=-np.asarray(swing().tau)),
    "late": with_later_torque(swing(), 0.12),
}


@pytest.mark.parametrize("fault", ESTIMATED)
def test_printed_options_make_a_log_that_is_used(fault, folder, capsys):
    path = folder / f"{fault}.npz"
    write_log(ESTIMATED[fault], path)
    status, said = looked_at(capsys, path, folder / "arm.xml")
    assert status == 2
    (advice,) = re.findall(r"(?:give|tau:) (--.+?)(?=,? or |;| \(|$)", said)[:1]
    options = shlex.split(advice)
    assert options
    assert looked_at(capsys, path, folder / "arm.xml", *options) == (0, "")
