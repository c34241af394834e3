"""Leave one family out: what does the diagnosis say of an effect that its library lacks?

    python benchmarks/blind/left_out.py plan LOGS SEALED OUT --commitment HEX
    python benchmarks/blind/left_out.py run LOGS OUT --jobs 2 [--limit N]
    python benchmarks/blind/left_out.py table LOGS SEALED OUT --commitment HEX --found FOUND

After the answers are open. `plan` writes OUT/FAMILY.txt, the clear logs that hold that family alone, or beside ordinary
physics; `run` diagnoses those with `--exclude FAMILY`, as `solve.py` does, into OUT/FAMILY; `table` prints what came of
it (`score.py --left-out OUT` adds it to its page). Honest is `unknown`, of mixed sets `partly` too, or a twin: what the
diagnosis with all families declares to tie with it, what contains the family as a special case, or the parts that it is
the sum of.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
for folder in (HERE, HERE.parent / "gap"):
    sys.path.append(str(folder))

import solve  # noqa: E402
import vault  # noqa: E402
from evaluate_cad import SEEN, keys_of  # noqa: E402
from exam.marks import CLEAR, accepted, key  # noqa: E402
from exam.rates import Share  # noqa: E402
from report_torque import ORDINARY  # noqa: E402

CONTAINS = {
    "coulomb_friction": {"stribeck_friction", "asymmetric_coulomb", "load_friction"},
    "viscous_friction": {"friction_drift"},
    "torque_bias": {"joint_spring"},
    "com_shift": {"payload"},
    "constant_force": {"push"},
    "joint_elasticity": {"backlash"},
}
"""Families that are another one with a number more (a gear's play on its spring): to name those is no mistake."""

FLAGGED = {False: ("unknown",), True: ("unknown", "partly")}
"""Verdicts that say something is missing, of sets without and with --mixed."""

PARTS = {"asymmetric_coulomb": {"coulomb_friction", "torque_bias"}}
"""Families that are the sum of others at the same place, exactly."""


def is_mixed(truth: dict) -> bool:
    return "setting" not in truth


def hidden(truth: dict) -> dict | None:
    """The one effect of a log that is clear and of the library."""
    if is_mixed(truth):
        odd = truth.get("odd")
        mine = odd and truth["stratum"] in ("one_effect", "bare_odd")
        return odd if mine and odd["visibility"]["sigmas"] >= SEEN else None
    effect = truth["effects"][0] if truth["setting"]["stratum"] == "single" else None
    return effect if effect and effect["visibility"]["distinct"] >= CLEAR else None


def first(truth: dict, report: dict) -> dict | None:
    """The most important effect listed; of a robot as it is bought, beyond ordinary physics."""
    bought = truth.get("stratum") == "bare_odd"
    some = [e for e in report["effects"] if not (bought and e["family"] in ORDINARY)]
    return some[0] if some else None


def holders(answers: dict) -> dict[str, list[str]]:
    """Names of the clear logs that hold one effect, by its family."""
    out: dict[str, list[str]] = {}
    for name, answer in answers["logs"].items():
        if effect := hidden(answer["truth"]):
            out.setdefault(effect["family"], []).append(name)
    return dict(sorted(out.items()))


def honest(truth: dict, report: dict, whole: dict | None) -> bool:
    """Whether a report without the true family is an honest one; `whole` is the report with all families."""
    if report["verdict"] in ("unknown", "no_gap"):
        return report["verdict"] == "unknown"
    mixed = is_mixed(truth)
    if mixed and report["verdict"] == "partly":
        return True
    effect = truth["odd"] if mixed else truth["effects"][0]
    listed = first(truth, report)
    if listed is None:
        return False
    found = key(listed)
    if found in (keys_of(effect) if mixed else accepted(truth)[0]):
        return True
    place = effect["location"]["name"]
    if found[0] in CONTAINS.get(effect["family"], ()) and found[1] == place:
        return True
    parts = PARTS.get(effect["family"])
    if parts and parts <= {f for f, at in map(key, report["effects"]) if at == place}:
        return True
    before = None if whole is None else first(truth, whole)
    return before is not None and {found, key(effect)} <= keys_of(before)


def table(answers: dict, out: Path, found: Path) -> str:
    """A row per family that was left out, and the whole."""
    lines = [
        "## Each family left out in turn",
        "",
        "| left out | flagged | or a declared twin | place |",
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
            effect = hidden(truth)
            assert effect is not None
            listed = first(truth, report)
            counts[0] += report["verdict"] in FLAGGED[is_mixed(truth)]
            counts[1] += honest(truth, report, whole)
            counts[2] += listed is not None and key(listed)[1] == effect["location"]["name"]
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
    for name in ("plan", "table"):
        one = commands.add_parser(name)
        for argument in ("logs", "sealed", "out"):
            one.add_argument(argument, type=Path)
        one.add_argument("--commitment", required=True)
    one.add_argument("--found", type=Path, required=True, help="what solve.py wrote")
    run = commands.add_parser("run")
    run.add_argument("logs", type=Path)
    run.add_argument("out", type=Path)
    run.add_argument("--jobs", type=int, default=1)
    run.add_argument("--limit", type=int, help="logs a family, at most")
    args = parser.parse_args()
    if args.command != "run":
        told = Path(args.commitment)
        promise = told.read_text() if told.exists() else args.commitment
        answers = vault.unseal(args.sealed, promise, args.logs)
        if args.command == "table":
            print(table(answers, args.out, args.found))
            return
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
