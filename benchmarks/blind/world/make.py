"""One log with its test log, nominal model and truth, from a setting."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pinocchio as pin

from world.control import Follow, Stand
from world.describe import Machine, to_mjcf, to_pinocchio
from world.draw import Hidden, Scene, hide
from world.machines import MACHINES
from world.motions import make as make_motion
from world.plan import ALIKE, Setting
from world.sensors import Sensors, draw_sensors, to_contract
from world.simulate import PREROLL, Real, Unstable, run
from world.unknowns import UNKNOWN, hide_unknown
from world.yardstick import beyond, visibility

ATTEMPTS = 10


def slightly_wrong(machine: Machine, rng: np.random.Generator) -> Machine:
    """The real robot of a model that is up to 1 % off in masses, 1 mm in centres, 7 % in damping."""
    for k, link in enumerate(machine.links):
        mass = 1.0 + rng.uniform(-0.01, 0.01)
        machine = machine.edited(
            k,
            mass=link.mass * mass,
            inertia=link.inertia * mass,
            com=link.com + rng.uniform(-1e-3, 1e-3, 3),
            damping=link.damping * (1.0 + rng.uniform(-0.07, 0.07)),
        )
    return machine


class Bench:
    """A robot with its motions, loops and sensors, on which effects are tried."""

    def __init__(self, setting: Setting):
        self.setting = setting
        rng = self.rng(0)
        self.nominal = MACHINES[setting.robot](rng)
        self.true = slightly_wrong(self.nominal, rng) if setting.wrong else self.nominal
        self.motions = [
            make_motion(self.nominal, kind, self.rng(1, i))
            for i, kind in enumerate(setting.motions)
        ]
        self.omega, self.simple = float(rng.uniform(10.0, 18.0)), bool(rng.random() < 0.4)
        self.presliding = float(np.exp(rng.uniform(np.log(1e-4), np.log(1e-3))))
        self.peak, self.busy, self.span = self._reference(0)
        self.sensors = draw_sensors(self.nominal, self.peak, setting.loud, self.rng(2))
        self.rows = round(setting.duration * setting.rate)

    def rng(self, *purpose: int) -> np.random.Generator:
        return np.random.default_rng([*self.setting.key, *purpose])

    def _reference(self, which: int):
        """Peak and 90 % torques (n) and joint range (2, n) of a motion under the nominal model."""
        machine, motion = self.nominal, self.motions[which]
        model, _ = to_pinocchio(machine)
        data, n = model.createData(), len(machine.joints)
        at = np.arange(0.0, self.setting.duration, 0.02)
        q, v, a = (np.array(x) for x in zip(*map(motion, at), strict=True))
        if machine.feet:
            # The weight on bent legs: what counts is in the knees and, less, in the hips.
            weight = 9.81 * sum(x.mass for x in machine.links)
            peak = np.tile([0.018, 0.016, 0.05], 4) * weight
            return peak, 0.8 * peak, np.array([q.min(0), q.max(0)])
        still = np.zeros((len(at), 7))
        still[:, 6] = 1.0
        zero = np.zeros((len(at), 6))
        if machine.floating:
            q7, v6, a6 = np.hstack([still, q]), np.hstack([zero, v]), np.hstack([zero, a])
        else:
            q7, v6, a6 = q, v, a
        tau = [pin.rnea(model, data, *row)[-n:] for row in zip(q7, v6, a6, strict=True)]
        tau = np.abs(np.array(tau) + machine.array("damping") * v)
        tau += machine.array("friction")
        return tau.max(0), np.percentile(tau, 90, axis=0), np.array([q.min(0), q.max(0)])

    def simulate(self, hidden: list[Hidden], which: int) -> dict:
        s = self.setting
        motion = self.motions[which]
        if self.nominal.feet:
            controller = Stand(self.nominal, motion, -PREROLL)
        else:
            controller = Follow(self.nominal, self.omega, self.simple, motion, -PREROLL)
        present = [h for h in hidden if h.lasting or which == 0]
        parts = [part for h in present for part in h.parts]
        real = Real(self.nominal, self.true, parts, s.engine, self.presliding)
        duration = s.duration if which == 0 else s.test_duration
        return run(real, controller, motion, s.rate, duration, self.sensors, self.rng(3, which))

    def take(self, attempt: int) -> None:
        """The loop of the n-th attempt: the later ones are softer."""
        if attempt >= ATTEMPTS // 2:
            self.omega, self.simple = 8.0, False

    def scene(self, rng: np.random.Generator) -> Scene:
        return Scene(self.nominal, self.peak, self.busy, self.span, self.setting.duration, rng)

    def still(self) -> dict:
        """What the same motion shows with nothing hidden: the drive's own noise, which is in no log."""
        return self.seen(self.simulate([], 0), self.true)

    def seen(self, log: dict, machine: Machine) -> dict:
        return visibility(machine, log, self.sensors, self.rows)


