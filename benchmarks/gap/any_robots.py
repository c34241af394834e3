"""Development data: robots of any shape as MuJoCo itself plays them, bought without friction and rotors or calibrated.

    python benchmarks/gap/any_robots.py OUT --n 20 --seed 1 [--first 0] [--jobs 1] [--targets]

writes OUT/00042/{nominal.xml, log.npz, test.npz, truth.json}. Trees of 2 to 7 hinges and slides about any axis, links
of any proportions, MuJoCo's own friction loss, damping and armature, 100 to 1000 Hz, motions of sines or from pose to
pose; one log in three has nothing odd, one in four two odd effects. Beside `cad.py`, whose five robots and bristles are
always the same: what holds there by chance does not hold here. `--targets`: robots that are told positions, without a
torque in their logs, in arrays kp and kd the loop's gains. Shares no code with the package.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from any_odd import Odd, draw_odd
from any_tree import STEP, depth_first, mjcf, motion_span, tree
from effects import editable
from friction import reflected_inertia
from many import parser, write_all, write_folder

NUMBER = 31  # of this stratum, in the seeds


@dataclass
class Motion:
    """Sines of several frequencies, or minimum-jerk moves from pose to pose with rests."""

    rng: np.random.Generator
    span: np.ndarray  # half of each joint's range
    sines: bool
    seconds: float
    top: float  # Hz
    parts: list = field(default_factory=list)

    def __post_init__(self):
        rng, n = self.rng, len(self.span)
        if self.sines:
            f = rng.uniform(0.1, self.top, (6, n))
            a = rng.normal(size=(6, n)) / f
            self.parts = [
                a * self.span / np.abs(a).sum(0) * 1.3,
                2 * np.pi * f,
                rng.uniform(0, 6.3, (6, n)),
            ]
            return
        time, pose = 0.0, np.zeros(n)
        while time < self.seconds + 2.0:
            goal = rng.uniform(-1, 1, n) * self.span
            last = rng.uniform(0.6, 1.8) / self.top
            self.parts.append((time, last, pose, goal))
            time, pose = time + last + rng.uniform(0.1, 0.6), goal

    def __call__(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if self.sines:
            a, w, p = self.parts
            at = w * t + p
            return (
                (a * np.sin(at)).sum(0),
                (a * w * np.cos(at)).sum(0),
                (-a * w * w * np.sin(at)).sum(0),
            )
        begin, last, pose, goal = next(x for x in reversed(self.parts) if x[0] <= max(t, 0.0))
        s, d = min(max((t - begin) / last, 0.0), 1.0), goal - pose
        return (
            pose + d * s**3 * (10 - 15 * s + 6 * s * s),
            d * 30 * s**2 * (1 - s) ** 2 / last,
            d * 60 * s * (1 - s) * (1 - 2 * s) / last**2,
        )


@dataclass
class Sensors:
    rate: float  # Hz, of the log
    drive: float  # Hz
    kind: str | None  # of the torque, as the log states it
    angle: float  # rad, noise
    speed: float  # rad/s, noise; below zero: no speed in the log
    torque: float  # of each joint's rms, noise


class Drive:
    """Computed torque by the real robot's ordinary physics, with a loop of 5 Hz around it."""

    STIFF, DAMPED = 30.0**2, 60.0

    def __init__(self, real: mujoco.MjModel):
        self.model = real.__copy__()
        self.loss, self.damping = real.dof_frictionloss.copy(), real.dof_damping.copy()
        self.model.dof_frictionloss[:] = self.model.dof_damping[:] = 0.0
        self.data = mujoco.MjData(self.model)

    def __call__(self, aim, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        d, (wanted, speed, a) = self.data, aim
        d.qpos[:], d.qvel[:] = wanted, speed
        d.qacc[:] = a + self.STIFF * (wanted - q) + self.DAMPED * (speed - v)
        mujoco.mj_inverse(self.model, d)
        return d.qfrc_inverse + self.damping * speed + self.loss * np.tanh(speed / 0.05)


class Loop:
    """kp (target − q) − kd q̇: a loop that is as stiff as sags by 0.02 to 0.1 rad ask for, damped by 0.5 to 1."""

    def __init__(
        self, rng: np.random.Generator, size: np.ndarray, inertia: np.ndarray, sag: np.ndarray
    ):
        self.kp = size / (sag * rng.uniform(0.02, 0.1, len(size)))
        self.kp = np.maximum(self.kp, 15.0**2 * inertia)
        self.kd = 2 * rng.uniform(0.5, 1.0, len(size)) * np.sqrt(self.kp * inertia)

    def __call__(self, aim, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return self.kp * (aim[0] - q) - self.kd * v


def play(
    real: mujoco.MjModel, drive: Drive | Loop, odd: list[Odd], motion: Motion, s: Sensors, rng
) -> dict[str, np.ndarray]:
    """A log of the motion, and its torque without noise as `clean`; RuntimeError where the motion is lost.

    A loop is told a target at each row of its log, late where a torque would be.
    """
    d, told_positions = mujoco.MjData(real), isinstance(drive, Loop)
    every, rows, count = (round(x / STEP) for x in (1 / s.drive, 1 / s.rate, motion.seconds))
    late = round(max((o.delay for o in odd), default=0.0) / STEP)
    zero = sum((o.zero for o in odd if o.zero is not None), np.zeros(real.nv))
    d.qpos[:], d.qvel[:] = motion(0.0)[0] - zero, motion(0.0)[1]
    told, q, v = np.zeros((count, real.nv)), [], []
    for k in range(count):
        if k % every == 0:
            at = max(0, k - late) // rows * rows if told_positions else k
            aim = motion(at * STEP)
            told[k] = drive(aim, d.qpos + zero, d.qvel)
        else:
            told[k] = told[k - 1]
        if k % rows == 0:
            q.append(d.qpos + zero)
            v.append(d.qvel.copy())
        acts = told[k if told_positions else max(0, k - late)]
        d.xfrc_applied[:] = 0.0
        for o in odd:
            acts = o.motor(acts, d)
            o.force(k * STEP, d)
        d.qfrc_applied[:] = acts
        mujoco.mj_step(real, d)
        if not np.abs(d.qpos + zero - aim[0]).max() < 0.4:
            raise RuntimeError("the loop lost its motion")
    clean = told[::rows]
    size = np.sqrt(np.mean(clean**2, 0))
    noisy = lambda x, sigma: np.array(x) + sigma * rng.normal(size=np.shape(x))  # noqa: E731
    out = {"time": np.arange(len(q)) / s.rate, "qpos": noisy(q, s.angle)}
    if s.speed >= 0:
        out["qvel"] = noisy(v, s.speed)
    if isinstance(drive, Loop):
        targets = np.array([motion(t)[0] for t in out["time"]])
        return out | {"qpos_target": targets, "kp": drive.kp, "kd": drive.kd, "clean": clean}
    out |= {"tau": noisy(clean, s.torque * size), "clean": clean}
    return out | ({"tau_kind": np.array(s.kind)} if s.kind else {})


def off_the_drawing(rng: np.random.Generator, model: mujoco.MjModel) -> None:
    """Bodies as a maker states them: masses 2 %, centres 1 mm, inertias 5 % (1 sigma)."""
    n = model.nbody
    factor = 1 + 0.02 * rng.normal(size=n)
    model.body_mass[:] *= factor
    model.body_inertia[:] *= (factor * (1 + 0.05 * rng.normal(size=n)))[:, None]
    model.body_ipos[1:] += 0.001 * rng.normal(size=(n - 1, 3))


def draw(rng: np.random.Generator, targets: bool) -> tuple[dict, dict, dict[str, str]]:
    """log, test, files of text; RuntimeError where no loop holds its motion."""
    robot = depth_first(tree(rng))
    calibrated = bool(rng.random() < 0.2)
    bare = mujoco.MjModel.from_xml_string(mjcf(robot))
    drawing, span = mjcf(robot), motion_span(robot)
    sines, top = bool(rng.random() < 0.6), float(rng.uniform(0.4, 1.0))
    motions = [Motion(rng, span, x, t, top) for x, t in ((sines, 20.0), (not sines, 12.0))]
    s = Sensors(
        rate=float(rng.choice([100, 200, 250, 500, 1000])),
        drive=float(rng.choice([500, 1000])),
        kind=rng.choice([None, "commanded", "sensor"]),
        angle=10 ** rng.uniform(-5, -4),
        speed=-1.0 if rng.random() < 0.3 else 10 ** rng.uniform(-3, -2),
        torque=float(rng.uniform(0.003, 0.015)),
    )
    rigid = play(bare, Drive(bare), [], motions[0], s, rng)["clean"]
    size = np.sqrt(np.mean(rigid**2, 0))
    size = np.maximum(size, 0.1 * size.max() * np.where(span < 0.5, 5.0, 1.0))
    for k, j in enumerate(robot):
        j.armature = float(reflected_inertia(bare, k) * rng.uniform(0.1, 0.8))
        j.loss = float(size[k] * rng.uniform(0.05, 0.3))
        j.damping = float(size[k] * rng.uniform(0.03, 0.2) / (span[k] * 2 * top))
    text = mjcf(robot)
    count = 0 if (x := rng.random()) < 0.3 else 1 if x < 0.75 else 2
    odd = [draw_odd(rng, robot, size, top) for _ in range(count)]
    ordinary, real = (editable(mujoco.MjModel.from_xml_string(text)) for _ in range(2))
    if not calibrated:
        off = rng.integers(2**31)
        for model in (ordinary, real):
            off_the_drawing(np.random.default_rng(off), model)
    for o in odd:
        o.edit(real)
    runs = []
    inertia = np.array([reflected_inertia(ordinary, k) for k in range(len(robot))])
    drive = Loop(rng, size, inertia, span / 0.9) if targets else Drive(ordinary)
    for motion in motions:
        run = play(real, drive, odd, motion, s, rng)
        del run["clean"]
        runs.append(run | {"joint_names": np.array([j.name for j in robot])})
    truth = {
        "calibrated": calibrated,
        "odd": [{"family": o.family, "place": o.place, "numbers": o.numbers} for o in odd],
        "joints": {
            j.name: {"damping": j.damping, "coulomb": j.loss, "armature": j.armature} for j in robot
        },
        "sensors": vars(s),
        "sines": sines,
    }
    texts = {
        "nominal.xml": text if calibrated else drawing,
        "truth.json": json.dumps(truth, indent=1),
    }
    return *runs, texts


def write(out: str, targets: bool, seed: int, index: int) -> str:
    folder = Path(out) / f"{index:05d}"
    if (folder / "truth.json").exists():
        return "is there"
    for attempt in range(10):
        try:
            log, test, texts = draw(np.random.default_rng([NUMBER, seed, index, attempt]), targets)
        except RuntimeError:
            continue
        write_folder(folder, log, test, texts)
        truth = json.loads(texts["truth.json"])
        return ", ".join(f"{o['family']} at {o['place']}" for o in truth["odd"]) or "nothing odd"
    raise RuntimeError("no loop holds its motion")


if __name__ == "__main__":
    options = parser(__doc__, 20)
    options.add_argument(
        "--targets", action="store_true", help="logs of position-controlled robots"
    )
    args = options.parse_args()
    write_all(args, write, str(args.out), args.targets)
