"""What each rule of the whole-robot diagnosis is worth: every one off alone, on logs of `cad.py`.

    python benchmarks/gap/ablate_cad.py DATA OUT [--jobs 1] [--only RULE ...]

Diagnoses each log of DATA once as it is and once without each rule (OUT/RULE/00042), scores them by `evaluate_cad.py`
and writes OUT/ABLATION.md: which rates move. This file reads no truth.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import argparse
import contextlib
import dataclasses
import json
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from unittest import mock

import numpy as np
from report_torque import written

EVERYTHING = "as it is"


def rules() -> dict[str, Callable[[], contextlib.ExitStack]]:
    """By name, a context in which one rule is off; imported late, so that each process reads JAX's settings first."""
    from jax_inertia.diagnosis import pipeline
    from jax_inertia.diagnosis.effects import registry
    from jax_inertia.diagnosis.search import discrepancy, ordinary, stepwise

    def patched(*changes: tuple[object, str, object]) -> Callable[[], contextlib.ExitStack]:
        def enter() -> contextlib.ExitStack:
            stack = contextlib.ExitStack()
            for where, name, value in changes:
                stack.enter_context(mock.patch.object(where, name, value))
            return stack

        return enter

    def exact(h: object) -> float:
        return 0.0

    from jax_inertia.diagnosis.hypothesis import Hypothesis

    def named(log):
        return tuple(e for e in registry.effects_of(log) if e.named)

    return {
        EVERYTHING: patched(),
        "no mild forms of friction": patched((ordinary, "_forms", lambda *a: [])),
        "tolerances as stated, not learned": patched(
            (ordinary, "_rescaled", lambda now: now.chosen)
        ),
        "one presliding for all": patched(
            (
                ordinary,
                "_turning",
                lambda residual, evidence, now, dry, place, settings: ordinary.make(
                    residual, dry, place, (4e-4,), settings
                ),
            )
        ),
        "ordinary physics not looked at again": patched(
            (stepwise, "reconsidered", lambda residual, evidence, now, tried, settings: now)
        ),
        "equations taken for exact": patched((Hypothesis, "form_error", property(exact))),
        "rows independent": patched(
            (discrepancy.SlowNoise, "likeliest", lambda self, values: self)
        ),
        "no exchange": patched((stepwise, "_exchanged", lambda *a: None)),
        "grid not refined": patched(
            (stepwise, "_refined", lambda residual, evidence, now, every: now)
        ),
        "no generic alternatives": patched((pipeline, "effects_of", named)),
        "no gate on the other run": patched(
            (pipeline, "gated", lambda selection, judge, settings: (selection, ()))
        ),
        "parts of the log not asked": patched(
            (pipeline, "borne_out", lambda selection, judges: selection)
        ),
    }


def settings_of() -> dict[str, dict[str, float]]:
    """Settings that a row changes."""
    return {
        "rest weighs as motion does": {"rest_speed": 0.0},
        "odd effects cost 4 nats": {"odd_odds": 4.0, "generic_odds": 6.0},
        "odd effects cost 16 nats": {"odd_odds": 16.0, "generic_odds": 18.0},
        "doubtful effects are listed": {"likely": 0.0},
        "tolerances of 3 %, 2 mm, 10 %": {
            "mass_tolerance": 0.03,
            "com_tolerance": 0.002,
            "inertia_tolerance": 0.1,
        },
    }


def diagnosed(job: tuple[Path, Path, tuple[str, ...]]) -> str:
    """One log by every rule that is asked for."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from jax_inertia import load_model, read_log
    from jax_inertia.diagnosis.pipeline import diagnose
    from jax_inertia.diagnosis.report.json_report import to_report
    from jax_inertia.diagnosis.settings import Settings
    from jax_inertia.model.load import load_spec

    folder, out, wanted = job
    robot = load_model(folder / "nominal.xml").astype("float64")
    log = read_log(folder / "log.npz")
    off, changed = rules(), settings_of()
    for name in wanted:
        place = out / name / folder.name
        if (place / "report.json").exists():
            continue
        place.mkdir(parents=True, exist_ok=True)
        settings = dataclasses.replace(Settings(), **changed.get(name, {}))
        with off.get(name, contextlib.ExitStack)():
            nominal = load_spec(folder / "nominal.xml")
            found = diagnose(robot, log, nominal=nominal, settings=settings)
        assert found.corrected is not None
        written(to_report(found), found.corrected.spec.to_xml(), place)
    return folder.name


MEASURES = (
    ("held-out rows, after / before, as stated", lambda rows: _median(rows, _stated)),
    ("other motion, from the report, over least squares'", lambda rows: _median(rows, _against)),
    ("ordinary terms within 10 %", lambda rows: _share(_terms(rows, "close", "determined"))),
    ("intervals cover", lambda rows: _share(_terms(rows, "covers"))),
    ("odd effects listed that are there", lambda rows: _share(t for r in rows for t in r["there"])),
    ("odd effect found", lambda rows: _share(r["found"] for r in _seen(rows))),
    ("… first", lambda rows: _share(r["first"] for r in _seen(rows))),
    (
        "inventions on ordinary robots",
        lambda rows: _share(bool(r["invented"]) for r in rows if not r["odd"]),
    ),
    ("outside the library: said", lambda rows: _share(r["flagged"] for r in rows if r["outside"])),
)


def _seen(rows: list[dict]) -> list[dict]:
    return [r for r in rows if r["odd"] and not r["outside"] and r["sigmas"] >= 3.0]


def _terms(rows: list[dict], name: str, only: str = "") -> Iterator[bool]:
    return (
        t[name] for r in rows for t in r["terms"] if t[name] is not None and (not only or t[only])
    )


def _stated(row: dict) -> float | None:
    told = row["stated"]
    return told["after"] / told["before"] if told["before"] else None


def _against(row: dict) -> float | None:
    own = row["errors"].get("tool")
    return own["rms"] / row["errors"]["least_squares"]["rms"] if own else None


def _median(rows: list[dict], of: Callable[[dict], float | None]) -> str:
    values = [x for x in map(of, rows) if x is not None]
    return f"{np.median(values):.3f}" if values else "–"


def _share(hits) -> str:
    hits = [bool(x) for x in hits]
    return f"{sum(hits)}/{len(hits)}" if hits else "–"


def table(results: dict[str, list[dict]]) -> str:
    """Markdown, a row for each rule."""
    lines = ["| off | " + " | ".join(name for name, _ in MEASURES) + " |"]
    lines.append("|---" * (len(MEASURES) + 1) + "|")
    for name, rows in results.items():
        told = [r for r in rows if not r.get("missing")]
        lines.append(f"| {name} | " + " | ".join(of(told) for _, of in MEASURES) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", nargs="+")
    args = parser.parse_args()
    wanted = tuple(args.only or (*rules(), *settings_of()))
    folders = sorted(p.parent for p in args.data.glob("[0-9]*/truth.json"))
    jobs = [(folder, args.out, wanted) for folder in folders]
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
        for done, name in enumerate(pool.map(diagnosed, jobs), start=1):
            print(f"\r{done} of {len(jobs)}: {name}", end="", flush=True)
    from evaluate_cad import score

    results = {}
    for name in wanted:
        every = [(str(args.data), str(args.out / name), folder.name) for folder in folders]
        with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
            results[name] = list(pool.map(score, every))
    (args.out / "ablation.json").write_text(json.dumps(results))
    text = table(results)
    (args.out / "ABLATION.md").write_text(text)
    print("\n" + text)


if __name__ == "__main__":
    main()
