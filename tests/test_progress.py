"""Stages of long computations, piped and on a terminal; compiled programs that commands keep."""

import contextlib
import io
import json
import os
import signal
import subprocess
import sys

import jax
import pytest
from rich.console import Console

from jax_inertia.cli.main import main
from jax_inertia.cli.running import compiled, stages
from jax_inertia.text.progress import SHARES, Stage, shared


def test_shares_never_fall_and_unknown_texts_keep_the_last():
    seen = []
    report = shared(shared(seen.append))  # twice is once
    for text in ("batch fit", "something else", "filtering the log"):
        report(text)
    assert [s.share for s in seen] == [SHARES["batch fit"]] * 3
    assert isinstance(seen[0], Stage)
    assert seen == ["batch fit", "something else", "filtering the log"]


def clock(monkeypatch, times):
    monkeypatch.setattr(stages.time, "monotonic", iter(times).__next__)


def test_piped_there_is_a_line_for_each_stage_and_none_of_a_quick_command(monkeypatch, capsys):
    clock(monkeypatch, [0.0, 0.5, 1.0])
    with stages.stages() as stage:
        stage("batch fit")
        stage("noise")
    assert capsys.readouterr() == ("", "")
    clock(monkeypatch, [0.0, 0.5, 9.0, 9.5, 10.0])
    with stages.stages() as stage:
        stage("batch fit")
        stage("noise")
        stage("a step of it")  # too soon after the last line
        stage("filter")
    printed = capsys.readouterr()
    assert printed.out == ""
    assert [line.split("left: ")[-1] for line in printed.err.splitlines()] == [
        "batch fit",
        "noise",
        "filter",
    ]
    assert "9 s  50 %  about 9 s left: noise" in printed.err


def test_on_a_terminal_there_is_one_bar(monkeypatch):
    text = io.StringIO()
    screen = Console(file=text, force_terminal=True, width=100)
    monkeypatch.setattr(stages, "Console", lambda stderr: screen)
    with stages.stages() as stage:
        stage("filter")
        stage("what the log can tell")
    assert "85 %" in text.getvalue()
    assert "what the log can tell" in text.getvalue()


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """Where a command keeps compiled programs, given its options and environment."""
    names = ("compilation_cache_dir", "compilation_cache_max_size")
    names += ("persistent_cache_min_compile_time_secs", "persistent_cache_min_entry_size_bytes")
    before = {f"jax_{name}": getattr(jax.config, f"jax_{name}") for name in names}
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))

    def of(*options, given=None, **environment):
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        jax.config.update("jax_compilation_cache_dir", given)
        assert main([*options, "compare", "one"]) == 2  # which is nothing to compare
        for name in environment:
            monkeypatch.delenv(name)
        return jax.config.jax_compilation_cache_dir

    yield of
    for name, value in before.items():
        jax.config.update(name, value)


@pytest.mark.skipif(sys.platform != "linux", reason="the folder has another name there")
def test_commands_keep_compiled_programs_unless_told_not_to(cache, tmp_path):
    folder = tmp_path / "caches" / "jax_inertia" / "compiled"
    assert cache() == str(folder)
    assert folder.stat().st_mode & 0o077 == 0
    assert cache("--no-cache") is None
    assert cache(JAX_INERTIA_CACHE="off") is None
    assert cache(JAX_INERTIA_CACHE=str(tmp_path / "own")) == str(tmp_path / "own")
    assert cache(given=str(tmp_path / "jax")) == str(tmp_path / "jax")
    (tmp_path / "file").write_text("")
    assert cache(JAX_INERTIA_CACHE=str(tmp_path / "file" / "in it")) is None


def test_the_cache_is_bounded(tmp_path):
    """By JAX, with a bound of 40 kB in place of ours."""
    program = f"""
import jax, json, os
from jax_inertia.cli.running import compiled
compiled.MOST_BYTES, compiled.LEAST_SECONDS = 40_000, 0.0
compiled.keep_compiled()
for n in range(1, 12):
    jax.jit(lambda x: sum(x**k for k in range(n)))(1.0)
entries = [e for e in os.scandir({str(tmp_path)!r}) if e.name.endswith("-cache")]
print(json.dumps([e.stat().st_size for e in entries]))
"""
    own = {k: v for k, v in os.environ.items() if "COMPILATION_CACHE" not in k}
    own["JAX_INERTIA_CACHE"] = str(tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", program], env=own, capture_output=True, text=True, check=True
    )
    sizes = json.loads(done.stdout)
    assert len(sizes) > 1
    assert sum(sizes) <= 40_000
    assert compiled.MOST_BYTES <= 2**30


def test_a_second_command_says_nothing_of_the_cache(tmp_path):
    """XLA's own remarks on what it reads back fill the screen otherwise."""
    program = """
from jax_inertia.cli.main import main
from jax_inertia.cli.running import compiled
compiled.LEAST_SECONDS = 0.0
main(["compare", "one"])  # which is nothing to compare, and one line
import jax
jax.jit(lambda x: x + 1.0)(1.0)
"""
    away = ("COMPILATION_CACHE", "TF_CPP", "XLA_FLAGS")
    own = {k: v for k, v in os.environ.items() if not any(name in k for name in away)}
    own["JAX_INERTIA_CACHE"] = str(tmp_path)
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", program], env=own, capture_output=True, text=True, check=True
        )
        assert len(done.stderr.splitlines()) == 1, done.stderr
    assert any(tmp_path.iterdir())


def test_ctrl_c_that_somebody_swallows_ends_the_command_at_the_next_stage():
    """An import, or a callback of C code, may swallow the exception; Python asks for no more."""
    with stages.interruptible(), stages.stages() as stage:
        stage("before")
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            stage("after")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert sys.unraisablehook is not stages._unless_keyboard
    with stages.interruptible(), stages.stages() as stage:
        stage("of the next command")


def test_where_ctrl_c_is_somebody_else_s_it_stays():
    def own(number, frame):
        pass

    before = signal.signal(signal.SIGINT, own)
    try:
        with stages.interruptible():
            assert signal.getsignal(signal.SIGINT) is own
    finally:
        signal.signal(signal.SIGINT, before)
