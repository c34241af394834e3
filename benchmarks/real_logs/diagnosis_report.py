"""DIAGNOSES.md: every number comes from the runs, and so does every judgement."""

import math
from collections.abc import Mapping

from diagnosis_cases import CASES, Case
from diagnosis_summary import Row, Summary
from report import table

_HEAD = """# Diagnoses of real robots

`python benchmarks/real_logs/diagnose.py` writes this page and its figures; reports for people (report.html) go to its
`--out`. Each case is what `jax-inertia diagnose` makes of one log, a nominal model and another run of the same robot;
the published figures are used on this page only. What a robot or a recording cannot have was written down beforehand
for each case (`diagnosis_cases.py`): a finding of that kind is called **not physical** here, however well it fits.

Residuals are root mean squares over all joints in motion, in N m, after the tool's 10 Hz low-pass: *held out* predicts
each fifth of the log from the others, *other run* is a recording that played no part. *Published* is the robot's
published fit on the same bodies and the same rows, evaluated by us."""


def render(done: Mapping[str, Summary], machine: str) -> str:
    """The whole page."""
    cases = [c for c in CASES if c.name in done]
    parts = [
        _HEAD,
        table(
            ["robot", "verdict", "effects", "not physical", "held out", "published", "other run",
             "published there", "0.25 s rollouts [deg]", "s"],
            [_overview(done[c.name]) for c in cases],
        ),
        *(_section(c, done) for c in cases),
        *(f"`{c.name}` was not run." for c in CASES if c.name not in done),
        f"Times include compiling; {machine}, shared with other work at the time.",
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


def line(s: Summary) -> str:
    """One case in a line, for the terminal."""
    held = s.shrink["heldout"]
    doubts = sum(bool(e["doubt"]) for e in s.effects)
    return (
        f"  {s.verdict}: {len(s.effects)} effects, {doubts} not physical; held out "
        f"{held['before']:.3g} → {held['after']:.3g} N m; {s.seconds:.0f} s"
    )


def _overview(s: Summary) -> list[str]:
    held, test, roll = (s.shrink[k] for k in ("heldout", "test_log", "rollout"))
    return [
        s.name,
        s.verdict,
        str(len(s.effects)),
        str(sum(bool(e["doubt"]) for e in s.effects)),
        _arrow(held),
        _number(s.published.get("log")),
        _arrow(test),
        _number(s.published.get("test")),
        "–"
        if roll is None
        else " → ".join(f"{math.degrees(roll[k]):.2g}" for k in ("before", "after")),
        f"{s.seconds:.0f}",
    ]


def _arrow(shrink: dict | None) -> str:
    if shrink is None:
        return "–"
    worse = " **worse**" if shrink["after"] > shrink["before"] else ""
    return f"{shrink['before']:.3g} → {shrink['after']:.3g}{worse}"


def _number(x: float | None) -> str:
    return "–" if x is None or not math.isfinite(x) else f"{x:.3g}"


def _section(case: Case, done: Mapping[str, Summary]) -> str:
    s = done[case.name]
    parts = [
        f"## {case.title}",
        f"**Known from elsewhere.** {case.known}",
        f"**Diagnosis** ({s.duration:.0f} s of log): {s.verdict}, confidence {s.confidence:.2f}; whitened energy "
        f"{s.chi2:.3g} a sample against {s.floor:.2g} of noise.",
    ]
    if s.gains:
        parts.append("Drive gains as the tool took them: " + " / ".join(map(_gains, s.gains)) + ".")
    if s.effects:
        parts.append(_effects(s))
    if case.terms is not None:
        parts.append(_terms(case, s))
    parts.append("**Against what is known.** " + " ".join(_judgement(case, s, done)))
    parts.append(f"![{case.title}](diagnosis_{s.name}.png)")
    return "\n\n".join(parts)


def _gains(message: str) -> str:
    """The numbers of the tool's remark: 'elbow 9.5, wrist 10 N m per unit'."""
    return message.split("the model, ")[-1].split(" N m per unit")[0] + " N m per unit"


def _effects(s: Summary) -> str:
    rows = []
    for e in s.effects:
        sizes = ", ".join(
            f"{name} {_number(p['value'])} [{_number(p['ci95'][0])}, {_number(p['ci95'][1])}] {p['unit']}"
            for name, p in e["parameters"].items()
        )
        ties = sorted({f"{t['family']} at {t['location']['name']}" for t in e["equivalent"]})
        more = f" and {len(ties) - 2} more" if len(ties) > 2 else ""
        doubt = f"**not physical**: {e['doubt']}" if e["doubt"] else ""
        if e["weak"]:
            doubt = "; ".join(filter(None, (doubt, "not distinct from zero")))
        rows.append(
            [
                e["family"],
                e["location"]["name"],
                sizes,
                f"{100 * e['explained_heldout']:.0f} %",
                ", ".join(ties[:2]) + more,
                doubt,
            ]
        )
    return table(["effect", "where", "size, 95 % interval", "explains", "or", "remark"], rows)


_UNITS = {"coulomb": "N m", "viscous": "N m s/rad", "offset": "N m", "armature": "kg m²"}


def _terms(case: Case, s: Summary) -> str:
    """Joint terms, found (published)."""
    names = [n for n in _UNITS if any(n in r.found or r.theirs.get(n) for r in s.rows)]
    rows = [
        [r.joint, *(_pair(r, n) for n in names), _friction(r), f"{r.before:.3g} → {r.after:.3g}", _number(r.published)]
        for r in s.rows
    ]  # fmt: skip
    head = ["joint", *(f"{n} [{_UNITS[n]}]" for n in names), "friction at median speed [N m]"]
    text = table([*head, "held out [N m]", "published [N m]"], rows)
    return f"{text}\n\nFound (published); a dash where nothing was found or nothing is published."


def _pair(r: Row, name: str) -> str:
    return f"{_number(r.found.get(name))} ({_number(r.theirs.get(name))})"


def friction(terms: Mapping[str, float], speed: float) -> float | None:
    """Dry and viscous friction at a speed [N m]; None where neither is known."""
    if not {"coulomb", "viscous"} & set(terms):
        return None
    return terms.get("coulomb", 0.0) + terms.get("viscous", 0.0) * speed


def _friction(r: Row) -> str:
    return f"{_number(friction(r.found, r.speed))} ({_number(friction(r.theirs, r.speed))})"


def _judgement(case: Case, s: Summary, done: Mapping[str, Summary]) -> list[str]:
    """Sentences, each from the numbers."""
    out = []
    if case.terms is not None:
        out += _frictions(s) + _offsets(s) + _rotors(case, s)
    if case.mass is not None:
        out.append(_mass(case.mass, s))
    for family in case.wanted:
        places = [e["location"]["name"] for e in s.effects if e["family"] == family]
        out.append(
            f"{family} was {'found at ' + ', '.join(places) if places else '**not found**'}."
        )
    if case.repeats in done:
        out.append(_repeat(s, done[case.repeats]))
    if any(e["doubt"] for e in s.effects):
        names = ", ".join(
            f"{e['family']} at {e['location']['name']}" for e in s.effects if e["doubt"]
        )
        out.append(f"The fit uses effects that are **not physical** here: {names}.")
    for which, text in (("heldout", "on its own log, held out"), ("test_log", "on the other run")):
        shrink = s.shrink[which]
        if s.effects and shrink and shrink["after"] > shrink["before"]:
            out.append(f"**The corrected model is worse than the nominal one {text}.**")
    return out or ["Nothing to compare."]


def _frictions(s: Summary) -> list[str]:
    both = [(r, friction(r.found, r.speed), friction(r.theirs, r.speed)) for r in s.rows]
    known = [(r, a, b) for r, a, b in both if b is not None and "coulomb" in r.theirs]
    found = [(r, a, b) for r, a, b in known if a is not None]
    near = [r for r, a, b in found if abs(a - b) < 0.3 * abs(b)]
    missing = [r.joint for r, a, _ in known if a is None]
    text = (
        f"Friction was found at {len(found)} of the {len(known)} joints with a published one, "
        f"within 30 % of it at {len(near)}"
    )
    return [text + (f"; not at {', '.join(missing)}." if missing else ".")]


def _offsets(s: Summary) -> list[str]:
    known = [r for r in s.rows if abs(r.theirs.get("offset", 0.0)) > 0.05]
    if not known:
        return []
    near = [r for r in known if abs(r.found.get("offset", 0.0) - r.theirs["offset"]) < 0.1]
    seen = [r for r in known if "offset" in r.found]
    return [
        f"Offsets: {len(seen)} of {len(known)} published ones were found, {len(near)} within 0.1 N m."
    ]


def _rotors(case: Case, s: Summary) -> list[str]:
    found = [r for r in s.rows if "armature" in r.found]
    real = [r for r in s.rows if r.theirs.get("armature", 0.0) > 0]
    if not real:
        verdict = (
            "as it must be" if not found else f"wrongly, at {', '.join(r.joint for r in found)}"
        )
        return [f"Armature: found at {len(found)} joints, {verdict}."]
    right = [r for r in found if r in real]
    return [
        f"Armature: published at {len(real)} joints, found at {len(right)} of them"
        + (f" and at {len(found) - len(right)} others." if len(found) > len(right) else ".")
    ]


def _mass(mass: float, s: Summary) -> str:
    loads = [e for e in s.effects if e["family"] == "payload"]
    if not loads:
        return "No payload was found" + (", as it must be." if mass == 0 else ": **missed**.")
    p, where = loads[0]["parameters"]["mass"], loads[0]["location"]["name"]
    if mass == 0:
        return f"Payload {p['value']:.3g} kg at {where} where there is none: **false**."
    inside = "inside" if p["ci95"][0] <= mass <= p["ci95"][1] else "outside"
    return (
        f"Payload {p['value']:.3g} kg [{p['ci95'][0]:.3g}, {p['ci95'][1]:.3g}] at {where} against {mass:g} kg "
        f"({100 * (p['value'] / mass - 1):+.0f} %, {inside} the interval)."
    )


def _repeat(s: Summary, first: Summary) -> str:
    """How the joint terms of two runs of one motion compare."""
    pairs = [
        (f"{a.joint} {name}", a.found.get(name), b.found.get(name))
        for a, b in zip(first.rows, s.rows, strict=True)
        for name in ("offset", "coulomb")
        if name in a.found or name in b.found
    ]
    both = [(n, a, b) for n, a, b in pairs if a is not None and b is not None]
    text = ", ".join(f"{n} {a:.3g} / {b:.3g}" for n, a, b in both)
    return f"Found in both runs ({len(both)} of {len(pairs)} joint terms), first / repeat: {text or 'none'} N m."
