"""report.html: one file that an engineer reads in a minute. Nothing in it is fetched, nothing in it runs."""

import dataclasses

import numpy as np

from jax_inertia.diagnosis.report.detectable_sizes import by_family
from jax_inertia.diagnosis.report.drawing import fan
from jax_inertia.diagnosis.simulate.corrected import Correction
from jax_inertia.diagnosis.simulate.rollout import Rollouts
from jax_inertia.gap import figures
from jax_inertia.gap.energies import Shrink
from jax_inertia.gap.finding import Diagnosis
from jax_inertia.gap.verdict import Verdict
from jax_inertia.logs.log import Log
from jax_inertia.text.report_page import rendered
from jax_inertia.text.words import chance, number, percent, plain


@dataclasses.dataclass(frozen=True)
class Page:
    """What the report is about."""

    log_name: str
    model_name: str
    log: Log
    found: Diagnosis
    correction: Correction
    rollouts: Rollouts | None
    report: dict


def page(about: Page) -> str:
    """The report as HTML; every name in it is escaped."""
    filters = {"plain": plain, "number": number, "percent": percent, "chance": chance}
    found, rolled = about.found, about.rollouts
    row = figures.affected(found)
    return rendered(
        "jax_inertia.gap",
        filters,
        about=about,
        found=found,
        report=about.report,
        headline=found.headline,
        cards=_cards(about),
        row=found.trace.rows[row],
        holding=_holding(found),
        trusted=found.verdict is not Verdict.UNKNOWN,
        heat=figures.heat(found),
        residual=figures.residual(found, row),
        waterfall=figures.waterfall(found),
        fan=None if rolled is None else fan(rolled),
        undetectable=by_family(found.undetectable_below),
        shares=sorted(found.share.items(), key=lambda x: -x[1])[:6],
        when=_when(found),
        units=dict(zip(found.trace.rows, found.trace.units, strict=True)),
        notes=[
            n
            for n in found.notes
            if not any(n in q["message"] for q in about.report["data_quality"])
        ],
    )


@dataclasses.dataclass(frozen=True)
class _Card:
    """One figure at the top of the page."""

    title: str
    value: str
    detail: str


def _cards(about: Page) -> list[_Card]:
    found, rolled = about.found, about.rollouts
    out = [
        _Card(
            "gap",
            f"{number(np.sqrt(max(found.chi2, 0.0)))} × noise",
            "missing torque against the sensors' noise; masses within their tolerances alone may leave a few times it",
        )
    ]
    for title, s in (("held-out residual", found.heldout), ("another motion", found.test)):
        if s is not None and found.findings:
            out.append(_Card(title, _shrunk(s), _detail(s, found.unit)))
        elif s is not None:
            detail = f"rms; floor {number(s.noise)} {found.unit}"
            out.append(_Card(title, f"{number(s.before)} {found.unit}", detail))
    if rolled is not None:
        degrees = "°" if all(rolled.rotates) else ""
        before, after, floor = (
            f"{number(rolled.shown * x)}{degrees}"
            for x in (rolled.before, rolled.after, rolled.floor)
        )
        title = f"{rolled.horizon:g} s rollouts{'' if degrees else f', {rolled.unit}'}"
        if found.findings:
            detail = f"before → after; floor {floor}: noise, and the model's own errors"
            out.append(_Card(title, f"{before} → {after}", detail))
        else:
            detail = f"floor {floor}: noise, and the model's own errors"
            out.append(_Card(title, before, detail))
    return out


def _shrunk(s: Shrink) -> str:
    if s.share is None:
        return "at the floor"
    return f"{'−' if s.share >= 0 else '+'}{percent(abs(s.share))}"


def _detail(s: Shrink, unit: str) -> str:
    floor = f"floor {number(s.noise)}: sensors {number(s.sensors)}, the model's own errors {number(s.excused)}"
    below = "" if s.band is None else f" below {number(s.band)} Hz"
    return f"{number(s.before)} → {number(s.after)} {unit}{below}; {floor}"


def _holding(found: Diagnosis) -> str:
    """The rows that the waterfall is about."""
    names = [found.trace.rows[k] for k in figures.holding(found)]
    if len(names) == len(found.trace.rows):
        return "all rows"
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more rows" if len(names) > 5 else "")


def _when(found: Diagnosis) -> str:
    if not found.when:
        return "spread over the whole log"
    spans = [f"{a:.1f}–{b:.1f} s" for a, b in found.when[:4]]
    more = f" and {len(found.when) - 4} more stretches" if len(found.when) > 4 else ""
    return ", ".join(spans) + more
