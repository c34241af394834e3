"""Marks of a log with torques: errors on the other motion, and the numbers of every joint.

An odd effect counts as found where a listed effect, or one stated equivalent to it, is the true one or one that the
truth states equivalent. It is asked for where it changes the log's torque by three sigma of what else is uncertain
(`worlds/truth.py`).
"""

from __future__ import annotations

import copy
import json
import os
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.exam import least_squares
from benchmarks.exam.report_torque import NAMES, ReportTorque
from benchmarks.exam.torque_error import needed, read, torque_error

SEEN = 3.0  # sigma of what else is uncertain
# A joint whose friction is odd has no ordinary friction to be compared with.
FRICTION = ("stribeck_friction", "load_friction", "asymmetric_coulomb", "unknown")


def key(effect: dict) -> tuple[str, str]:
    """Family and place."""
    return effect["family"], effect["location"]["name"]


def keys_of(effect: dict) -> set[tuple[str, str]]:
    return {key(effect), *map(key, effect.get("equivalent", []))}


def errors(folder: Path, truth: dict) -> dict:
    """The measure [N m] on the other motion: nominal, least squares, the truth as a report; kept beside the log."""
    kept = folder / "errors.json"
    if kept.exists():
        return json.loads(kept.read_text())
    model = mujoco.MjModel.from_xml_path(str(folder / "nominal.xml"))
    log, test = read(folder / "log.npz"), read(folder / "test.npz")
    nominal = torque_error(model, needed, test)
    fitted = torque_error(model, least_squares.fit(model, log), test)
    told, left_out = oracle(folder, truth, test)
    out = {"nominal": nominal, "least_squares": fitted, "oracle": told, "oracle_without": left_out}
    part = kept.with_suffix(f".{os.getpid()}")
    part.write_text(json.dumps(out))
    part.replace(kept)
    return out


def oracle(folder: Path, truth: dict, test: dict) -> tuple[dict, list[str]]:
    """The least that such forms leave: real bodies, nearest ordinary terms with real bristles, and the odd effect."""
    real = folder / f".real.{os.getpid()}.xml"
    real.write_text(real_xml((folder / "nominal.xml").read_text(), truth["inertials"]))
    joints = copy.deepcopy(truth["joints"])
    for name, terms in joints.items():
        terms["coulomb_friction"]["presliding"] = truth["law"]["presliding"][name]
    odd = truth["odd"]
    known = odd and odd["family"] != "unknown"
    report = {"effects": [odd] if known else [], "joints": joints}
    told = ReportTorque(real, report)
    real.unlink()
    error = told.error(test)
    outside = ["outside the library"] if odd and not known else []
    return error, sorted(told.left_out) + outside


def real_xml(nominal: str, inertials: dict) -> str:
    """The nominal MJCF with the real bodies."""
    spec = mujoco.MjSpec.from_string(nominal)
    for name, error in inertials.items():
        body = spec.body(name)
        body.fullinertia = np.array(body.fullinertia) * (1 + error["mass"]) * (1 + error["inertia"])
        body.mass *= 1 + error["mass"]
        body.ipos = np.array(body.ipos) + error["com"]
    spec.compile()
    return spec.to_xml()


def own_error(place: Path, folder: Path, report: dict) -> dict | None:
    """The measure of the report, computed again; None where a family cannot be."""
    told = ReportTorque(folder / "nominal.xml", report, place / "corrected.xml")
    error = told.error(read(folder / "test.npz"))
    return error if not told.left_out else None


def terms(truth: dict, report: dict) -> list[dict]:
    """Every ordinary term of every joint: the true value, what is reported, and whether its interval covers."""
    out, odd = [], truth["odd"]
    for joint, own in truth["joints"].items():
        odd_here = bool(odd) and odd["family"] in FRICTION and odd["location"]["name"] == joint
        for family, t in own.items():
            if odd_here and family in ("viscous_friction", "coulomb_friction"):
                continue
            told = report.get("joints", {}).get(joint, {}).get(family)
            told = told or _as_effect(report, joint, family)
            ci = told.get("ci95") if told else None
            out.append(
                {
                    "joint": joint,
                    "family": family,
                    "covers": None if not ci else ci[0] <= t["value"] <= ci[1],
                }
            )
    return out


def _as_effect(report: dict, joint: str, family: str) -> dict | None:
    for e in report["effects"]:
        if key(e) == (family, joint):
            for name in NAMES[family]:
                if name in e["parameters"]:
                    return e["parameters"][name]
    return None
