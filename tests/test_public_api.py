"""What `import jax_inertia as ji` gives: the names that people guess, and nothing that is not meant for them."""

import ast
import dataclasses
import inspect
import json
import pydoc
import re
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from diagnosis_made_up import diagnosis

import jax_inertia as ji
from jax_inertia.cli import estimate as command
from jax_inertia.diagnosis import entry
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.estimation import log_estimate
from jax_inertia.estimation.estimate_inputs import CHARTS, Settings
from jax_inertia.robots.pendulum import double_pendulum, swing

GUESSED = [
    "load_model",
    "read_log",
    "write_log",
    "estimate",
    "diagnose",
    "make_estimator",
    "Observation",
    "torque_regressor",
    "inverse_dynamics",
    "mass_matrix",
    "from_log_cholesky",
    "to_log_cholesky",
    "is_physical",
    "pseudo_inertia",
    "from_com",
    "centre_of_mass",
    "Robot",
    "Log",
    "LogError",
    "ModelError",
    "ModelWarning",
    "StateError",
    "Estimator",
    "Load",
    "Limits",
    "Stream",
    "save_state",
    "load_state",
    "suggest_motion",
    "observe",
    "to_report",
    "body_jacobian",
    "body_poses",
]
INIT = Path(ji.__file__)


@pytest.fixture(scope="module", autouse=True)
def quickly():
    """Compiling is what these spend their time on."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)


@pytest.fixture(scope="module")
def heard():
    """Stages of the estimate."""
    return []


@pytest.fixture(scope="module")
def found(quickly, heard):
    robot = ji.load_model(double_pendulum())
    return ji.estimate(robot, swing(load=0.5), ["lower"], progress=heard.append)


def test_stages_of_an_estimate_have_shares_that_rise(found, heard):
    shares = [stage.share for stage in heard]
    assert shares == sorted(shares)
    assert shares[-1] >= 0.8


@pytest.mark.parametrize("name", sorted({*GUESSED, *ji.__all__}))
def test_a_name_is_there_and_says_what_it_is(name):
    assert name in ji.__all__
    thing = getattr(ji, name)
    assert thing.__name__ == ji._PLACES[name][1]
    assert len(inspect.getdoc(thing) or "") > 20


def test_what_is_seen_is_what_is_imported_for_type_checkers():
    tree = ast.parse(INIT.read_text())
    [checked] = [n for n in tree.body if isinstance(n, ast.If)]
    seen = {
        alias.asname or alias.name: (node.module, alias.name)
        for node in checked.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == {n: (f"jax_inertia.{module}", own) for n, (module, own) in ji._PLACES.items()}
    assert sorted(seen) == ji.__all__ == dir(ji)


def test_help_shows_the_public_names_and_nothing_private():
    text = pydoc.render_doc(ji, renderer=pydoc.plaintext)
    functions = text.partition("\nFUNCTIONS\n")[2].partition("\nDATA\n")[0]
    shown = set(re.findall(r"^    (\w+)(?: = \w+)?\(", functions, re.MULTILINE))
    assert shown == {n for n in ji.__all__ if inspect.isfunction(getattr(ji, n))}
    assert not [name for name in shown if name.startswith("_")]


def test_a_name_that_is_not_there_is_one_line_with_the_nearest():
    with pytest.raises(AttributeError, match="no 'load_modle'; did you mean 'load_model'"):
        ji.load_modle  # noqa: B018
    assert not hasattr(ji, "_nothing")


def test_importing_the_package_imports_no_library():
    heavy = ("jax", "mujoco", "scipy", "matplotlib", "equinox")
    script = f"import sys, jax_inertia; print([m for m in {heavy} if m in sys.modules])"
    told = subprocess.run(
        [sys.executable, "-c", script], check=True, capture_output=True, text=True
    )
    assert told.stdout.strip() == "[]"


# --- estimate ----------------------------------------------------------------------------------------------------


def test_estimate_s_settings_are_the_command_s():
    """Names and defaults of the function, of its settings, and of the command's options are one list."""
    of_function = inspect.signature(ji.estimate).parameters
    fields = {f.name: f.default for f in dataclasses.fields(Settings)}
    assert {name: of_function[name].default for name in fields} == fields
    assert set(of_function) - set(fields) == {"robot", "log", "bodies", "calibrate", "progress"}
    parser = command.argparse.ArgumentParser()
    command.add_parser(parser.add_subparsers())
    asked = vars(parser.parse_args(["estimate", "log.npz", "--model", "m", "--bodies", "b"]))
    assert {name: asked[name] for name in fields} == fields
    assert tuple(CHARTS) == command.CHARTS


