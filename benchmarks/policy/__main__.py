"""Does a policy do better on the robot if its simulator was corrected first?

    python -m benchmarks.policy OUT record     # the real arm's log, and what `diagnose --export` makes of it
    python -m benchmarks.policy OUT train      # one network for each simulator and seed; minutes on a GPU
    python -m benchmarks.policy OUT judge      # each on the real arm, along motions that no training saw

The simulators: the model as given; the same with plain randomisation (gains, friction and masses by ± 30 %, up to
0.6 kg in the hand, delays up to 30 ms); corrected.xml with the draws of playground.py; and, to see what can be had at
most, a model that was given the real arm's numbers. `train --only NAME` trains one.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import subprocess
import sys
import time
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.policy.arm import (
    FRICTION,
    JOINTS,
    LATE,
    LOAD,
    LOWER,
    MODEL,
    PERIOD,
    WEAK,
    moved,
    tip,
    wanted,
)

NAMES = ("nominal", "randomised", "corrected", "true")
TITLES = ("model as given", "plain randomisation", "corrected by diagnosis", "true numbers")
RESULT = Path(__file__).parents[1] / "results" / "policy.json"
FIGURE = Path(__file__).parents[2] / "docs" / "figures" / "policy.svg"
PAGE = Path(__file__).parents[2] / "docs" / "training.md"
MARKS = (
    "<!-- policy: written by `python -m benchmarks.policy OUT judge` -->",
    "<!-- end of policy -->",
)
_TRIALS = 24


def record(out: Path) -> None:
    """A log of 20 s for the diagnosis, and its files."""
    motion = wanted(np.random.default_rng(1), seconds=20.0, fastest=2.0)
    seen, sent = moved(lambda k, q, v: motion[k], motion, seed=1)
    out.mkdir(parents=True, exist_ok=True)
    (out / "arm.xml").write_text(MODEL)
    at = PERIOD * np.arange(len(seen))
    given = mujoco.MjModel.from_xml_string(MODEL)
    gains = {"kp": given.actuator_gainprm[:, 0], "kd": -given.actuator_biasprm[:, 2]}
    np.savez(
        out / "log.npz", time=at, joint_names=np.array(JOINTS), qpos=seen, qpos_target=sent, **gains
    )
    command = [
        sys.executable,
        "-m",
        "jax_inertia",
        "diagnose",
        str(out / "log.npz"),
        "--model",
        str(out / "arm.xml"),
    ]
    subprocess.run([*command, "--export", "playground", "--out", str(out / "found")], check=True)


def _as_given(model, keys):
    """No randomisation."""
    import jax

    return model, jax.tree.map(lambda x: None, model)


def _plain(model, keys):
    """Every gain, friction and mass by itself within ± 30 %, and up to 0.6 kg at the tip."""
    import jax
    import jax.numpy as jnp

    hand = mujoco.MjModel.from_xml_string(MODEL).body("lower").id

    def one(key):
        a, b, c, d = jax.random.split(key, 4)
        gain, friction, mass = (
            jax.random.uniform(k, (n,), minval=0.7, maxval=1.3) for k, n in ((a, 3), (b, 3), (c, 4))
        )
        load = jax.random.uniform(d, maxval=0.6)
        body = model.body_mass * mass
        whole = body[hand] + load
        centre = (body[hand] * model.body_ipos[hand] + load * jnp.array([LOWER, 0.0, 0.0])) / whole
        about = body[hand] * load / whole * (LOWER - model.body_ipos[hand, 0]) ** 2
        inertia = (model.body_inertia * mass[:, None]).at[hand, 1:].add(about)
        return {
            "actuator_gainprm": model.actuator_gainprm * gain[:, None],
            "actuator_biasprm": model.actuator_biasprm * gain[:, None],
            "dof_frictionloss": model.dof_frictionloss * friction,
            "body_mass": body.at[hand].set(whole),
            "body_ipos": model.body_ipos.at[hand].set(centre),
            "body_inertia": inertia,
        }

    drawn = jax.vmap(one)(keys)
    axes = jax.tree.map(lambda x: None, model).tree_replace(dict.fromkeys(drawn, 0))
    return model.tree_replace(drawn), axes


def simulators(out: Path) -> dict:
    """By name."""
    import jax
    import jax.numpy as jnp

    from benchmarks.policy.train import Simulator

    given = mujoco.MjModel.from_xml_string(MODEL)
    spec = importlib.util.spec_from_file_location("playground", out / "found" / "playground.py")
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    corrected = mujoco.MjModel.from_xml_path(str(out / "found" / "corrected.xml"))
    true = mujoco.MjSpec.from_string(MODEL)
    true.joint("shoulder").frictionloss = FRICTION
    elbow = true.actuators[2]
    elbow.gainprm[0], elbow.biasprm[1:3] = WEAK * elbow.gainprm[0], WEAK * elbow.biasprm[1:3]
    load = true.body("lower").add_body(name="load", pos=[LOWER, 0, 0])
    load.mass, load.inertia, load.explicitinertial = LOAD, [4e-4] * 3, True
    load.ipos = np.zeros(3)

    def none(keys, step):
        return jnp.zeros((len(keys), 3), int)

    def any_(keys, step):
        late = jax.vmap(lambda k: jax.random.uniform(k, maxval=0.03))(keys)
        return jnp.repeat(jnp.round(late / step).astype(int)[:, None], 3, axis=1)

    def known(keys, step):
        return jnp.full((len(keys), 3), round(LATE / step))

    return {
        "nominal": Simulator("nominal", given, _as_given, none),
        "randomised": Simulator("randomised", given, _plain, any_),
        "corrected": Simulator(
            "corrected", corrected, made.domain_randomizer(corrected), made.command_delays
        ),
        "true": Simulator("true", true.compile(), _as_given, known),
    }


def train(out: Path, only: list[str], size: dict[str, int]) -> None:
    """Weights and errors along the way, OUT/NAME.npz."""
    from benchmarks.policy.train import trained

    for name in only:
        start = time.perf_counter()
        weights, history = trained(simulators(out)[name], **size)
        np.savez(
            out / f"{name}.npz",
            weights=weights,
            history=history,
            seconds=time.perf_counter() - start,
        )
        print(
            f"{name}: {1e3 * history[:, -1].mean():.2f} mm in its own simulator, {time.perf_counter() - start:.0f} s"
        )


def judge(out: Path) -> None:
    """Tip errors on the real arm, results/policy.json and the figure."""
    from benchmarks.policy.train import act

    motions = [wanted(np.random.default_rng(90_000 + k)) for k in range(_TRIALS)]

    def on_robot(motion, seed, weights=None) -> float:
        def policy(k, q, v):
            return motion[k] if weights is None else act(weights, q, v, motion, k)

        seen, _ = moved(policy, motion, seed)
        off = np.linalg.norm(tip(seen[1:]) - tip(motion[1 : len(seen)]), axis=1)
        return float(off.mean())

    rows = {"none": {"robot": [[on_robot(m, k) for k, m in enumerate(motions)]]}}
    for name in NAMES:
        with np.load(out / f"{name}.npz") as made:
            own = made["history"][:, -20:].mean(axis=1)
            robot = [
                [on_robot(m, k, w) for k, m in enumerate(motions)]
                for w in made["weights"].astype(float)
            ]
            rows[name] = {"own": own.tolist(), "robot": robot, "seconds": float(made["seconds"])}
        print(
            f"{name}: {1e3 * own.mean():.2f} mm in its simulator, {1e3 * np.mean(robot):.2f} on the robot"
        )
    print(f"no policy: {1e3 * np.mean(rows['none']['robot']):.2f} on the robot")
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True
    ).stdout.strip()
    RESULT.write_text(
        json.dumps({"commit": commit, "unit": "m", "policies": rows}, indent=1) + "\n"
    )
    figure()


def figure() -> None:
    """Errors in the own simulator and on the robot, each seed a dot, and the table of the page."""
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "policy"
    import matplotlib.pyplot as plt

    rows = json.loads(RESULT.read_text())["policies"]
    fig, ax = plt.subplots(figsize=(7.0, 3.4), layout="constrained")
    for i, name in enumerate(NAMES):
        own, robot = 1e3 * np.array(rows[name]["own"]), 1e3 * np.mean(rows[name]["robot"], axis=1)
        for x, value, colour, label in (
            (i - 0.18, own, "#9ab", "in its own simulator"),
            (i + 0.18, robot, "#c52", "on the robot"),
        ):
            ax.bar(x, value.mean(), 0.34, color=colour, label=label if i == 0 else None)
            ax.plot(np.full(len(value), x), value, "k.", ms=4)
            ax.annotate(
                f"{value.mean():.1f}",
                (x, value.max()),
                (0, 4),
                textcoords="offset points",
                ha="center",
                fontsize=9,
            )
    bare = 1e3 * np.mean(rows["none"]["robot"])
    ax.axhline(bare, color="k", lw=0.8, ls=":")
    ax.annotate(
        f"robot without a policy, {bare:.0f} mm",
        (3.45, bare),
        (0, 3),
        textcoords="offset points",
        ha="right",
        fontsize=9,
    )
    ax.set_xticks(range(len(NAMES)), TITLES)
    ax.set_ylabel("distance of the hand from\nwhere it is wanted [mm]")
    ax.set_ylim(0, 1.15 * bare)
    ax.legend(frameon=False, fontsize=9)
    ax.spines[["top", "right"]].set_visible(False)
    fig.savefig(FIGURE, metadata={"Date": None})
    page = PAGE.read_text()
    start, end = (page.index(mark) for mark in MARKS)
    PAGE.write_text(page[: start + len(MARKS[0])] + table() + page[end:])


def table() -> str:
    """The block of docs/training.md between `MARKS`."""
    kept = json.loads(RESULT.read_text())
    rows = kept["policies"]
    lines = [
        "",
        "",
        "| trained in | in its own simulator [mm] | on the robot [mm] |",
        "|---|---|---|",
    ]
    for name, title in zip(NAMES, TITLES, strict=True):
        own, robot = 1e3 * np.array(rows[name]["own"]), 1e3 * np.mean(rows[name]["robot"], axis=1)
        lines.append(
            f"| {title} | {own.mean():.1f} | {robot.mean():.1f} ({robot.min():.1f} to {robot.max():.1f}) |"
        )
    bare = 1e3 * np.mean(rows["none"]["robot"])
    lines += [f"| no policy: targets are the motion itself | | {bare:.0f} |", ""]
    return "\n".join(
        [
            *lines,
            f"Commit {kept['commit']}; in brackets the best and the worst of three seeds.",
            "",
            "",
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("what", choices=("record", "train", "judge", "figure"))
    parser.add_argument("--only", nargs="+", choices=NAMES, default=list(NAMES))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--generations", type=int, default=300)
    parser.add_argument("--pairs", type=int, default=128)
    parser.add_argument("--motions", type=int, default=8)
    args = parser.parse_args()
    if args.what == "record":
        record(args.out)
    elif args.what == "train":
        size = {name: getattr(args, name) for name in ("seeds", "generations", "pairs", "motions")}
        train(args.out, args.only, size)
    elif args.what == "judge":
        judge(args.out)
    else:
        figure()


if __name__ == "__main__":
    main()
