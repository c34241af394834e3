"""Development data for the sim-to-real diagnosis: logs of simulated robots with hidden effects.

    python benchmarks/gap/generate.py OUT --n 100 --seed 1 --stratum exciting --jobs 2

writes OUT/logs/00042/{log.npz, test.npz, nominal.xml} and OUT/truth/00042.json. Log 42 depends on
the seed, the stratum and 42 alone. A second call skips what is complete. Shares no code with the
package.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import time
from pathlib import Path

import numpy as np
from check import visibility
from draw import Draw, equivalents, reference_peaks
from effects import Effect
from many import parser, write_all, write_folder
from plant import Unstable
from spec import Spec, draw_noise, draw_spec, simulate, slightly_wrong, to_contract
from strata import STRATA, Stratum

ATTEMPTS = 12


def cut(log: dict, rows: int) -> dict:
    return {k: v[:rows] if k not in ("noise", "contact_bodies") else v for k, v in log.items()}


def make(stratum: Stratum, seed: int, index: int):
    """Draws effects until each is visible and the loop is stable; returns spec, logs and truth."""
    spec = draw_spec(stratum, seed, index)
    rows = round(spec.duration * spec.rate)
    if spec.robot.floating:
        still = simulate(spec, [], 0, min(3.0, spec.duration))
        peak = np.percentile(np.abs(still["tau"]), 99.5, axis=0)
        busy = np.percentile(np.abs(still["tau"]), 90, axis=0)
        span = np.array([still["qpos"].min(0), still["qpos"].max(0)])
    else:
        seed_of_motion = [*spec.seed, 3, 0]
        peak, busy, span = reference_peaks(spec.robot, spec.kinds[0], seed_of_motion, spec.duration)
    spec.noise = draw_noise(spec, peak)
    reason = "never tried"
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([*spec.seed, 6, attempt])
        families = draw_families(stratum, index, seed, rng)
        draw = Draw(spec.robot, rng, peak, busy, span, stratum.small, stratum.slip)
        effects = [draw.make(family) for family in families]
        if clash(effects):
            continue
        if attempt >= ATTEMPTS // 2:
            spec.bandwidth = 8.0
        true_model = slightly_wrong(spec)
        try:
            seen = []
            for effect in effects if len(effects) > 1 else []:
                alone = cut(simulate(spec, [effect], 0, spec.duration), rows)
                seen.append(visibility(spec.robot, true_model, alone, spec.noise))
                if not fair(stratum, seen[-1]):
                    break
            if seen and not (fair(stratum, seen[-1]) and comparable(seen)):
                reason = "one of the pair too small"
                continue
            log = simulate(spec, effects, 0, spec.duration)
            whole = visibility(spec.robot, true_model, cut(log, rows), spec.noise)
            if effects and not fair(stratum, whole):
                reason = f"too small (chi2 {whole['chi2']:.0f}, distinct {whole['distinct']:.0f})"
                continue
            test = simulate(spec, effects, 1, spec.test_duration)
        except Unstable as error:
            reason = str(error)
            continue
        raw = visibility(spec.robot, spec.robot.model(), cut(log, rows), spec.noise)
        truth = describe(spec, effects, seen or [whole], raw, peak, attempt)
        for effect, entry in zip(effects, truth["effects"], strict=True):
            if effect.kind == "joint":
                tau = log["tau"][:rows, effect.joint]
                entry["torque_reversals"] = reversals(tau, float(peak[effect.joint]))
        logs = to_contract(spec, log, spec.duration), to_contract(spec, test, spec.test_duration)
        return spec, logs, truth
    raise RuntimeError(f"log {index}: no fair draw in {ATTEMPTS} attempts ({reason})")


def fair(stratum: Stratum, view: dict) -> bool:
    """Whether an effect can be seen at all: above the noise and above the nominal model's error.

    The error is allowed for where the model is exact, too: a diagnosis cannot know that.
    """
    return view["chi2"] >= stratum.chi2 and view["distinct"] >= stratum.distinct


def comparable(seen: list[dict]) -> bool:
    """Neither of two effects is more than ten times the other, in units of the noise."""
    sizes = [view["chi2"] for view in seen]
    return max(sizes) <= 100.0 * min(sizes)


def reversals(tau: np.ndarray, peak: float) -> int:
    """How often a torque changes sign, by more than 2 % of its peak."""
    signs = np.sign(tau[np.abs(tau) > 0.02 * peak])
    return int(np.count_nonzero(np.diff(signs)))


def draw_families(stratum: Stratum, index: int, seed: int, rng) -> list[str]:
    """The first family goes round the list, so that every family comes; the second is free."""
    if stratum.count == 0:
        return []
    order = np.random.default_rng([seed, stratum.number]).permutation(stratum.families)
    chosen = [str(order[index % len(order)])]
    while len(chosen) < stratum.count:
        other = str(rng.choice(stratum.families))
        if other not in chosen:
            chosen.append(other)
    return chosen


def clash(effects: list[Effect]) -> bool:
    """Pairs at one place, or that are one effect in disguise, are no fair question."""
    places = [e.name for e in effects]
    alike = [{"time_delay", "actuator_lag"}, {"joint_elasticity", "backlash"}]
    families = {e.family for e in effects}
    return len(set(places)) < len(places) or any(a <= families for a in alike)


def describe(spec: Spec, effects, seen, raw, peak, attempt: int) -> dict:
    robot = spec.robot
    entries = []
    for effect, view in zip(effects, seen, strict=False):
        entries.append(effect.truth() | {"equivalent": equivalents(robot, effect)})
        entries[-1]["visibility"] = view
    return {
        "schema": 1,
        "verdict": expected_verdict(effects),
        "effects": entries,
        "robot": robot.name,
        "motion": {"log": spec.kinds[0], "test": spec.kinds[1]},
        "rate_hz": spec.rate,
        "duration_s": spec.duration,
        "bandwidth_rad_s": spec.bandwidth,
        "nominal_slightly_wrong": spec.wrong,
        "known_friction": "constraint" if spec.presliding is None else "bristle",
        "noise_factor": 4 if spec.loud else 1,
        "noise": {k: np.asarray(v).tolist() for k, v in vars(spec.noise).items()},
        "options": spec.options,
        "peak_torque": dict(zip(robot.joints, map(float, peak), strict=True)),
        "raw_gap": raw,
        "seed": spec.seed,
        "attempt": attempt,
    }


def expected_verdict(effects: list[Effect]) -> str:
    if not effects:
        return "no_gap"
    return "unknown" if any(e.family == "unknown" for e in effects) else "explained"


def write(out: Path, stratum: str, seed: int, index: int) -> str:
    """One log on disk, whole or not at all: the truth file, written last, marks it complete."""
    begun = time.time()
    truth_file = out / "truth" / f"{index:05d}.json"
    folder = out / "logs" / f"{index:05d}"
    if truth_file.exists() and folder.exists():
        return "there already"
    spec, (log, test), truth = make(STRATA[stratum], seed, index)
    write_folder(folder, log, test, {"nominal.xml": spec.robot.xml})
    truth_part = truth_file.with_suffix(f".{os.getpid()}.part")
    truth_part.write_text(json.dumps(truth, indent=1))
    truth_part.rename(truth_file)
    names = " + ".join(
        f"{e.get('mechanism', e['family'])}@{e['location']['name']}" for e in truth["effects"]
    )
    return f"{spec.robot.name} {names or 'none'} ({time.time() - begun:.1f} s)"


def main() -> None:
    arguments = parser(__doc__, 20)
    arguments.add_argument("--stratum", choices=sorted(STRATA), default="mixed")
    args = arguments.parse_args()
    (args.out / "truth").mkdir(parents=True, exist_ok=True)
    write_all(args, write, args.out, args.stratum)


if __name__ == "__main__":
    main()
