"""The page of all effects, from the registry: `python docs/effects.py` writes docs/effects.md."""

from pathlib import Path

from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.diagnosis.effects.registry import EFFECTS
from jax_inertia.diagnosis.report.next_motion import asked

OUT = Path(__file__).with_name("effects.md")
HEAD = """# Effects

What a robot may have that its model lacks: a torque e on the joints besides the logged one, M q̈ + h − τ = e. Both
searches take effects from one registry, `jax_inertia/diagnosis/effects/registry.py`; how to add one:
[contributing.md](contributing.md#recipe-an-effect). This page is written by `python docs/effects.py`.

*Step law*: what no attribute of a model can say is done before each step, in MuJoCo C and in MJX
(`jax_inertia.diagnosis.simulate.step_law`). Numbers are a hinge's; of a slide read m for rad and N for N m,
and 0.1 m where a prior has a radian: the radius of a pulley or pinion.
"""
KINDS = (
    ("Every joint has these", lambda e: e.ordinary),
    ("Other forms of a joint's friction", lambda e: e.refines),
    ("Odd effects at a joint", lambda e: e.kind == "joint"),
    ("Odd effects at a body", lambda e: e.kind == "body"),
    ("Odd effects elsewhere, or at several joints at once", lambda e: True),
)


def entry(effect: Effect) -> str:
    """A table of one effect."""
    units = ", ".join(f"`{k}`{'' if u == '1' else f' [{u}]'}" for k, u in effect.units.items())
    rows = (
        ("equation", effect.equation),
        ("source", effect.source),
        ("numbers", units),
        ("prior", effect.prior),
        ("equation is exact to", f"{100 * effect.form_error:.0f} %"),
        ("MJCF", effect.mjcf),
        ("shown by", asked(effect.advice, "the joint")),
    )
    # A bar in an equation would end its cell.
    cells = (f"| {name} | {text.replace('|', chr(92) + '|')} |" for name, text in rows)
    return "\n".join([f"### `{effect.name}`", "", "| | |", "|---|---|", *cells, ""])


def text() -> str:
    """The whole page."""
    left = [e for e in EFFECTS if e.named]
    out = [HEAD]
    for title, belongs in KINDS:
        mine = [e for e in left if belongs(e)]
        left = [e for e in left if e not in mine]
        out += [f"## {title}", "", *(entry(e) for e in mine)]
    others = [f"- {e.name}: {e.equation}" for e in EFFECTS if not e.named]
    out += [
        "## Generic alternatives",
        "",
        "Shapes that no named effect has. They compete for the residual and are never named as a cause.",
        "",
        *others,
    ]
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    OUT.write_text(text())
