"""Files for simulators in which policies are trained: what each of them can hold of a diagnosis, and what it cannot."""

import io
import re
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from jaxtyping import Float

from jax_inertia.replay.fitting.draws import JOINT, Draws
from jax_inertia.replay.result import Diagnosis
from jax_inertia.text.closest_names import listed

_RANGE = (5.0, 95.0)
"""Percentiles of draws that a range spans: a decision."""


def draws_file(names: Sequence[str], draws: Draws) -> bytes:
    """draws.npz: each of `JOINT` (D, n) by `joint_names` (n), each of `BODY` (D, b, ...) by `body_names` (b)."""
    out, named = io.BytesIO(), {"joint_names": names, "body_names": draws.bodies}
    arrays = {name: np.array(x, dtype=str) for name, x in named.items()}
    np.savez_compressed(out, allow_pickle=False, **arrays, **draws.joints, **draws.inertials)
    return out.getvalue()


def export(name: str, found: Diagnosis, draws: Draws, log: str, model: str) -> str:
    """The Python file of one of `EXPORTS`; `log` and `model`: their names."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("jax_inertia.trainers"),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    values = EXPORTS[name](found, draws)
    about = {
        "log": _word(log),
        "model": _word(model),
        "timestep": draws.step,
        "version": version("jax-inertia"),
    }
    return environment.get_template(f"{name}.py.jinja").render(**values, **about)


def _word(name: str) -> str:
    """A file's name within a docstring."""
    return "".join(c if c.isprintable() and c not in '"\\' else "_" for c in name)


def _isaaclab(found: Diagnosis, draws: Draws) -> dict[str, Any]:
    names = [f"^{re.escape(n)}$" for n in found.names]
    middle = {name: np.median(draws.joints[name], axis=0) for name in JOINT}

    def of(field: str) -> str:
        values = middle[field]
        parts = (f"{n!r}: {x:.6g}" for n, x in zip(names, values, strict=True) if np.isfinite(x))
        return "{" + ", ".join(parts) + "}"

    late = draws.joints["delay"] + draws.joints["lag"]
    joints = [
        {
            "expression": repr(n),
            "kp": _range(draws.joints["kp"][:, j]),
            "kd": _range(draws.joints["kd"][:, j]),
            "friction": _range(draws.joints["frictionloss"][:, j]),
            "armature": _range(draws.joints["armature"][:, j]),
        }
        for j, n in enumerate(names)
    ]
    bodies = [
        {"expression": repr(f"^{re.escape(b)}$"), "mass": _range(draws.inertials["mass"][:, k])}
        for k, b in enumerate(draws.bodies)
    ]
    limit = of("effort_limit")
    return {
        "expressions": names,
        "kp": of("kp"),
        "kd": of("kd"),
        "armature": of("armature"),
        "friction": of("frictionloss"),
        "damping": of("damping"),
        "effort_limit": limit if limit != "{}" else None,
        "delay": [float(f"{x:.4g}") for x in np.percentile(late, _RANGE)],
        "joints": joints,
        "bodies": bodies,
        "lost": _lost(found, ("delay of each joint apart",)),
    }


def _playground(found: Diagnosis, draws: Draws) -> dict[str, Any]:
    return {"lost": _lost(found, ())}


EXPORTS: Mapping[str, Callable[[Diagnosis, Draws], dict[str, Any]]] = {
    "isaaclab": _isaaclab,
    "playground": _playground,
}
"""What each file's template is filled with, by the simulator's name."""


def _range(values: Float[np.ndarray, " D"]) -> tuple[float, float]:
    low, high = (float(f"{x:.6g}") for x in np.percentile(values, _RANGE))
    return low, high


def _lost(found: Diagnosis, more: Sequence[str]) -> list[str]:
    """What neither simulator holds of the corrected robot, as lines of a docstring."""
    x = found.numbers
    there = {
        "friction that varies with load, speed or position (its mean is here)": x.varies_at,
        "quadratic damping": x.drag > 0,
        "a low-pass of targets": x.low_pass > 0,
        "play": x.play > 0,
        "a spring across two joints, unless the model is corrected.xml": x.across > 0,
        "the integral of a drive (MuJoCo C has it in corrected.xml, MJX has no such actuator; numbers: draws.npz)": (
            x.integral > 0
        ),
        "a dead band, unless the model is corrected.xml": x.dead > 0,
        "an encoder's offset (draws.npz has it)": x.offset != 0,
    }
    out = [
        f"{what} at {listed([n for n, at in zip(found.names, where, strict=True) if at])}"
        for what, where in there.items()
        if np.any(where)
    ]
    lines = [*out, *more]
    return ["", "Not in this file: " + "; ".join(lines) + "."] if lines else []


def written(folder: Path, found: Diagnosis, exports: Sequence[str], log: str, model: str) -> str:
    """Write draws.npz, and the file of each of `exports`, into a folder; why there are none, else nothing."""
    if found.draws is None:
        nothing = "no number of the model was changed, so there is nothing to export; train with the model as it is"
        return f"--export {' '.join(exports)}: {nothing}" if exports else ""
    (folder / "draws.npz").write_bytes(draws_file(found.names, found.draws))
    for name in exports:
        text = export(name, found, found.draws, log, model)
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    return ""
