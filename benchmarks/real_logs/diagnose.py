"""Diagnoses of real robots, no labels used. Writes DIAGNOSES.md and its figures beside itself.

    python benchmarks/real_logs/diagnose.py [--only NAME ...] [--out DIR]

Each case is what `jax-inertia diagnose` does with the model and the logs in DIR/NAME; report.html, report.json and
corrected.xml go there too. DIAGNOSES.md is put together from the cases that DIR holds, so that one may be run again
alone. The logs are looked for in ../shared/data beside the repository, or in $JAX_INERTIA_DATA.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import time
import warnings
from pathlib import Path

import diagnosis_report as report
import jax
from diagnosis_cases import CASES, Case
from diagnosis_figures import figure
from diagnosis_summary import Summary, summarise
from logs import SHARED
from report import machine

from jax_inertia.cli import diagnose_run as pipeline
from jax_inertia.cli.console import stages

HERE = Path(__file__).parent
PAGE = "DIAGNOSES.md"


def run(case: Case, folder: Path) -> Summary:
    """One case, start to end: files, diagnosis, report, figure, numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    with stages() as stage:
        stage("preparing model and logs")
        files = case.prepare(folder)
        start = time.perf_counter()
        inputs = pipeline.read(files.model, files.log, files.test, ())
        result = pipeline.diagnosis(inputs, (), case.max_effects, stage)
        seconds = time.perf_counter() - start
        stage("writing")
        pipeline.write(folder, inputs, result)
        summary = summarise(case, files, inputs, result, seconds)
        figure(folder / f"diagnosis_{case.name}.png", case.title, result.found.trace, summary)
    (folder / "summary.json").write_text(json.dumps(summary.to_json(), indent=1) + "\n")
    return summary


def collect(out: Path) -> dict[str, Summary]:
    """Every case that has been run into `out`."""
    return {
        case.name: Summary.from_json(json.loads(path.read_text()))
        for case in CASES
        if (path := out / case.name / "summary.json").is_file()
    }


def main() -> None:
    """Run what is asked for, then write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [case.name for case in CASES]
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="NAME")
    parser.add_argument("--out", type=Path, default=Path("out") / "real_diagnoses")
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore")
    for case in CASES:
        if case.name not in args.only:
            continue
        if not case.present:
            print(f"{case.name}: skipped, no {SHARED / case.folder}", flush=True)
            continue
        print(f"{case.name}: {case.title}", flush=True)
        summary = run(case, args.out / case.name)
        print(report.line(summary), flush=True)
    done = collect(args.out)
    if not done:
        return
    for name in done:
        picture = f"diagnosis_{name}.png"
        (HERE / picture).write_bytes((args.out / name / picture).read_bytes())
    (HERE / PAGE).write_text(report.render(done, machine()))
    print(f"wrote {HERE / PAGE}")


if __name__ == "__main__":
    main()
