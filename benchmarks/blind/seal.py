"""Seals an examination: logs with hidden effects under random names, and their answers under lock and key.

    python benchmarks/blind/seal.py LOGS SEALED --n 400 --jobs 2 [--seed FILE] [--mixed [--again NAMES]]

LOGS gets one folder a log, named at random: log.npz, test.npz (another motion), nominal.xml, and nothing else. SEALED
gets the encrypted answers, the key and the commitment, which is printed: publish it before any diagnosis. The seed
comes from the operating system, or from the bytes of FILE; it is sealed with the answers, so that anyone can make the
logs again once they are open. `--mixed`: the strata of `mixed.py` instead of one and two effects on a good model
(`world`); `--again` makes some of their logs once more, under the same names. A second call goes on where the first
was stopped. Prints nothing about any log.
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
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import checkout
import mixed
import numpy as np
import vault
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

if TYPE_CHECKING:
    from world.plan import Setting

    Planned = Setting | mixed.Task

BLOCK = 1 << 13
MOMENT = 946_684_800  # 1 January 2000, of every file
NOTES = "seed.json"
TRIES, FURTHER = 5, 1_000_000
"""Other robots where no draw of an effect leaves the loop stable, and how far apart their indices are."""


def npz_bytes(arrays: dict[str, np.ndarray]) -> bytes:
    """An .npz with fixed stamps and order, filled up to whole blocks: its size tells the robot and the rate alone."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, value in arrays.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, value, allow_pickle=False)
            info = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o600 << 16
            archive.writestr(info, member.getvalue(), compresslevel=7)
    raw = buffer.getvalue()
    with zipfile.ZipFile(buffer, "a") as archive:
        archive.comment = b"\0" * (-len(raw) % BLOCK)
    return buffer.getvalue()


def write_log(setting: Planned, name: str, work: Path) -> dict:
    """One log in `work`, whole or not at all, and its answer beside it; the answer."""
    answer_file = work / "answers" / f"{name}.json"
    folder = work / "logs" / name
    if answer_file.exists() and folder.exists():
        return json.loads(answer_file.read_text())
    log, test, model, truth = _made(setting)
    part = work / "parts" / name
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    (part / "log.npz").write_bytes(npz_bytes(log))
    (part / "test.npz").write_bytes(npz_bytes(test))
    (part / "nominal.xml").write_text(model)
    answer = {"sha256": vault.fingerprint(part), "truth": truth}
    shutil.rmtree(folder, ignore_errors=True)
    part.rename(folder)
    whole = answer_file.with_suffix(".part")
    whole.write_text(json.dumps(answer))
    whole.rename(answer_file)
    return answer


def _made(setting: Planned):
    """Log, other motion, nominal model and truth."""
    if not isinstance(setting, mixed.Task):
        return _made_in_world(setting)
    for further in range(TRIES):
        try:
            made = mixed.make(replace(setting, index=setting.index + further * FURTHER))
            return made.log, made.test, made.nominal, made.truth
        except RuntimeError as error:
            failure = error
    raise failure


def _made_in_world(setting: Setting):
    """`make`, with other robots of the same kind where no draw of an effect leaves the loop stable."""
    from world.make import make  # It needs Pinocchio, and most mixed strata do not.

    for further in range(TRIES):
        try:
            return make(replace(setting, key=(*setting.key, further)))
        except RuntimeError as error:
            failure = error
    raise failure


def words_of(seed: bytes) -> tuple[int, ...]:
    """Eight words of 32 bits from any bytes."""
    return tuple(int(w) for w in np.frombuffer(hashlib.sha256(seed).digest(), "<u4"))


def names_of(seed: bytes, count: int) -> list[str]:
    """Of the logs in their order: who lacks the seed learns nothing from them."""
    return [hashlib.sha256(b"%b name %d" % (seed, k)).hexdigest()[:12] for k in range(count)]


def again(logs: Path, seed: bytes, count: int, wanted: set[str], jobs: int) -> None:
    """Some logs of a set of mixed strata, made again of its seed."""
    todo = zip(plan_mixed(words_of(seed), count, None), names_of(seed, count), strict=True)
    work = logs.with_name(f"{logs.name}.work")
    for folder in ("answers", "logs", "parts"):
        (work / folder).mkdir(parents=True, exist_ok=True)
    logs.mkdir(parents=True, exist_ok=True)
    for name, _ in _each([(t, n) for t, n in todo if n in wanted], work, jobs):
        shutil.move(work / "logs" / name, logs / name)
    shutil.rmtree(work)


