"""Every option of every command, with values that it cannot have: one line on stderr, status 2, nothing written."""

import argparse
import dataclasses
import os

import mujoco
import numpy as np
import pytest
from log_files import columns, write_csv, write_dataset

from jax_inertia.cli import main as command_line
from jax_inertia.logs.log_files import write_log
from jax_inertia.robots.pendulum import double_pendulum, swing

# Option: the values it is given, each refused. What takes any text is given it where nothing has such a name.
BAD = {
    "convert": {
        "--model": ["no.xml", "log.npz", "."],
        "--tau-unit": ["", " "],
        "--tau-kind": ["strong", ""],
        "--time-unit": ["fortnights", ""],
        "--rename": ["elbow", "=", "nobody=elbow"],
        "--column": ["qpos.a", "=x", "time=x"],
        "--joints": ["a", ""],
        "--rate": ["x", "0", "100"],
        "--episode": ["-1", "x", "1.5", "7"],
        "--calibration": ["no.json", "log.npz"],
        "--topic-joints": ["/x", ""],
        "--topic-base": ["/x", ""],
        "--topic-imu": ["/x", ""],
        "--topic-wrench": ["lower", "lower=", "lower=/x"],
        "--wrench-axes": ["sideways", "body"],
        "--topic-targets": ["/x", ""],
        "--position-scale": ["x", "nan", "0"],
        "--position-zero": ["x", "nan"],
        "--target-scale": ["x", "nan", "0", "1"],
        "--target-offset": ["x", "nan", "1"],
        "--include-root": [],
    },
    "estimate": {
        "--ignore": ["tau", ""],
        "--tolerance": ["x 1 1", "-1 0 0", "nan 1 1"],
        "--include-root": [],
        "--model": ["no.xml", "log.npz"],
        "--bodies": ["nobody", "", "world"],
        "--wrench": ["", "=x", "lower=", "nobody", "lower", "lower=/x"],
        "--wrench-axes": ["sideways", "body"],
        "--out": ["log.npz"],
        "--gains": ["x", "nan", "0", "1"],
        "--calibrate": ["no.npz", "model.xml"],
        "--gain-sigma": ["0", "-1", "nan", "x"],
        "--trust": ["0.1", "0.1 -1", "nan 1", "x y"],
        "--chart": ["round", ""],
        "--gate": ["0", "2", "nan", "x"],
        "--reopen-after": ["0", "-1", "inf"],
        "--iterations": ["0", "101", "1.5", "x"],
        "--sigma-tau": ["0", "nan", "x", "1 2 3"],
        "--prior-mass": ["0", "-1", "nan"],
        "--prior-reach": ["0", "inf"],
        "--drift-time": ["0", "nan"],
        "--driver": ["abb", ""],
        "--flange": ["upper", ""],
        "--cutoff": ["0", "x", "1e9", "1e-9"],
        "--rate": ["0", "nan", "1e12", "1e-9"],
        "--bias-window": ["0", "-1"],
        "--time-unit": ["fortnights", "", "ms"],
        "--tau-unit": ["", "A"],
        "--mount": ["1", "1,x", "nan,0", "1,1,1,1"],
        "--shift-torque": ["4", "nan", "x"],
        "--fix": ["shoulder", "shoulder=inf", "nobody=0", "shoulder=0"],
        "--joints": ["nobody", ""],
    },
    "diagnose": {
        "--validation-log": ["no.npz", "model.xml"],
        "--include-root": [],
        "--model": ["no.xml", "log.npz"],
        "--test-log": ["no.npz", "model.xml"],
        "--exclude": ["elves", ""],
        "--export": ["unity", ""],
        "--max-effects": ["0", "21", "x", "1.5"],
        "--more-logs": ["no.npz", "model.xml", "log.npz"],
        "--nominal-uncertainty": ["0 1 1", "0.1 x 0.1", "nan 1 1", "0.1", "-1 1 1"],
        "--gains": ["x", "3"],
        "--time-unit": ["fortnights", "", "ns"],
        "--tau-unit": [""],
        "--mount": ["1", "1,x", "nan,0", "1,1,1,1"],
        "--shift-torque": ["4", "nan", "x"],
        "--fix": ["shoulder", "shoulder=inf", "nobody=0", "shoulder=0"],
        "--joints": ["nobody", ""],
        "--kp": ["x", "1 2 3"],
        "--kd": ["x", "1 2 3"],
        "--out": ["log.npz"],
    },
    "replay": {
        "--include-root": [],
        "--model": ["no.xml", "log.npz"],
        "--time-unit": ["fortnights", ""],
        "--kp": ["x", "1 2 3", "-1"],
        "--kd": ["x", "1 2 3", "-1"],
        "--out": ["log.npz"],
    },
    "suggest-motion": {
        "--include-root": [],
        "--bodies": ["nobody", ""],
        "--out": ["log.npz/motion.csv", "motion.txt", "."],
        "--velocity": ["0", "-1", "nan", "x", "1 2 3"],
        "--range": ["shoulder 0", "shoulder 1 0", "nobody 0 1", "shoulder x 1", "shoulder nan 1"],
        "--share": ["0", "2", "nan", "x"],
        "--period": ["0", "-1", "nan", "x", "1e12"],
        "--rate": ["0", "nan", "x", "1e12"],
        "--prior-mass": ["0", "-1", "nan", "x"],
        "--seed": ["-1", "x", "1.5"],
    },
    "compare": {"--names": ["one", "a b c"], "--out": ["log.npz"]},
    "fleet": {
        "--include-root": [],
        "--model": ["no.xml"],
        "--test-logs": ["no.npz", "model.xml"],
        "--jobs": ["0", "257", "x", "1.5"],
        "--dask": ["nowhere"],
        "--pattern": ["(", "robot"],
        "--options": ["'"],
        "--out": ["log.npz"],
    },
    "watch": {
        "--include-root": [],
        "--model": ["no.xml", "log.npz"],
        "--bodies": ["nobody", ""],
        "--learn": ["0", "-1", "nan", "x"],
        "--prior-mass": ["0", "-1", "nan", "x"],
        "--every": ["0", "nan", "x"],
        "--idle": ["0", "nan", "x"],
    },
    "demo": {"--seed": ["-1", "x", "1.5"], "--out": ["log.npz"]},
}
# What a reader is told is of use for some kinds of files only.
READS = {
    "--column": ["table.csv"],
    "--joints": ["dataset"],
    "--rate": ["table.csv"],
    "--episode": ["dataset"],
    "--calibration": ["dataset"],
}
GIVEN = {
    "replay": ["told.npz", "--model", "model.xml", "--kp", "10", "--kd", "1"],
    "convert": ["log.npz", "made.npz"],
    "estimate": ["log.npz", "--model", "model.xml", "--bodies", "lower", "--out", "made"],
    "diagnose": ["log.npz", "--model", "model.xml", "--out", "made"],
    "suggest-motion": ["model.xml", "--bodies", "lower", "--out", "made.csv"],
    "compare": ["report", "report", "--out", "made"],
    "fleet": ["log.npz", "--model", "model.xml", "--out", "made"],
    "watch": ["log.csv", "--model", "model.xml", "--bodies", "lower", "--idle", "0.01"],
    "demo": [],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("options")
    spec = double_pendulum()
    text = spec if isinstance(spec, str) else None
    if text is None:
        model = spec.compile() if isinstance(spec, mujoco.MjSpec) else spec
        mujoco.mj_saveLastXML(str(made / "model.xml"), model)
    else:
        (made / "model.xml").write_text(text)
    log = swing(seconds=2.0)
    write_log(log, made / "log.npz")
    told = dataclasses.replace(log, tau=None, qpos_target=np.asarray(log.qpos))
    write_log(told, made / "told.npz")
    write_csv(made / "table.csv", columns())
    write_log(log, made / "log.csv")
    (made / "report").mkdir()
    (made / "report" / "report.json").write_text('{"verdict": "no_gap"}')
    pytest.importorskip("pyarrow")
    write_dataset(made / "dataset")
    return made


def parsers() -> dict[str, argparse.ArgumentParser]:
    """The parser of each command."""
    subparsers = argparse.ArgumentParser().add_subparsers()
    for command in command_line._COMMANDS:
        command.add_parser(subparsers)
    return dict(subparsers.choices)


def test_the_table_holds_every_option():
    for command, parser in parsers().items():
        flags = (
            argparse._StoreTrueAction,
            argparse._HelpAction,
            argparse.BooleanOptionalAction,
        )
        options = {
            action.option_strings[-1]
            for action in parser._actions
            if action.option_strings and not isinstance(action, flags)
        }
        assert options == set(BAD[command]), command


CASES = [
    (command, option, value)
    for command, options in BAD.items()
    for option, values in options.items()
    for value in values
]


@pytest.mark.parametrize(("command", "option", "value"), CASES)
def test_bad_values_are_one_line(folder, monkeypatch, capfd, command, option, value):
    monkeypatch.chdir(folder)
    before = sorted(os.listdir())
    arguments = list(GIVEN[command])
    arguments[:1] = READS.get(option, arguments[:1])
    words = value.split() if " " in value.strip() else [value]
    if option in arguments:
        at = arguments.index(option)
        arguments[at + 1 : at + 2] = words
    else:
        arguments += [option, *words]
    try:
        status = command_line.main([command, *arguments])
    except SystemExit as end:
        status = end.code
    out, err = capfd.readouterr()
    lines = [x for x in err.splitlines() if not x.startswith("jax-inertia: warning:")]
    assert (status, len(lines), out) == (2, 1, ""), (status, err, out)
    assert lines[0].startswith("jax-inertia: error: ")
    assert sorted(os.listdir()) == before


def test_what_is_refused_here_is_taken_with_a_good_value(folder, monkeypatch, capfd):
    monkeypatch.chdir(folder)
    good = ["convert", "table.csv", "good.npz", "--time-unit", "s", "--tau-unit", "N m"]
    assert command_line.main(good) == 0
    with np.load("good.npz") as file:
        assert len(file["time"]) == 60
    os.unlink("good.npz")
    capfd.readouterr()
