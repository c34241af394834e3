"""The sealed check: no trace of the truth in a log, tampering caught, the diagnoser alone with its log."""

import dataclasses
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

pytest.importorskip("pinocchio_oracle")
pytest.importorskip("cryptography", reason="the seal")
BLIND = Path(__file__).parents[1] / "benchmarks" / "blind"
sys.path.insert(0, str(BLIND))

import seal  # noqa: E402
import solve  # noqa: E402
import vault  # noqa: E402
from world.draw import ARM, FLOATING  # noqa: E402
from world.plan import STRATA, Setting, plan  # noqa: E402
from world.unknowns import UNKNOWN  # noqa: E402

SHORT = Setting(
    key=(0,),
    stratum="none",
    families=(),
    robot="two",
    engine="pinocchio",
    motions=("exciting", "ordinary"),
    rate=250,
    wrong=False,
    loud=1.0,
    duration=2.0,
    test_duration=1.5,
)


def three(words, count, robots):
    """One log without a gap, one with payload, one with what no library has; in this order."""
    kinds = [("none", ()), ("single", ("payload",)), ("unknown", ("quadratic_friction",))]
    return [
        dataclasses.replace(SHORT, key=(*words, k), stratum=s, families=f)
        for k, (s, f) in enumerate(kinds[:count])
    ]


@pytest.fixture(scope="module")
def sealed(tmp_path_factory):
    """Logs and answers of three short logs, and the commitment."""
    home = tmp_path_factory.mktemp("blind")
    seed = home / "seed"
    seed.write_bytes(b"a seed for a test")
    promise = seal.seal_set(home / "logs", home / "sealed", 3, seed, settings=three)
    return home / "logs", home / "sealed", promise


def test_a_log_holds_the_contract_and_nothing_else(sealed):
    logs, _, _ = sealed
    allowed = {
        *("time", "joint_names", "qpos", "qvel", "tau", "tau_kind", "qpos_target"),
        *("sigma_qpos", "sigma_tau", "base_pos", "base_quat", "base_linvel", "base_angvel"),
        *("contact_wrench", "contact_bodies"),
    }
    orders = set()
    for folder in logs.iterdir():
        assert sorted(p.name for p in folder.iterdir()) == ["log.npz", "nominal.xml", "test.npz"]
        for file in folder.glob("*.npz"):
            with zipfile.ZipFile(file) as archive:
                names = [i.filename.removesuffix(".npy") for i in archive.infolist()]
                stamps = {i.date_time for i in archive.infolist()}
                assert not archive.comment.strip(b"\0")
            assert set(names) <= allowed
            assert stamps == {(1980, 1, 1, 0, 0, 0)}
            orders.add(tuple(n for n in names if n not in ("qvel", "qpos_target")))
            with np.load(file, allow_pickle=False) as arrays:
                assert all(arrays[n].dtype != object for n in names)
    assert len({o[:5] for o in orders}) == 1


def test_names_sizes_and_times_tell_nothing(sealed):
    logs, hidden, _ = sealed
    words = {*ARM, *FLOATING, *UNKNOWN, *STRATA, "pinocchio", "wrong", "truth"}
    for path in [logs, *logs.rglob("*")]:
        assert path.stat().st_mtime == seal.MOMENT
        assert not any(word in path.name for word in words)
        if path.suffix == ".npz":
            assert path.stat().st_size % seal.BLOCK == 0
        if path.suffix == ".xml":
            # MJCF has an attribute `armature` of its own.
            assert not any(word in path.read_text() for word in words - {"armature"})
    # Names come from the operating system, not from the seed, and the answers lie elsewhere.
    assert all(len(p.name) == 12 and int(p.name, 16) >= 0 for p in logs.iterdir())
    assert sorted(p.name for p in hidden.iterdir()) == ["answers.sealed", "commitment.txt", "key"]
    assert (hidden / "key").stat().st_mode & 0o077 == 0
    assert b"payload" not in (hidden / "answers.sealed").read_bytes()


def test_the_nominal_model_does_not_know_the_effect():
    """The same robot with another effect comes with the same model and the same arrays."""
    from world.make import make

    made = {}
    for families in ((), ("payload",), ("encoder_offset",)):
        setting = dataclasses.replace(SHORT, key=(7, 7), families=families, duration=1.0)
        log, _, model, truth = make(setting)
        made[families] = (model, list(log), [v.dtype for v in log.values()])
        assert len(truth["effects"]) == len(families)
    first = made[()]
    assert all(m == first for m in made.values())


