"""The sealed check: no trace of the truth in a log, tampering caught, the diagnoser alone with its log."""

import json
import os
import signal
import sys
import threading
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind import score, seal, solve, vault
from benchmarks.worlds import strata

BLIND = Path(__file__).parents[1] / "benchmarks" / "blind"

SEED = b"a seed for a test"
KINDS = (("bare", "", False), ("bare_odd", "cogging", True), ("outside", "clock_skew", False))


def three(words: int, count: int) -> list[strata.Task]:
    """Ordinary physics, one effect with a validation run, and what no library has."""
    return [
        strata.Task(stratum, kind, words, 3 * k, validation=more)
        for k, (stratum, kind, more) in enumerate(KINDS[:count])
    ]


@pytest.fixture(scope="module")
def sealed(tmp_path_factory):
    """Three tiny logs, their vault and the commitment."""
    home = tmp_path_factory.mktemp("blind")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(strata, "plan", three)
        patch.setattr(strata, "SECONDS", 2.0)
        patch.setattr(strata, "OTHER", 2.0)
        patch.setattr(strata, "WINDOW", (0.0, np.inf))
        promise = seal.make(home / "logs", home / "vault", SEED, 3)
    return home / "logs", home / "vault", promise


def test_a_log_holds_the_contract_and_nothing_else(sealed):
    logs, hidden, _ = sealed
    allowed = {
        *("time", "joint_names", "qpos", "qvel", "tau", "tau_kind", "sigma_qpos", "sigma_tau")
    }
    files = sorted(sorted(p.name for p in folder.iterdir()) for folder in logs.iterdir())
    assert files == [["log.npz", "nominal.xml"]] * 2 + [
        ["log.npz", "nominal.xml", "validation.npz"]
    ]
    for file in logs.rglob("*.npz"):
        with zipfile.ZipFile(file) as archive:
            assert {i.date_time for i in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        with np.load(file, allow_pickle=False) as arrays:
            assert set(arrays.files) <= allowed
            assert arrays["qpos"].dtype == np.float32
            np.testing.assert_array_equal(arrays["qpos"] * 2.0**21 % 1.0, 0.0)
    assert {p.name for p in hidden.iterdir()} == {p.name for p in logs.iterdir()} | {
        "manifest.json"
    }


def test_names_and_times_tell_nothing(sealed):
    logs, _, _ = sealed
    words = {*strata.ONE, *strata.OUTSIDE, *strata.SHARES, "pinocchio", "truth"}
    for path in logs.rglob("*"):
        assert path.stat().st_mtime == seal.MOMENT
        assert not any(word in path.name for word in words)
        if path.suffix == ".xml":
            assert not any(word in path.read_text() for word in words)
    assert all(len(p.name) == 12 and int(p.name, 16) >= 0 for p in logs.iterdir())
    names = [name for _, name in seal.plan(b"seed", 50)]
    assert len(set(names)) == 50
    assert set(names).isdisjoint(name for _, name in seal.plan(b"other", 50))


def test_rounding_is_below_what_sensors_add():
    rng = np.random.default_rng(0)
    log = {"qpos": rng.normal(size=(50, 2)), "tau": rng.normal(size=(50, 2)) * [1e-3, 80.0]}
    out = seal.rounded(log | {"time": np.arange(50) / 250})
    assert np.abs(out["qpos"] - log["qpos"]).max() < 5e-7
    assert np.all(np.abs(out["tau"] - log["tau"]).max(0) < 2e-4 * np.abs(log["tau"]).max(0))
    assert out["time"].dtype == float


def test_the_commitment_holds_end_to_end(sealed, tmp_path, monkeypatch):
    """The seed makes the same files again; hand-made answers to them are scored; whatever is changed is caught."""
    logs, hidden, promise = sealed
    manifest = vault.check(logs, hidden, promise, SEED)
    assert len(manifest["logs"]) == 3
    monkeypatch.setattr(strata, "plan", three)
    monkeypatch.setattr(strata, "SECONDS", 2.0)
    monkeypatch.setattr(strata, "OTHER", 2.0)
    monkeypatch.setattr(strata, "WINDOW", (0.0, np.inf))
    (task, name) = seal.plan(SEED, 3)[1]
    again = tmp_path / "again"
    seal.write_log(task, name, again / "logs", again / "vault")
    assert (
        vault.fingerprint(again / "logs" / name, again / "vault" / name) == manifest["logs"][name]
    )
    truth = json.loads((hidden / name / "truth.json").read_text())
    place = tmp_path / "mine" / "results" / name
    place.mkdir(parents=True)
    said = {"verdict": "explained", "confidence": 0.9, "effects": [truth["odd"]]}
    (place / "report.json").write_text(json.dumps(said))
    tools = {"mine": tmp_path / "mine"}
    rows = {r["log"]: r for r in score.score(logs, hidden, promise, tools, tmp_path / "s")["mine"]}
    assert rows[name]["found"]
    assert rows[name]["errors"]["tool"] > 0
    assert {r["verdict"] for k, r in rows.items() if k != name} == {"refused"}
    with pytest.raises(vault.SealBroken, match="commitment"):
        vault.check(logs, hidden, "0" * 64)
    with pytest.raises(vault.SealBroken, match="seed"):
        vault.check(logs, hidden, promise, b"another")
    model = logs / name / "nominal.xml"
    text = model.read_text()
    model.write_text(text + " ")
    with pytest.raises(vault.SealBroken, match="changed"):
        vault.check(logs, hidden, promise)
    model.write_text(text)
    os.utime(model, (seal.MOMENT, seal.MOMENT))
    (logs / "foreign").mkdir()
    with pytest.raises(vault.SealBroken, match="foreign"):
        vault.check(logs, hidden, promise)
    (logs / "foreign").rmdir()


def test_a_seed_is_drawn_once(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["seal.py", "draw", str(tmp_path / "seed")])
    seal.main()
    told = capsys.readouterr().out.strip()
    assert told == seal.hashlib.sha256((tmp_path / "seed").read_bytes()).hexdigest()
    with pytest.raises(SystemExit):
        seal.main()


PROBE = """
import importlib, json, os, sys
from pathlib import Path

def main(arguments):
    found = {"arguments": arguments, "imported": [], "opened": [], "listed": os.listdir("."), "env": sorted(os.environ)}
    for name in ("benchmarks.blind.seal", "seal", "vault", "mixed", "exam.marks"):
        try:
            importlib.import_module(name)
            found["imported"].append(name)
        except ImportError:
            pass
    for path in %r:
        try:
            open(path, "rb").close()
            found["opened"].append(path)
        except OSError:
            pass
    Path("found").mkdir(exist_ok=True)
    Path("found/report.json").write_text(json.dumps(found))
    return 0
"""


def stand_in(main: str):
    """Puts a package into an empty folder whose command is `main`, a module's text, for `Diagnoser`."""

    def put(folder: Path) -> None:
        (folder / "jax_inertia" / "cli").mkdir(parents=True)
        (folder / "jax_inertia" / "__init__.py").touch()
        (folder / "jax_inertia" / "cli" / "__init__.py").touch()
        (folder / "jax_inertia" / "cli" / "main.py").write_text(main)

    return put


def probe_package(hidden: list[str]):
    """A stand-in for the package that tries to cheat."""
    return stand_in(PROBE % hidden)


def test_the_diagnoser_sees_its_log_and_nothing_of_the_examination(sealed, tmp_path):
    logs, hidden, _ = sealed
    names = sorted((p.name for p in logs.iterdir()), key=lambda n: len(list((logs / n).iterdir())))
    forbidden = [str(BLIND / "seal.py"), *(str(p) for p in hidden.rglob("*.*"))]
    forbidden += [str(logs / names[1] / "log.npz"), str(tmp_path / "out" / "note")]
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "note").write_text("a report of another log")
    diagnoser = solve.Diagnoser(tmp_path / "d", None, 5, 60.0, probe_package(forbidden))
    os.environ["BLIND_SECRET"] = "x"
    try:
        diagnoser.diagnose(logs / names[0], tmp_path / "out", ["payload"])
    finally:
        del os.environ["BLIND_SECRET"]
        diagnoser.close()
    told = json.loads((tmp_path / "out" / "results" / names[0] / "report.json").read_text())
    assert told["imported"] == []
    assert told["opened"] == []
    assert sorted(told["listed"]) == ["log.npz", "nominal.xml"]
    assert "BLIND_SECRET" not in told["env"]
    assert told["arguments"][-4:] == ["--exclude", "payload", "--out", "found"]
    assert not any(name in json.dumps(told) for name in names)


