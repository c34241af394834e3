"""Scores reports on the robots of `any_robots.py`: what is found, what is invented, which verdicts are right.

    python benchmarks/gap/evaluate_any.py DATA --reports DIR [--run] [--jobs 1] [--python PYTHON]

The report of log 42 is DIR/00042/report.json; `--run` diagnoses what has none. An odd effect is found where a listed
one, or one stated equivalent to it, is it or what it is to a model of two numbers a joint (`ALSO`). Whether a log shows
an effect at all is not asked, so that the share found is the least it may be.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from evaluate import key, wilson
from evaluate_cad import diagnose
from many import parser
from report_torque import ORDINARY

OF_BODY = ("payload", "com_shift", "link_inertia")
ALSO = {
    "payload": OF_BODY,
    "com_shift": OF_BODY,
    "mass_scale": OF_BODY,
    "external_force": ("constant_force",),
    "torque_limit": ("torque_saturation",),
    "asymmetric_coulomb": ("asymmetric_coulomb", "torque_bias"),
}
"""What else an effect may be called. Uneven friction that pulls both ways alike is a bias, but for its rests."""


def score(folder: Path, reports: Path) -> dict | None:
    """What of one log is found and invented, and its verdict; None without a report."""
    truth = json.loads((folder / "truth.json").read_text())
    path = reports / folder.name / "report.json"
    if not path.exists():
        return None
    report = json.loads(path.read_text())
    listed = [e for e in report["effects"] if truth["calibrated"] or e["family"] not in ORDINARY]
    told = [{key(e), *map(key, e.get("equivalent", []))} for e in listed]
    # A bias that is distinct is an ordinary number of a joint of a robot as bought, and stands in its table.
    biased = {
        ("torque_bias", name)
        for name, terms in report.get("joints", {}).items()
        if "torque_bias" in terms and not _zero_within(terms["torque_bias"]["ci95"])
    }
    wanted = [
        {(f, o["place"]) for f in ALSO.get(o["family"], (o["family"],))} for o in truth["odd"]
    ]
    known = set().union(*told, biased)
    return {
        "log": folder.name,
        "odd": [f"{o['family']} at {o['place']}" for o in truth["odd"]],
        "found": [bool(w & known) for w in wanted],
        "invented": [
            " at ".join(key(e))
            for e, k in zip(listed, told, strict=True)
            if not any(w & k for w in wanted)
        ],
        "verdict": report["verdict"],
        "confidence": report["confidence"],
    }


def _zero_within(ci95: list[float] | None) -> bool:
    return ci95 is None or ci95[0] <= 0.0 <= ci95[1]


def table(rows: list[dict]) -> str:
    """Shares with their intervals, then each log that is not right."""
    odd = [x for r in rows for x in r["found"]]
    plain = [r for r in rows if not r["odd"]]
    right = lambda r: all(r["found"]) and not r["invented"]  # noqa: E731
    said = [r for r in rows if r["verdict"] in ("explained", "no_gap")]
    lines = [
        f"- odd effects found: {wilson(sum(odd), len(odd))}",
        f"- robots with nothing odd on which nothing is invented: "
        f"{wilson(sum(not r['invented'] for r in plain), len(plain))}",
        f"- with something odd on which nothing else is invented: "
        f"{wilson(sum(not r['invented'] for r in rows if r['odd']), len(rows) - len(plain))}",
        f"- `explained` or `no_gap` and all right: {wilson(sum(map(right, said)), len(said))}, "
        f"mean confidence {np.mean([r['confidence'] for r in said]):.2f}",
        f"- verdicts: {dict(Counter(r['verdict'] for r in rows))}",
        "",
    ]
    for r in rows:
        if not right(r):
            missed = [o for o, f in zip(r["odd"], r["found"], strict=True) if not f]
            says = f"{r['verdict']} {r['confidence']:.2f}"
            lines.append(
                f"- {r['log']} {says}: missed {', '.join(missed) or 'nothing'}, "
                f"invented {', '.join(r['invented']) or 'nothing'}"
            )
    return "\n".join(lines)


if __name__ == "__main__":
    options = parser(__doc__, 0)
    options.add_argument("--reports", type=Path, required=True)
    options.add_argument("--run", action="store_true")
    options.add_argument("--python", default=sys.executable)
    args = options.parse_args()
    folders = sorted(p.parent for p in args.out.glob("*/truth.json"))
    if args.run:
        with ThreadPoolExecutor(args.jobs) as pool:
            list(pool.map(lambda f: diagnose(f, args.reports / f.name, args.python), folders))
    print(table([r for r in (score(f, args.reports) for f in folders) if r is not None]))
