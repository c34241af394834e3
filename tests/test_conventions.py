"""Options that say where a log means something else than its model: one line for what is wrong, by the command."""

import dataclasses

import numpy as np
import pytest
from test_against_model import ARMS, log_of

import jax_inertia as ji
from jax_inertia.cli import diagnose, diagnose_run
from jax_inertia.cli.main import main
from jax_inertia.logs.log_files import write_log
from jax_inertia.signals.corrections import with_model_gravity


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A small arm, and logs without gravity and of the motors' side."""
    out = tmp_path_factory.mktemp("small")
    (out / "arm.xml").write_text(ARMS["small"])
    log = log_of(ARMS["small"], noise=0.005)
    robot = ji.load_model(out / "arm.xml")
    gravity = with_model_gravity(dataclasses.replace(log, tau=0.0 * log.tau), robot).tau
    write_log(log, out / "sound.npz")
    write_log(dataclasses.replace(log, tau=log.tau - gravity), out / "weightless.npz")
    write_log(dataclasses.replace(log, tau=log.tau / 20), out / "motor.npz")
    return out


def inputs(folder, name: str, *options: str) -> diagnose_run.Inputs:
    """What `diagnose` reads, with its own options."""
    import argparse

    parser = argparse.ArgumentParser()
    diagnose.add_parser(parser.add_subparsers())
    log, model = str(folder / name), str(folder / "arm.xml")
    args = parser.parse_args(["diagnose", log, "--model", model, *options])
    return diagnose_run.read(args.model, args.log, args.test_log, args.exclude, args)


def test_what_is_offered_helps(folder):
    """The options that a refusal names are the way on."""
    sound = np.asarray(ji.read_log(folder / "sound.npz").tau)
    for name, word, *options in (
        ("weightless.npz", "--gravity-compensated", "--gravity-compensated"),
        ("motor.npz", "--tau-unit motor", "--tau-unit", "motor", "--gains", "20"),
    ):
        with pytest.raises(ji.LogError, match=word):
            inputs(folder, name)
        found = inputs(folder, name, *options)
        np.testing.assert_allclose(found.log.tau, sound, atol=1e-4 * np.abs(sound).max())


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--tau-unit", "A", "--gains", "1", "2"], "2"),
        (["--gains", "3"], "--tau-unit"),
        (["--tau-unit", "A", "--gravity-compensated"], "gains"),
    ],
)
def test_options_that_need_another_are_one_line(folder, capsys, tmp_path, options, word):
    command = ["diagnose", folder / "sound.npz", "--model", folder / "arm.xml", "--out", tmp_path]
    try:
        status = main([str(a) for a in [*command, *options]])
    except SystemExit as end:
        status = end.code
    out, err = capsys.readouterr()
    assert (status, out) == (2, "")
    (line,) = [x for x in err.splitlines() if "warning" not in x]
    assert word in line
    assert not list(tmp_path.iterdir())