def test_a_stopped_run_goes_on_where_it_was(sealed, tmp_path, monkeypatch):
    logs, _, _ = sealed
    monkeypatch.setattr(solve, "copy_package", probe_package([]))
    every = sorted(logs.iterdir())
    tasks = [solve.Task(log, tmp_path) for log in every]
    solve.solve(tasks[:1], tmp_path / "work")
    stamp = (tmp_path / "results" / every[0].name / "report.json").stat().st_mtime_ns
    solve.solve(tasks, tmp_path / "work", jobs=2)
    assert sorted(p.name for p in (tmp_path / "results").iterdir()) == [p.name for p in every]
    assert (tmp_path / "results" / every[0].name / "report.json").stat().st_mtime_ns == stamp
    assert len(json.loads((tmp_path / "runs.json").read_text())) == 2


def test_an_interrupted_log_has_no_result(sealed, tmp_path, monkeypatch):
    logs, _, _ = sealed
    slow = "import pathlib, time\ndef main(a):\n    pathlib.Path('begun').touch()\n    time.sleep(60)\n"

    def interrupt():
        while not all((tmp_path / "work" / k / "job" / "begun").exists() for k in ("00", "01")):
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(solve, "copy_package", stand_in(slow))
    began = time.monotonic()
    # Workers of pytest-xdist ignore it otherwise.
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Thread(target=interrupt, daemon=True).start()
    try:
        with pytest.raises(KeyboardInterrupt):
            solve.solve([solve.Task(log, tmp_path) for log in logs.iterdir()], tmp_path / "work", 2)
    finally:
        signal.signal(signal.SIGINT, usual)
    assert time.monotonic() - began < 30.0
    assert not list((tmp_path / "results").iterdir())


def test_a_command_that_hangs_or_dies_is_an_answer_of_its_own(sealed, tmp_path):
    logs, _, _ = sealed
    bad = "import os, time\ndef main(a):\n    os._exit(3) if len(a) < 9 else time.sleep(60)\n"
    diagnoser = solve.Diagnoser(tmp_path / "d", None, 5, 3.0, stand_in(bad))
    one, two, _ = sorted(logs.iterdir())
    diagnoser.diagnose(one, tmp_path, [])
    diagnoser.diagnose(two, tmp_path, ["payload"])
    for name in (one.name, two.name):
        run = json.loads((tmp_path / "results" / name / "run.json").read_text())
        assert run["exit"] != 0
        assert "ended" in run["error"]
        assert not (tmp_path / "results" / name / "report.json").exists()
