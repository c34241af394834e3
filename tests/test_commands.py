"""The commands `demo` and `estimate`: what they write, what they find, and what they say of bad input."""

import contextlib
import csv
import importlib
import io
import json
import pkgutil
import re
import shlex
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from unittest import mock

import jax.numpy as jnp
import numpy as np
import pytest
from excitation import compiled, loaded, motion_of, torques
from models import MODELS
from schemas import validated

import jax_inertia
import jax_inertia as ji
from jax_inertia.cli import main as command_line
from jax_inertia.cli.demo import command as demo_command
from jax_inertia.cli.main import main
from jax_inertia.estimation.inertial_filter import Estimator
from jax_inertia.logs.log import Log, TorqueKind
from jax_inertia.logs.log_files import read_log, write_log
from jax_inertia.maths.inertial_parameters import PI_NAMES, is_physical
from jax_inertia.model.load import body_pi

PNG = b"\x89PNG\r\n\x1a\n"


def png_size(path) -> tuple[int, int]:
    data = path.read_bytes()
    assert data[:8] == PNG
    return struct.unpack(">II", data[16:24])


# --- demo --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """(exit status, folder, what was printed, what it was printed from)."""
    out, text = tmp_path_factory.mktemp("demo") / "story", io.StringIO()
    with (
        contextlib.redirect_stdout(text),
        mock.patch.object(demo_command, "_numbers", wraps=demo_command._numbers) as seen,
    ):
        status = main(["demo", "--out", str(out), "--json"])
    return status, out, text.getvalue(), seen.call_args.args


@pytest.mark.slow
def test_demo_tells_its_story_in_files(demo):
    status, out, *_ = demo
    assert status == 0
    assert sorted(p.name for p in out.iterdir()) == [
        "corrected.xml",
        "demo.png",
        "hidden.npz",
        "hidden_test.npz",
        "log.npz",
        "model.xml",
        "report.html",
        "report.json",
    ]
    width, height = png_size(out / "demo.png")
    assert width > 800
    assert height > 800
    log = read_log(out / "log.npz")
    assert log.rate == pytest.approx(500.0)
    assert ji.load_model(out / "model.xml").joint_names == log.joint_names


def test_demo_tells_scripts_and_people_the_same(demo, capsys):
    _, out, printed, (compared, secret, diagnosis, report) = demo
    numbers = validated("demo", printed)
    assert numbers["load"] == {"mass_kg": 1.9, "picked_up_s": 4.0, "put_down_s": 10.0}
    assert [one["name"] for one in numbers["filters"]] == [one.name for one in compared.runs]
    assert [one["unphysical"] > 0 for one in numbers["filters"]] == [True, False, False]
    assert numbers["filters"][-1]["rms_kg"] < 0.1
    assert numbers["diagnosis"] == json.loads((out / "report.json").read_text())
    demo_command._print(compared, out)
    demo_command._print_diagnosis(secret, diagnosis, report, out)
    table = capsys.readouterr().out
    for one in numbers["filters"]:
        assert one["name"] in table
        assert f"{1e3 * one['rms_kg']:.0f} g" in table or "diverged" in table
    told = " ".join(table.split())
    assert " ".join(numbers["hidden"]["judged"].split()) in told
    # The verdict in words; a steel cube has a size, and is a payload for all that.
    assert " ".join(diagnosis.headline.split()) in told
    assert numbers["diagnosis"]["verdict"] == "explained"
    assert [effect["family"] for effect in numbers["diagnosis"]["effects"]] == ["payload"]
    assert all(f"note: {note}" in told for note in numbers["diagnosis"]["notes"])


