"""Shards: nothing is lost or made twice, and the same numbers come out however many devices make them."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]

from benchmarks.harness.shards import MANIFEST, Shards  # noqa: E402

ASKED = {"trial": "none", "seed": 1}


def made(numbers: range) -> dict[str, np.ndarray]:
    return {"index": np.array(numbers), "value": np.sqrt(np.array(numbers, float))}


def test_resumed_run_holds_every_entry_once(tmp_path: Path):
    first = Shards(tmp_path, ASKED, total=23, size=5)
    assert len(first) == 5
    for k in (0, 3):
        first.save(k, made(first.entries(k)))
    again = Shards(tmp_path, ASKED, total=23, size=5)
    assert again.missing() == [1, 2, 4]
    for k in again.missing():
        again.save(k, made(again.entries(k)))
    np.testing.assert_array_equal(Shards(tmp_path, ASKED, 23, 5).load()["index"], np.arange(23))


def test_damaged_or_unlisted_shard_is_made_again(tmp_path: Path):
    shards = Shards(tmp_path, ASKED, total=10, size=5)
    for k in range(2):
        shards.save(k, made(shards.entries(k)))
    (tmp_path / "shard-00000.npz").write_bytes(b"half a file")
    assert Shards(tmp_path, ASKED, 10, 5).missing() == [0]
    # Stopped between the file and the manifest: the file does not count.
    manifest = json.loads((tmp_path / MANIFEST).read_text())
    manifest["shards"] = []
    (tmp_path / MANIFEST).write_text(json.dumps(manifest))
    assert Shards(tmp_path, ASKED, 10, 5).missing() == [0, 1]


def test_interrupted_write_leaves_no_shard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    shards = Shards(tmp_path, ASKED, total=5, size=5)

    def fails(*_):
        raise OSError("no space")

    monkeypatch.setattr(os, "replace", fails)
    with pytest.raises(OSError, match="no space"):
        shards.save(0, made(range(5)))
    monkeypatch.undo()
    again = Shards(tmp_path, ASKED, 5, 5)
    assert again.missing() == [0]
    assert [p.name for p in tmp_path.iterdir()] == [MANIFEST]


def test_folder_of_another_run_is_refused(tmp_path: Path):
    Shards(tmp_path, ASKED, total=5, size=5)
    with pytest.raises(ValueError, match="seed"):
        Shards(tmp_path, {**ASKED, "seed": 2}, total=5, size=5)


def monte_carlo(out: Path, devices: int, *extra: str) -> subprocess.Popen:
    flags = f"--xla_force_host_platform_device_count={devices} --xla_backend_optimization_level=0"
    env = {**os.environ, "JAX_PLATFORMS": "cpu", "XLA_FLAGS": flags, "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, str(ROOT / "benchmarks" / "monte_carlo.py"), str(out)]
    command += [
        "--rollouts",
        "12",
        "--shard",
        "8",
        "--lanes",
        "1",
        "--seconds",
        "1.0",
        "--robot",
        "small",
        *extra,
    ]
    return subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)


@pytest.mark.slow
def test_two_processes_of_four_devices_give_the_single_devices_numbers(tmp_path: Path):
    with socket.socket() as free:
        free.bind(("localhost", 0))
        address = f"localhost:{free.getsockname()[1]}"
    several = ("--hosts", "2", "--coordinator", address)
    runs = [monte_carlo(tmp_path / "one", 1)]
    runs += [monte_carlo(tmp_path / "many", 4, *several, "--host", str(k)) for k in range(2)]
    try:
        for run in runs:
            output, _ = run.communicate(timeout=1200)
            assert run.returncode == 0, output.decode()
    finally:
        for run in runs:
            run.kill()
    asked = {"robot": "small", "seed": 0, "seconds": 1.0, "lanes": 1}
    one, many = (Shards(tmp_path / name, asked, 12, 8).load() for name in ("one", "many"))
    assert sorted(one["index"]) == list(range(12))
    assert len(np.unique(one["load"])) == 12
    for name, values in one.items():
        np.testing.assert_array_equal(values, many[name], err_msg=name)