def test_the_answers_open_and_the_seed_makes_the_log_again(sealed):
    logs, hidden, promise = sealed
    answers = vault.unseal(hidden, promise, logs)
    assert set(answers["logs"]) == {p.name for p in logs.iterdir()}
    settings = three(seal.words_of(bytes.fromhex(answers["seed"])), 3, None)
    made = {tuple(s.families): s for s in settings}
    name, answer = next(
        (n, a) for n, a in answers["logs"].items() if a["truth"]["setting"]["stratum"] == "single"
    )
    truth = answer["truth"]
    assert truth["effects"][0]["family"] == "payload"
    log, _, _, again = seal._made(made[("payload",)])
    assert again["effects"] == truth["effects"]
    with np.load(logs / name / "log.npz") as held:
        np.testing.assert_array_equal(held["qpos"], log["qpos"])


def test_tampering_is_caught(sealed, tmp_path):
    logs, hidden, promise = sealed
    copy = tmp_path / "sealed"
    copy.mkdir()

    def fresh():
        for file in hidden.iterdir():
            (copy / file.name).write_bytes(file.read_bytes())

    fresh()
    vault.unseal(copy, promise, logs)
    raw = bytearray((copy / "answers.sealed").read_bytes())
    raw[len(raw) // 2] ^= 1
    (copy / "answers.sealed").write_bytes(bytes(raw))
    with pytest.raises(vault.SealBroken, match="commitment"):
        vault.unseal(copy, promise, logs)
    with pytest.raises(vault.SealBroken, match="commitment"):
        vault.unseal(hidden, "0" * 64, logs)
    # Other answers under another key, with a commitment of their own, are not what was published.
    (tmp_path / "other").mkdir()
    other = vault.seal({"logs": {}}, tmp_path / "other")
    assert other != promise
    with pytest.raises(vault.SealBroken, match="published"):
        vault.unseal(tmp_path / "other", promise, logs)
    # The right answers with one log changed, or one log too few.
    moved = tmp_path / "logs"
    for folder in logs.iterdir():
        (moved / folder.name).mkdir(parents=True)
        for file in folder.iterdir():
            (moved / folder.name / file.name).write_bytes(file.read_bytes())
    vault.unseal(hidden, promise, moved)
    victim = next(moved.iterdir())
    (victim / "nominal.xml").write_text((victim / "nominal.xml").read_text() + " ")
    with pytest.raises(vault.SealBroken, match="changed"):
        vault.unseal(hidden, promise, moved)
    for file in victim.iterdir():
        file.unlink()
    victim.rmdir()
    with pytest.raises(vault.SealBroken, match="missing"):
        vault.unseal(hidden, promise, moved)


PROBE = """
import importlib, json, os, sys
from pathlib import Path

def main(arguments):
    found = {"arguments": arguments, "imported": [], "opened": [], "listed": os.listdir("."), "env": sorted(os.environ)}
    for name in ("benchmarks.blind.seal", "seal", "vault", "world.plan", "world", "exam.marks"):
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
    names = sorted(p.name for p in logs.iterdir())
    forbidden = [str(BLIND / "seal.py"), *(str(p) for p in hidden.iterdir())]
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


def test_strata_robots_and_engines_have_their_shares():
    settings = plan((3, 1, 4), 400)
    share = {s: sum(x.stratum == s for x in settings) / 400 for s in STRATA}
    assert share["none"] >= 0.25
    assert share["unknown"] >= 0.15
    assert share["pair"] >= 0.20
    none = [x for x in settings if x.stratum == "none"]
    assert abs(sum(x.wrong for x in none) - len(none) / 2) <= 1
    assert sum(x.engine == "pinocchio" for x in settings) >= 400 / 3
    assert len({x.robot for x in settings}) == 5
    assert {f for x in settings if x.stratum == "single" for f in x.families} == {*ARM, *FLOATING}
    assert {f for x in settings if x.stratum == "unknown" for f in x.families} == {*UNKNOWN}
    for x in settings:
        assert len(x.families) == {"none": 0, "pair": 2}.get(x.stratum, 1)
        assert len(set(x.families)) == len(x.families)
