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

What only the loop of a position-controlled robot may have (a dead band, a low-pass of targets, the integral of a drive)
replays alone look for: [position_controlled.md](position_controlled.md#what-is-done).

*Step law*: what no attribute of a model can say is done before each step, in MuJoCo C and in MJX
(`jax_inertia.diagnosis.simulate.step_law`). Numbers are a hinge's; of a slide read m for rad and N for N m,
and 0.1 m where a prior has a radian: the radius of a pulley or pinion.

## How to compute a report again

What a diagnosis hands over is report.json and corrected.xml. Along a log, the torque error of the two is

    e = needed / g − τ(t − d, ±L)

`needed` is MuJoCo's inverse dynamics of corrected.xml (constraints off, damping of joints and tendons set to zero, so
that friction is counted once), plus the friction law of every joint, less forces on bodies. τ is the logged torque
after `time_delay`, `actuator_lag` and limits, g the joint's `torque_gain`. Effects with `"handed_over": false` are
named and not in the files: leave them out; `push` belongs to the log that was diagnosed. How far a soft joint bends is
computed from the motion, never from the torque that is to be predicted. Errors in reports count the rows in which a
joint moves faster than 0.02 rad/s, below 10 Hz. `benchmarks/exam/report_torque.py` is such a program; it
shares no code with the package.

The friction law of a joint is `friction.<joint>` of report.json. It is the joint's whole friction: it replaces damping
and frictionloss of corrected.xml, and every effect of a friction family at that joint. Its terms add up to

    τ = −[Σ bristle zᵢ + z (Σ slow exp(−|q̇/speed|^exponent) + load |τ_load|) + by_direction |z| + constant
          + viscous q̇ + quadratic |q̇| q̇ + slope_by_direction |q̇| / 2 + drift exp(−t/time_constant) q̇]

| form | numbers | |
|---|---|---|
| `bristle` | `displacement` [rad], `straight` | z below, over this displacement |
| `creep` | `speed` [rad/s] | z = clip((q̇ + q̈ / 105.3 s⁻¹) / speed, ±1): MuJoCo's friction loss |
| `slow` | `speed` [rad/s], `exponent` | what is there at low speed alone (Stribeck) |
| `load` | `of_motor` | of the link's torque; of the motor's where `of_motor` is 1 |
| `constant` | | takes back what of `torque_bias` stands in corrected.xml for the law's other terms |

zᵢ follows dz/dq = (1 − z sign q̇) / displacement (Dahl 1968), or 1/displacement until ±1 where `straight` is 1, and is
sign(q̇) where the displacement is 0; z without an index is that of the first term. A motor's torque τ has its own load
friction in it: τ (1 − load z sign τ) is what it needs else.

`joints` of report.json holds what MuJoCo's attributes come nearest to it with: damping, frictionloss, armature and a
constant torque, and `quadratic_in_model` the second coefficient of damping. Without the law they are a model of their
own, a little worse.
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
