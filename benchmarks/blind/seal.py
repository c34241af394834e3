"""Seals a set: draws a seed, makes the logs that follow from it, and fixes them before any diagnosis.

    python -m benchmarks.blind.seal draw SEED                                   prints its SHA-256: publish it
    python -m benchmarks.blind.seal make LOGS VAULT --seed SEED --n 615 --jobs 30 [--engine pinocchio]

`make` writes LOGS/NAME/{log.npz, nominal.xml} and, of some logs, validation.npz: what a tool may see; and
VAULT/NAME/{test.npz, truth.json}: what the scorer alone opens. Names follow from the seed and tell nothing. A second
call goes on where the first was stopped; `--engine` makes the logs of one engine alone. Once all are there it writes
VAULT/manifest.json and prints its SHA-256, the commitment. Sensors' numbers are rounded below their noise, so that
another processor's last digits do not matter: with the seed, once it is opened, `make` gives the same files.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import hashlib
import io
import json
import secrets
import shutil
import zipfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import mujoco
import numpy as np
from rich.progress import track

from benchmarks.blind import checkout, vault
from benchmarks.worlds import setting, strata
from benchmarks.worlds.targets import position

MOMENT = 946_684_800  # 1 January 2000, of every file
TRIES, FURTHER = 5, 1_000_000
"""Other robots where no draw of an effect leaves the loop stable, and how far apart their indices are."""
STEPS = {
    **dict.fromkeys(("qpos", "qpos_target", "base_quat"), 2.0**-21),
    **dict.fromkeys(("qvel", "base_angvel"), 2.0**-17),
    **dict.fromkeys(("tau", "base_linacc"), 2.0**-13),
}
"""What sensors' numbers are rounded to [rad, rad/s, m/s²]; of torques relative to the joint's largest."""


def rounded(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The log in single precision, each number a multiple of a power of two below its noise."""
    out = dict(arrays)
    for name, step in STEPS.items():
        if name in arrays:
            x = arrays[name]
            if name == "tau":
                step = 2.0 ** np.floor(np.log2(step * np.abs(x).max(axis=0) + 1e-12))
            out[name] = (np.round(x / step) * step).astype(np.float32)
    return out


def npz_bytes(arrays: dict[str, np.ndarray]) -> bytes:
    """An .npz with fixed stamps and order."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, value in arrays.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, value, allow_pickle=False)
            info = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o600 << 16
            archive.writestr(info, member.getvalue(), compresslevel=7)
    return buffer.getvalue()


def write_log(task: strata.Task, name: str, logs: Path, hidden: Path) -> str | None:
    """Both folders of one log, each whole or not at all; why it cannot be made, where that is so."""
    if (logs / name).exists() and (hidden / name).exists():
        return None
    try:
        made = _made(task)
    except (RuntimeError, ValueError, mujoco.FatalError) as error:
        return f"{task.stratum} {task.kind}: {error}"
    files = {"log.npz": npz_bytes(rounded(made.log)), "nominal.xml": made.nominal.encode()}
    if made.validation:
        files["validation.npz"] = npz_bytes(rounded(made.validation))
    truth = json.dumps(made.truth, indent=1).encode()
    _put(hidden / name, {"test.npz": npz_bytes(rounded(made.test)), "truth.json": truth})
    _put(logs / name, files)
    return None


def _put(folder: Path, files: dict[str, bytes]) -> None:
    part = folder.parent.with_name(f"{folder.parent.name}.parts") / folder.name
    for place in (part, folder):
        shutil.rmtree(place, ignore_errors=True)
    part.mkdir(parents=True)
    for name, data in files.items():
        (part / name).write_bytes(data)
        os.utime(part / name, (MOMENT, MOMENT))
    os.utime(part, (MOMENT, MOMENT))
    folder.parent.mkdir(parents=True, exist_ok=True)
    part.rename(folder)


def _made(task: strata.Task):
    """Of another robot where no draw of the effect leaves the loop stable."""
    for further in range(TRIES):
        try:
            return strata.make(replace(task, index=task.index + further * FURTHER))
        except RuntimeError as error:
            failure = error
    raise failure


def plan(seed: bytes, count: int) -> list[tuple[strata.Task, str]]:
    """What each log holds, and its name: who lacks the seed learns nothing from it."""
    words = int.from_bytes(hashlib.sha256(seed).digest(), "little")
    names = [hashlib.sha256(b"%b name %d" % (seed, k)).hexdigest()[:12] for k in range(count)]
    return list(zip(strata.plan(words, count), names, strict=True))


def make(
    logs: Path, hidden: Path, seed: bytes, count: int, jobs: int = 1, engine: str | None = None
) -> str | None:
    """Every log that is not there yet, and the commitment; None where some are another engine's."""
    tasks = plan(seed, count)
    todo = [x for x in tasks if engine in (None, x[0].engine)]
    # Those of targets take longest: their effects' sizes are measured by further simulations.
    todo.sort(key=lambda x: x[0].stratum not in position.STRATA)
    lacking: dict[str, str | None] = {}
    if jobs == 1:
        lacking = {name: write_log(task, name, logs, hidden) for task, name in todo}
    else:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            running = {n: pool.submit(write_log, t, n, logs, hidden) for t, n in todo}
            for name in track(running, "making logs"):
                lacking[name] = running[name].result()
    lacking = {name: why for name, why in lacking.items() if why}
    if any(not (logs / name).exists() for _, name in tasks if name not in lacking):
        return None
    for place in (logs, hidden):
        shutil.rmtree(place.with_name(f"{place.name}.parts"), ignore_errors=True)
    about = {
        "seed_sha256": hashlib.sha256(seed).hexdigest(),
        "count": count,
        "commit": checkout.commit(),
        "not_made": lacking,
    }
    return vault.seal(logs, hidden, about)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    draw = commands.add_parser("draw")
    draw.add_argument("seed", type=Path)
    more = commands.add_parser("make")
    more.add_argument("logs", type=Path)
    more.add_argument("vault", type=Path)
    more.add_argument("--seed", type=Path, required=True)
    more.add_argument("--n", type=int, default=615)
    more.add_argument("--jobs", type=int, default=1)
    more.add_argument("--engine", choices=setting.ENGINES)
    args = parser.parse_args()
    if args.command == "draw":
        if args.seed.exists():
            parser.error(f"{args.seed} holds a seed already; choose another file")
        args.seed.touch(mode=0o600)
        args.seed.write_text(secrets.token_hex(32))
        print(hashlib.sha256(args.seed.read_bytes()).hexdigest())
        return
    promise = make(args.logs, args.vault, args.seed.read_bytes(), args.n, args.jobs, args.engine)
    print(f"commitment {promise}" if promise else "other logs of the set are still to be made")


if __name__ == "__main__":
    main()