def test_an_estimate_prints_and_reports(found):
    assert abs(found.pi["lower"][0] - 1.5) < 0.05
    report = ji.to_report(found)
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    batch = report["bodies"]["lower"]["batch"]["mass_kg"]
    assert batch["ci95"][0] < 1.5 < batch["ci95"][1]
    assert report["settings"]["chart"] == "log-cholesky-uut"
    assert report["settings"]["prior_mass_kg"] == pytest.approx(0.1 * 3.0)
    first, body, *_ = repr(found).splitlines()
    assert first.startswith("LogEstimate(one body, 76 samples")
    assert f"batch fit {batch['value']:.3f} ± " in body
    assert "<td" in found._repr_html_()
    assert len(repr(found)) < 1000


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"bodies": ["hand"]}, "hand"),
        ({"bodies": []}, "name at least one"),
        ({"gains": [1.0, 2.0]}, "log: tau is in N m; gains is for currents"),
        ({"chart": "log_cholesky"}, "did you mean 'log-cholesky'"),
        ({"gate": 1.5}, "gate is 1.5; it must be a probability"),
        ({"iterations": 0}, "iterations is 0"),
        ({"prior_mass": -1.0}, "prior_mass is -1.0; it must be positive"),
        ({"trust": (0.1,)}, "trust is"),
        ({"bias_window": 60.0}, "bias_window 60 s covers the whole log"),
    ],
)
def test_estimate_refuses_in_one_line(given, message):
    arguments = {"bodies": ["lower"], **given}
    with pytest.raises(ValueError, match=message) as told:
        ji.estimate(ji.load_model(double_pendulum()), swing(load=0.5), **arguments)
    assert "\n" not in str(told.value)


def test_currents_need_gains_or_logs_without_load():
    robot, log = ji.load_model(double_pendulum()), swing(load=0.5)
    current = dataclasses.replace(log, tau=log.tau / 2.0, tau_unit="A", tau_unit_text="A")
    with pytest.raises(ValueError, match=r"log: tau is in 'A', not N m; give gains .*calibrate"):
        ji.estimate(robot, current, ["lower"])
    with pytest.raises(ValueError, match=r"calibrate\[0\]: tau is in 'N m', in log 'A'"):
        ji.estimate(robot, current, ["lower"], calibrate=[log])
    with_gains = ji.estimate(robot, current, ["lower"], gains=2.0)
    assert abs(with_gains.pi["lower"][0] - 1.5) < 0.05


def test_a_log_that_cannot_be_used_is_named():
    log = swing(load=0.5)
    other = dataclasses.replace(log, joint_names=("a", "b"))
    with pytest.raises(ji.LogError, match=r"^log: "):
        ji.estimate(ji.load_model(double_pendulum()), other, ["lower"])
    with pytest.raises(ji.LogError, match=r"^test_log: "):
        ji.diagnose(ji.load_model(double_pendulum()), log, test_log=other)


def test_whole_logs_are_computed_in_double_precision(found):
    """Whatever JAX is set to: in single precision the batch fit does not end."""
    with jax.enable_x64(False):
        robot = ji.load_model(double_pendulum())
        assert robot.pi.dtype == np.float32
        single = ji.estimate(robot, swing(load=0.5), ["lower"])
        report = ji.to_report(single)
    assert single.trace.estimate.pi.dtype == np.float64
    mass = [
        r["bodies"]["lower"]["batch"]["mass_kg"]["value"] for r in (report, ji.to_report(found))
    ]
    assert mass[0] == pytest.approx(mass[1], rel=1e-5)


# --- diagnose ----------------------------------------------------------------------------------------------------


@pytest.fixture
def asked(monkeypatch):
    """What the search is asked, without the minutes that it takes."""
    taken = []

    def search(robot, log, **options):
        taken.append((log, options))
        return diagnosis(Verdict.EXPLAINED)

    monkeypatch.setattr(entry.pipeline, "diagnose", search)
    return taken


def test_diagnose_passes_on_what_a_user_states(asked):
    robot, log = ji.load_model(double_pendulum()), swing(load=0.5)
    found = ji.diagnose(robot, log, test_log=log, exclude=["backlash"], max_effects=2)
    ((_, options),) = asked
    assert options["exclude"] == ["backlash"]
    assert options["settings"].most_effects == 2
    assert str(found.verdict) == "explained"
    assert ji.to_report(found)["notes"][-1] == "of its own"
    assert repr(found).splitlines()[:2] == [
        "explained (confidence 0.90)",
        "  The model lacks friction.",
    ]
    entry.diagnose(robot, log, nominal_uncertainty=(0.03, 0.002, 0.1))
    settings = asked[-1][1]["settings"]
    assert settings.most_effects is None
    assert (settings.mass_tolerance, settings.com_stated, settings.inertia_tolerance) == (
        0.03,
        0.002,
        0.1,
    )


def test_diagnose_reads_currents_by_gains_of_the_log(asked):
    log = swing(load=0.5)
    current = dataclasses.replace(log, tau=log.tau / 4.0, tau_unit="A", tau_unit_text="A")
    found = ji.diagnose(ji.load_model(double_pendulum()), current)
    assert any(
        note.startswith("log: tau is in 'A': drive gains were taken") for note in found.notes
    )
    read = np.array([found.drive_gains[name] for name in current.joint_names])
    np.testing.assert_allclose(asked[0][0].tau, current.tau * read)
    assert ji.to_report(found)["drive_gains"]["value"] == found.drive_gains
    assert np.std(asked[0][0].tau) > 2.0 * np.std(current.tau)


def test_diagnose_refuses_what_it_does_not_know():
    robot, log = ji.load_model(double_pendulum()), swing(load=0.5)
    with pytest.raises(ValueError, match=r"unknown families.*valid: .*backlash"):
        ji.diagnose(robot, log, exclude=["magic"])
    with pytest.raises(ValueError, match="max_effects is 0"):
        ji.diagnose(robot, log, max_effects=0)


def test_reports_of_an_estimate_have_one_maker(found):
    assert ji.to_report(found) == log_estimate.to_report(found)