def begin(sealed: Path, count: int, seed: Path | None, robots: list[str] | None) -> dict:
    """What fixes the set: drawn once, read again by a second call."""
    notes = sealed / NOTES
    if notes.exists():
        return json.loads(notes.read_text())
    sealed.mkdir(parents=True, exist_ok=True)
    raw = seed.read_bytes() if seed else secrets.token_bytes(32)
    names = names_of(raw, count)
    made = {
        "seed": raw.hex(),
        "count": count,
        "names": names,
        "robots": robots,
        "commit": checkout.commit(),
    }
    part = notes.with_suffix(".part")
    part.touch(mode=0o600)
    part.write_text(json.dumps(made))
    part.rename(notes)
    return made


def seal_set(
    logs: Path,
    sealed: Path,
    count: int,
    seed: Path | None = None,
    jobs: int = 1,
    robots: list[str] | None = None,
    settings: Callable[..., Sequence[Planned]] | None = None,
) -> str:
    """Everything; returns the commitment. `settings(words, count, robots)` plans the logs; None: `plan_world`."""
    notes = begin(sealed, count, seed, robots)
    names = notes["names"]
    words = words_of(bytes.fromhex(notes["seed"]))
    todo = (settings or plan_world)(words, len(names), notes["robots"])
    work = sealed / "work"
    for folder in ("answers", "logs", "parts"):
        (work / folder).mkdir(parents=True, exist_ok=True)
    answers: dict[str, dict] = {}
    columns = ("sealing", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns) as progress:
        bar = progress.add_task("", total=len(names))
        for name, answer in _each(list(zip(todo, names, strict=True)), work, jobs):
            answers[name] = answer
            progress.advance(bar)
    logs.mkdir(parents=True, exist_ok=True)
    for name in sorted(names):
        shutil.move(work / "logs" / name, logs / name)
    _same_times(logs)
    public = {"seed": notes["seed"], "commit": notes["commit"], "robots": notes["robots"]}
    promise = vault.seal(public | {"logs": dict(sorted(answers.items()))}, sealed)
    shutil.rmtree(work)
    (sealed / NOTES).unlink()
    return promise


def plan_world(words: tuple[int, ...], count: int, robots: list[str] | None) -> list[Setting]:
    """One and two effects on a good model; `robots`: those alone, in the same proportions."""
    from world.plan import ROBOTS, plan  # Pinocchio, as above.

    shares = {r: ROBOTS[r] for r in robots or ROBOTS}
    return plan(words, count, {r: s / sum(shares.values()) for r, s in shares.items()})


def plan_mixed(words: tuple[int, ...], count: int, robots: list[str] | None) -> list[mixed.Task]:
    """Tasks of the mixed strata; their seed is all of the set's."""
    seed = sum(int(w) << 32 * k for k, w in enumerate(words))
    return mixed.plan(seed, count)


def _each(todo: list[tuple[Planned, str]], work: Path, jobs: int):
    if jobs == 1:
        for setting, name in todo:
            yield name, write_log(setting, name, work)
        return
    # A fork beside the bar's thread may inherit a lock that nobody opens.
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        running = {pool.submit(write_log, s, n, work): n for s, n in todo}
        for done in as_completed(running):
            yield running[done], done.result()


def _same_times(logs: Path) -> None:
    for path in sorted(logs.rglob("*"), reverse=True):
        os.utime(path, (MOMENT, MOMENT))
    os.utime(logs, (MOMENT, MOMENT))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs", type=Path)
    parser.add_argument("sealed", type=Path)
    parser.add_argument("--n", type=int, default=400)
    parser.add_argument("--seed", type=Path, help="file whose bytes are the seed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--robots", nargs="+", help="of sets without --mixed")
    parser.add_argument("--mixed", action="store_true", help="the strata of mixed.py")
    parser.add_argument(
        "--again", type=Path, help="file of names: those logs alone, nothing sealed"
    )
    args = parser.parse_args()
    if args.again:
        if not (args.mixed and args.seed):
            parser.error("--again: expected --mixed and --seed")
        wanted = set(args.again.read_text().split())
        again(args.logs, args.seed.read_bytes(), args.n, wanted, args.jobs)
        return
    if args.mixed and args.robots:
        parser.error("--robots: of sets without --mixed")
    if args.robots:
        from world.plan import ROBOTS

        if unknown := sorted(set(args.robots) - set(ROBOTS)):
            parser.error(f"--robots {' '.join(unknown)}: expected {', '.join(sorted(ROBOTS))}")
    if (args.sealed / vault.ANSWERS).exists():
        parser.error(f"{args.sealed} holds sealed answers already; choose another folder")
    settings = plan_mixed if args.mixed else None
    promise = seal_set(args.logs, args.sealed, args.n, args.seed, args.jobs, args.robots, settings)
    print(f"commitment {promise}")


if __name__ == "__main__":
    main()
