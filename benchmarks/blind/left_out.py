"""Leave one family out: what does the diagnosis say of an effect that its library lacks?

    python benchmarks/blind/left_out.py plan LOGS SEALED OUT --commitment HEX
    python benchmarks/blind/left_out.py run LOGS OUT --jobs 2 [--limit N]

After the answers are open. `plan` writes OUT/FAMILY.txt, the clear logs that hold that family alone; `run` diagnoses
those with `--exclude FAMILY`, as `solve.py` does, into OUT/FAMILY; `score.py --left-out OUT` adds the table. Honest is
`unknown`, or a twin: what the diagnosis with all families declares to tie with it, what contains the family as a
special case, or the parts that it is the sum of.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import solve
import vault
from exam.marks import CLEAR, accepted, key
from exam.rates import Share

CONTAINS = {
    "coulomb_friction": {"stribeck_friction", "asymmetric_coulomb", "load_friction"},
    "viscous_friction": {"friction_drift"},
    "torque_bias": {"joint_spring"},
    "com_shift": {"payload"},
    "constant_force": {"push"},
    "joint_elasticity": {"backlash"},
}
"""Families that are another one with a number more (a gear's play on its spring): to name those is no mistake."""

PARTS = {"asymmetric_coulomb": {"coulomb_friction", "torque_bias"}}
"""Families that are the sum of others at the same place, exactly."""


def holders(answers: dict) -> dict[str, list[str]]:
    """Names of the clear logs that hold one effect, by its family."""
    out: dict[str, list[str]] = {}
    for name, answer in answers["logs"].items():
        truth = answer["truth"]
        if truth["setting"]["stratum"] == "single":
            effect = truth["effects"][0]
            if effect["visibility"]["distinct"] >= CLEAR:
                out.setdefault(effect["family"], []).append(name)
    return dict(sorted(out.items()))


def honest(truth: dict, report: dict, whole: dict | None) -> bool:
    """Whether a report without the true family is an honest one; `whole` is the report with all families."""
    if report["verdict"] in ("unknown", "no_gap"):
        return report["verdict"] == "unknown"
    found, effect = key(report["effects"][0]), truth["effects"][0]
    if found in accepted(truth)[0]:
        return True
    place = effect["location"]["name"]
    if found[0] in CONTAINS.get(effect["family"], ()) and found[1] == place:
        return True
    parts = PARTS.get(effect["family"])
    if parts and parts <= {f for f, at in map(key, report["effects"]) if at == place}:
        return True
    if whole is None or not whole["effects"]:
        return False
    first = whole["effects"][0]
    return {found, key(effect)} <= {key(first), *map(key, first["equivalent"])}


def table(answers: dict, out: Path, found: Path) -> str:
    """A row per family that was left out, and the whole."""
    lines = [
        "## Each family left out in turn",
        "",
        "| left out | unknown | or a declared twin | place |",
    ]
    lines.append("|---|---|---|---|")
    sums = [0, 0, 0, 0]
    for family, names in holders(answers).items():
        counts = [0, 0, 0, 0]
        for name in names:
            file = out / family / "results" / name / "report.json"
            if not file.exists():
                continue
            report = json.loads(file.read_text())
            full = found / "results" / name / "report.json"
            whole = json.loads(full.read_text()) if full.exists() else None
            truth = answers["logs"][name]["truth"]
            place = truth["effects"][0]["location"]["name"]
            told = {key(e)[1] for e in report["effects"][:1]}
            counts[0] += report["verdict"] == "unknown"
            counts[1] += honest(truth, report, whole)
            counts[2] += place in told
            counts[3] += 1
        if counts[3]:
            sums = [a + b for a, b in zip(sums, counts, strict=True)]
            cells = " | ".join(str(Share(k, counts[3])) for k in counts[:3])
            lines.append(f"| {family} | {cells} |")
    lines.append("| **all** | " + " | ".join(str(Share(k, sums[3])) for k in sums[:3]) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True, dest="command")
    plan = commands.add_parser("plan")
    plan.add_argument("logs", type=Path)
    plan.add_argument("sealed", type=Path)
    plan.add_argument("out", type=Path)
    plan.add_argument("--commitment", required=True)
    run = commands.add_parser("run")
    run.add_argument("logs", type=Path)
    run.add_argument("out", type=Path)
    run.add_argument("--jobs", type=int, default=1)
    run.add_argument("--limit", type=int, help="logs a family, at most")
    args = parser.parse_args()
    if args.command == "plan":
        told = Path(args.commitment)
        promise = told.read_text() if told.exists() else args.commitment
        answers = vault.unseal(args.sealed, promise, args.logs)
        args.out.mkdir(parents=True, exist_ok=True)
        for family, names in holders(answers).items():
            (args.out / f"{family}.txt").write_text("\n".join(names) + "\n")
        return
    tasks = [
        solve.Task(args.logs / name, args.out / file.stem, (file.stem,))
        for file in sorted(args.out.glob("*.txt"))
        for name in file.read_text().split()[: args.limit]
    ]
    solve.solve(tasks, args.out / "work", args.jobs)


if __name__ == "__main__":
    main()
