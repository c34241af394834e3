"""Many logs by several processes, for the generators of this folder; a log is on disk whole or not at all."""

from __future__ import annotations

import argparse
import os
import shutil
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import numpy as np


def parser(doc: str, count: int) -> argparse.ArgumentParser:
    """Arguments that every generator has; `count` logs by default."""
    out = argparse.ArgumentParser(description=doc.split("\n")[0])
    out.add_argument("out", type=Path)
    out.add_argument("--n", type=int, default=count, help="number of logs")
    out.add_argument("--first", type=int, default=0, help="index of the first log")
    out.add_argument("--seed", type=int, default=1)
    out.add_argument("--jobs", type=int, default=1)
    return out


def write_folder(
    folder: Path, log: dict, test: dict, texts: dict[str, str], validation: dict | None = None
) -> None:
    """log.npz, test.npz, perhaps validation.npz, and files of text, by name."""
    part = folder.with_name(f".{folder.name}.{os.getpid()}")
    part.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(part / "log.npz", allow_pickle=False, **log)
    np.savez_compressed(part / "test.npz", allow_pickle=False, **test)
    if validation:
        np.savez_compressed(part / "validation.npz", allow_pickle=False, **validation)
    for name, text in texts.items():
        (part / name).write_text(text)
    if folder.exists():
        shutil.rmtree(folder)
    part.rename(folder)


def write_all(args: argparse.Namespace, write: Callable[..., str], *given) -> None:
    """`write(*given, seed, index)` for every index; its line is printed. RuntimeError: a log that cannot be drawn."""
    failed = 0
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
        indices = range(args.first, args.first + args.n)
        jobs = {pool.submit(write, *given, args.seed, k): k for k in indices}
        for done, job in enumerate(as_completed(jobs), start=1):
            try:
                line = job.result()
            except RuntimeError as error:
                failed, line = failed + 1, f"skipped: {error}"
            print(f"[{done}/{args.n}] {jobs[job]:05d} {line}", flush=True)
    if failed:
        raise SystemExit(f"{failed} of {args.n} logs could not be drawn")