@pytest.mark.slow
def test_the_demo_s_log_gives_its_load_to_the_main_command(demo, tmp_path, capsys, monkeypatch):
    """1.9 kg from 4 s to 10 s on a hand of 1.1 kg."""
    _, data, *_ = demo
    data = data.resolve()
    monkeypatch.chdir(tmp_path)
    out = Path("out/log/estimate")
    # Of a diagnosis of the same log, whose report has the same name.
    out.mkdir(parents=True)
    (out.parent / "report.json").write_text("{}")
    command = ["estimate", str(data / "log.npz"), "--model", str(data / "model.xml")]
    assert main([*command, "--bodies", "hand"]) == 0
    assert (out.parent / "report.json").read_text() == "{}"
    printed = capsys.readouterr().out
    assert "mass, filter [kg]" in printed
    assert "bodies changed" in printed
    told = " ".join(printed.split()).split("reopenings: hand ")[1].split("since")[0]
    spells = [float(x) for x in re.findall(r"([\d.]+) kg", told)]
    assert spells[0] == pytest.approx(1.1, abs=0.05)
    assert max(spells) == pytest.approx(3.0, abs=0.05)
    assert spells[-1] == pytest.approx(1.1, abs=0.05)
    names = ["estimate.png", "estimates.csv", "estimates.npz", "report.json"]
    assert sorted(p.name for p in out.iterdir()) == names

    arrays = np.load(out / "estimates.npz")
    time, mass, sigma = arrays["time"], arrays["pi"][:, 0, 0], arrays["sigma_pi"][:, 0, 0]
    held = (time > 5.5) & (time < 9.9)
    np.testing.assert_allclose(mass[held], 3.0, atol=0.1)
    np.testing.assert_allclose(mass[time > 11.5], 1.1, atol=0.1)
    assert np.sqrt(np.mean(((mass - 3.0) / sigma)[held] ** 2)) < 3
    assert arrays["is_physical"].all()
    assert np.all(is_physical(jnp.asarray(arrays["pi"])))
    assert arrays["reopened"].sum() in (2, 3)

    with open(out / "estimates.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(time)
    np.testing.assert_allclose([float(r["hand.mass"]) for r in rows], mass, rtol=1e-6)
    report = json.loads((out / "report.json").read_text())
    assert report["bodies_changed"]
    assert report["bodies"]["hand"]["online"]["mass_kg"]["value"] == pytest.approx(mass[-1])
    assert len(report["filter"]["reopened_at_s"]) == arrays["reopened"].sum()
    assert png_size(out / "estimate.png")[0] > 800


# --- estimate ----------------------------------------------------------------------------------------------------

SAMPLES, RATE, GAIN = 1500, 250.0, 8.0


def log_of(model, seed: int, **changes) -> Log:
    """Six seconds of a three-joint robot, noisy."""
    time, q, v, a = motion_of(model, SAMPLES, seed, RATE)
    tau = torques(model, q, v, a) + 0.1 * np.random.default_rng(seed).normal(size=v.shape)
    names = ("first", "second", "third")
    fields = {"time": time, "joint_names": names, "qpos": q, "qvel": v, "tau": tau}
    return Log(**{**fields, "tau_kind": TorqueKind.SENSOR, **changes})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A model, its log with and without a load of 2.4 kg, and the loaded log as currents."""
    out = tmp_path_factory.mktemp("logs")
    (out / "model.xml").write_text(MODELS["universal"])
    bare = compiled("universal")
    write_log(log_of(bare, 1), out / "free.npz")
    full = log_of(loaded(bare, "tip"), 0)
    write_log(full, out / "loaded.npz")
    amperes = log_of(
        loaded(bare, "tip"), 0, tau=full.tau / GAIN, tau_unit="A", tau_kind=TorqueKind.CURRENT
    )
    write_log(amperes, out / "amperes.npz")
    return out


def estimate(folder, log="loaded.npz", *options) -> int:
    arguments = [str(folder / log), "--model", str(folder / "model.xml"), "--bodies", "tip"]
    return main(["estimate", *arguments, *options])


@pytest.mark.parametrize("log", ["loaded.npz", "amperes.npz"])
def test_a_constant_load_by_filter_and_batch_fit(folder, tmp_path, log, capsys):
    """In newton metres, and as currents with their gains; the report on stdout is the one in the file."""
    gains = ["--gains", *[str(GAIN)] * 3] if log == "amperes.npz" else []
    options = ["--out", str(tmp_path), "--json", "--write-model", "--driver", "ur", *gains]
    assert estimate(folder, log, *options) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    assert validated("estimate", capsys.readouterr().out) == report
    model = loaded(compiled("universal"), "tip")
    truth = body_pi(model, model.body("tip").id)
    body = report["bodies"]["tip"]
    assert body["model"]["mass_kg"] == pytest.approx(0.8)
    assert body["online"]["mass_kg"]["value"] == pytest.approx(truth[0], abs=0.2)
    low, high = body["batch"]["mass_kg"]["ci95"]
    assert low < truth[0] < high
    assert high - low < 0.4
    np.testing.assert_allclose(body["batch"]["com_m"], truth[1:4] / truth[0], atol=0.02)
    assert body["batch"]["is_physical"]
    assert list(body["batch"]["pi"]) == list(PI_NAMES)
    assert not report["bodies_changed"]
    # What the tip has beyond the model, and no more of its own 0.8 kg.
    assert report["payload"]["mass_kg"] == pytest.approx(body["batch"]["load_kg"]["value"])
    assert report["payload"]["line"].startswith(f"set_target_payload({truth[0] - 0.8:.1f}")
    seen = report["identifiability"]
    assert seen["rank"] == len(seen["combinations"]) <= seen["parameters"] == 10
    for row in report["residual_rms"].values():
        assert row["batch"] < 0.2 < row["model"]


# --- help, and completion ----------------------------------------------------------------------------------------


COMMANDS = (
    "convert",
    "diagnose",
    "estimate",
    "suggest-motion",
    "compare",
    "fleet",
    "watch",
    "replay",
    "demo",
)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_teaches_with_examples_that_parse(command, capsys, monkeypatch):
    """Each line of the examples goes through the parser, and every command has --json."""
    with pytest.raises(SystemExit) as end:
        main([command, "--help"])
    assert end.value.code == 0
    said = capsys.readouterr().out
    assert "--json" in said
    examples = said.partition("examples:")[2].replace("\\\n", " ")
    lines = re.findall(r"^ +(?:.* && )?jax-inertia (.*)$", examples, re.MULTILINE)
    lines = [line.partition(" && ")[0] for line in lines]
    assert any(line.startswith(command) for line in lines)
    for module in command_line._COMMANDS:
        monkeypatch.setattr(module, "run", lambda *given: 0)
    assert [main(shlex.split(line)) for line in lines] == [0] * len(lines)


def test_help_says_what_the_exit_statuses_mean(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    said = capsys.readouterr().out
    assert "exit status: 0" in said
    assert all(word in said for word in (*COMMANDS, "130", "--json"))


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_completion_knows_commands_options_and_files(tmp_path, capsys):
    pytest.importorskip("shtab")
    with pytest.raises(SystemExit) as end:
        main(["--print-completion", "bash"])
    assert end.value.code == 0
    (tmp_path / "script").write_text(capsys.readouterr().out)
    (tmp_path / "arm.urdf").write_text("")
    for typed, wanted in (
        ("jax-inertia su", "suggest-motion"),
        ("jax-inertia estimate --write", "--write-model"),
        ("jax-inertia estimate --model ar", "arm.urdf"),
    ):
        lines = (
            "source ./script",
            f"COMP_WORDS=({typed}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1))",
            '_shtab_jax_inertia; echo "${COMPREPLY[@]}"',
        )
        done = subprocess.run(
            ["bash", "-c", "\n".join(lines)],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout.split() == [wanted]


def test_completion_without_its_library_is_one_line(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "shtab", None)
    refused(capsys, ["--print-completion", "zsh"], "pip install shtab")


# --- bad input ---------------------------------------------------------------------------------------------------


def refused(capsys, arguments, *words) -> str:
    """The one line on stderr of a command that ends with status 2."""
    try:
        status = main([str(a) for a in arguments])
    except SystemExit as end:
        status = end.code
    out, err = capsys.readouterr()
    assert status == 2, err
    assert out == ""
    warned = "jax-inertia: warning:"
    lines = [x for x in err.splitlines() if x.strip() and not x.startswith(warned)]
    assert len(lines) == 1, err
    assert lines[0].startswith("jax-inertia: error: ")
    for word in words:
        assert word in lines[0]
    return lines[0]


def raw_log(folder, target, **changes):
    """loaded.npz with arrays replaced, past all checks of `write_log`."""
    with np.load(folder / "loaded.npz") as file:
        arrays = {name: file[name] for name in file.files}
    np.savez(target, **{**arrays, **changes})
    return target


def test_bad_logs_get_one_line_and_status_2(folder, tmp_path, capsys):
    out = tmp_path / "out"
    rest = ["--model", folder / "model.xml", "--bodies", "tip", "--out", out]
    with np.load(folder / "loaded.npz") as file:
        tau, time = file["tau"], file["time"]
    missing = tmp_path / "no.npz"
    refused(capsys, ["estimate", missing, *rest], "no.npz", "no such file")
    nan = raw_log(folder, tmp_path / "nan.npz", tau=np.full_like(tau, np.nan))
    refused(capsys, ["estimate", nan, *rest], "nan.npz", "tau")
    time[700] = np.nan
    stamps = raw_log(folder, tmp_path / "stamps.npz", time=time)
    refused(capsys, ["estimate", stamps, *rest], "stamps.npz", "time")
    wrong = raw_log(folder, tmp_path / "names.npz", joint_names=np.array(["first", "2nd", "third"]))
    refused(capsys, ["estimate", wrong, *rest], "2nd", "second")
    shape = raw_log(folder, tmp_path / "shape.npz", tau=tau[:, :2])
    refused(capsys, ["estimate", shape, *rest], "shape.npz", "tau")
    whole = (folder / "loaded.npz").read_bytes()
    cut = tmp_path / "cut.npz"
    cut.write_bytes(whole[: len(whole) // 2])
    refused(capsys, ["estimate", cut, *rest], "cut.npz")
    spoilt = tmp_path / "spoilt.npz"
    spoilt.write_bytes(whole[:2000] + bytes(200) + whole[2200:])
    refused(capsys, ["estimate", spoilt, *rest], "spoilt.npz")
    pickled = raw_log(folder, tmp_path / "pickled.npz", tau=np.array([{}], dtype=object))
    refused(capsys, ["estimate", pickled, *rest], "pickle")
    assert not out.exists()


def test_bad_models_bodies_and_settings_get_one_line_and_status_2(folder, tmp_path, capsys):
    out = ["--out", tmp_path / "out"]
    log, model = folder / "loaded.npz", ["--model", folder / "model.xml"]
    one = ["estimate", log, *model, *out, "--bodies"]
    refused(capsys, [*one, "tipp"], "tipp", "tip")
    refused(capsys, [*one, "tip", "tip"], "tip")
    weightless = tmp_path / "weightless.xml"
    weightless.write_text(MODELS["universal"].replace('mass="0.8"', 'mass="0"'))
    refused(capsys, ["estimate", log, "--model", weightless, *out, "--bodies", "tip"], "tip")
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody></mujoco>")
    refused(capsys, ["estimate", log, "--model", broken, *out, "--bodies", "tip"], "broken.xml")
    refused(
        capsys, ["estimate", log, "--model", tmp_path / "no.xml", *out, "--bodies", "tip"], "no.xml"
    )
    refused(capsys, [*one, "tip", "--gains", "3"], "N m")
    amperes = ["estimate", folder / "amperes.npz", *model, *out, "--bodies", "tip"]
    refused(capsys, amperes, "--gains", "--calibrate")
    refused(capsys, [*amperes, "--gains", "1", "2"], "2 gains for 3 joints")
    refused(capsys, [*one, "tip", "--calibrate", folder / "amperes.npz"], "amperes.npz")
    refused(capsys, [*one, "tip", "--gate", "1.5"], "--gate", "1.5")
    refused(capsys, [*one, "tip", "--chart", "polar"], "--chart", "polar")
    refused(capsys, [*one, "tip", "--cutoff", "-3"], "--cutoff")
    file = tmp_path / "file"
    file.write_text("")
    refused(capsys, ["estimate", log, *model, "--bodies", "tip", "--out", file], "--out")
    refused(capsys, ["demo", "--out", file], "--out")
    refused(capsys, ["demo", "--seed", "x"], "--seed")
    refused(capsys, ["guess"], "guess", "--help")
    assert not (tmp_path / "out").exists()


def test_a_few_missing_samples_are_masked_with_a_warning(folder, tmp_path, capsys):
    with np.load(folder / "loaded.npz") as file:
        tau = file["tau"]
    tau[100:140, 1] = np.nan
    holes = raw_log(folder, tmp_path / "holes.npz", tau=tau)
    arguments = ["estimate", holes, "--model", folder / "model.xml", "--bodies", "tip"]
    assert main([str(a) for a in [*arguments, "--out", tmp_path / "out"]]) == 0
    assert "warning" in capsys.readouterr().err
    mass = json.loads((tmp_path / "out" / "report.json").read_text())["bodies"]["tip"]["batch"][
        "mass_kg"
    ]
    assert mass["value"] == pytest.approx(3.2, abs=0.2)


# --- README ------------------------------------------------------------------------------------------------------

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_the_readme_s_example_runs_as_it_stands(capsys):
    example = README.split("```python\n")[1].split("```")[0]
    names = {}
    exec(compile(example, "README.md", "exec"), names)
    low, high = 2.9, 3.1
    said = re.findall(r"hand: .* filter (\S+) .* batch fit (\S+)", capsys.readouterr().out)
    assert [low < float(mass) < high for mass in said[0]] == [True, True]
    mass = np.asarray(names["found"].trace.estimate.pi[:, 0, 0])
    assert np.all((low < mass[10:]) & (mass[10:] < high))


def test_functions_of_the_paper_s_table_are_there():
    # Functions of the table, by their names in the package.
    page = (ROOT / "docs" / "paper.md").read_text()
    table = page.split("## Paper to code")[1].split("## ")[0]
    modules = [m.name for m in pkgutil.walk_packages(jax_inertia.__path__, "jax_inertia.")]
    for module, name in re.findall(r"`(\w+)\.(\w+)", table):
        if module != "Estimator":
            full = [importlib.import_module(m) for m in modules if m.endswith(f".{module}")]
            assert any(hasattr(one, name) for one in full), (module, name)
    assert hasattr(Estimator, "calibrate_bias")
