"""How visible each effect of an opened set is against the same motion with nothing hidden, for `score.py --still`.

    python benchmarks/blind/still.py SEALED LOGS OUT --commitment HEX --jobs 2

Sets 1 and 2 measured an effect's visibility on its log alone, the noise of the drives included: on a robot with a
rough drive the faintest effect counted as clear. Sets sealed since then say what is written here already.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import vault
from rich.progress import track
from world.make import Bench
from world.plan import Setting
from world.yardstick import beyond


def visible(truth: dict) -> list[dict]:
    """`visibility` of each of one log's effects beyond the same motion without them."""
    if not truth["effects"]:
        return []
    bench = Bench(
        Setting(**{k: tuple(x) if isinstance(x, list) else x for k, x in truth["setting"].items()})
    )
    bench.take(truth["attempt"])
    still = bench.still()
    return [beyond(e["visibility"], still) for e in truth["effects"]]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sealed", type=Path)
    parser.add_argument("logs", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--commitment", required=True)
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    answers = vault.unseal(args.sealed, args.commitment, args.logs)["logs"]
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
        every = pool.map(visible, [a["truth"] for a in answers.values()])
        found = dict(zip(answers, track(every, total=len(answers)), strict=True))
    part = args.out.with_suffix(".part")
    part.write_text(json.dumps(found, indent=1) + "\n")
    part.rename(args.out)


if __name__ == "__main__":
    main()