def clash(hidden: list[Hidden]) -> bool:
    """Two effects at one place, or one effect in two disguises, are no fair question."""
    if len(hidden) < 2:
        return False
    places, families = {h.name for h in hidden}, {h.family for h in hidden}
    return len(places) < len(hidden) or any(a <= families for a in ALIKE)


def make(setting: Setting) -> tuple[dict, dict, str, dict]:
    """The log and the test log (contract), the nominal model (MJCF), and the truth."""
    bench, reason = Bench(setting), ""
    for attempt in range(ATTEMPTS):
        rng = bench.rng(4, attempt)
        scene = bench.scene(rng)
        hidden = [(hide_unknown if f in UNKNOWN else hide)(f, scene) for f in setting.families]
        if clash(hidden):
            continue
        bench.take(attempt)
        try:
            log = bench.simulate(hidden, 0)
            test = bench.simulate(hidden, 1)
            alone = [bench.simulate([h], 0) for h in hidden] if len(hidden) > 1 else []
            whole = bench.seen(log, bench.true)
            still = bench.still() if hidden else whole
        except Unstable as error:
            reason = str(error)
            continue
        seen = [bench.seen(x, bench.true) for x in alone] if len(hidden) > 1 else [whole]
        truth = {
            "effects": [
                h.truth() | {"visibility": beyond(v, still)}
                for h, v in zip(hidden, seen, strict=False)
            ],
            "visibility": whole,
            "still": still,
            "under_nominal": bench.seen(log, bench.nominal) if setting.wrong else whole,
            "equivalents": [equivalents(setting.robot, h) for h in hidden],
            "setting": asdict(setting),
            "sensors": _plain(bench.sensors),
            "simple_loop": bench.simple,
            "known_presliding": bench.presliding,
            "attempt": attempt,
        }
        s = bench.sensors
        logs = (
            to_contract(bench.nominal, log, s, setting.duration, bench.rng(5, 0)),
            to_contract(bench.nominal, test, s, setting.test_duration, bench.rng(5, 1)),
        )
        return *logs, to_mjcf(bench.nominal), truth
    raise RuntimeError(f"no stable draw in {ATTEMPTS} attempts ({reason})")


def _plain(s: Sensors) -> dict:
    return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(s).items()}


def equivalents(robot: str, h: Hidden) -> list[list[str]]:
    """(family, place) of candidates that explain the same log exactly, where theory says so."""
    place = (h.family, h.name)
    fixed = robot in ("six", "seven", "two")
    if fixed and (h.mechanism, h.name) == ("quadratic_friction", "axis1"):
        # The first link turns about an axis that stands still: each of its points draws a circle.
        return [["drag", "segment1"]]
    if robot in ("six", "seven"):
        # About a vertical fixed axis all inertia is one number.
        alike = [("armature", "axis1"), ("link_inertia", "segment1"), ("payload", "segment1"),
                 ("com_shift", "segment1")]  # fmt: skip
    elif robot == "two":
        alike = [("armature", "axis1"), ("link_inertia", "segment1")]
        if h.family == "gravity_tilt" or place == ("encoder_offset", "axis1"):
            alike = [("gravity_tilt", "global"), ("encoder_offset", "axis1")]
    else:
        return []
    return [list(x) for x in alike if x != place] if place in alike else []
