"""Table II, pelvis height: walking over rough ground while the torso's mass follows Table I's square wave.

The error is between the pelvis and its own reference, which follows the ground. The other walks come from here too.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.paper.brain import (
    ADAPTIVE,
    COMPOSITE,
    GAINS,
    MODES,
    NONE,
    ORACLE,
    Settings,
    make_brain,
)
from benchmarks.paper.figures import figure, legend, save
from benchmarks.paper.loop import Run, by_controller, crew, drive, replay, summary
from benchmarks.paper.plant import Fleet, LinkMass, Sensors, model
from benchmarks.paper.shared_out import Wanted, every, merged
from benchmarks.paper.strides import begin_at_home, boxes, strolling, walk_figures
from jax_inertia.control.walking import Ground
from jax_inertia.estimation.priors import Load, Tolerance
from jax_inertia.model.load import body_pi
from jax_inertia.robots import Terrain

TORSO = "torso_link"
DURATION, START = 60.0, 2.0  # s; the waveform begins with the run, scoring and walking at START
SETTINGS = Settings(
    bodies=(TORSO,),
    prior=Load(15.0, 0.2),
    drift=Tolerance(mass=1.0, com=0.02, spread=0.05),
    iterations=2,
    damping=120.0,
)


SENSORS = Sensors()


def waveform(t: float) -> float:
    """Table I: 30 kg, amplitude 5 kg, square at 0.2 Hz [kg]."""
    return 35.0 if (0.2 * t) % 1.0 < 0.5 else 25.0


def heights(ground: Ground):
    """The grounds of a fleet as the plant reads them: (robots, 8, 2) → (robots, 8)."""
    height, corner, cell = (np.asarray(x) for x in (ground.height, ground.corner, ground.cell))
    robots, nx, ny = height.shape
    own = np.arange(robots)[:, None]

    def at(xy: np.ndarray) -> np.ndarray:
        i = np.floor((xy - corner[:, None]) / cell[:, None, None]).astype(int)
        inside = (i >= 0).all(-1) & (i[..., 0] < nx) & (i[..., 1] < ny)
        value = height[own, np.clip(i[..., 0], 0, nx - 1), np.clip(i[..., 1], 0, ny - 1)]
        return np.where(inside, value, 0.0)

    return at


def walk(
    seeds: np.ndarray,
    modes: tuple[int, ...] = (NONE, ADAPTIVE, ORACLE),
    *,
    amplitude: float = 0.03,
    knows_ground: bool = True,
    step: float = 0.25,
    mass=waveform,
    settings: Settings = SETTINGS,
    sensors: Sensors = SENSORS,
    stiffness: float = GAINS.height[0],
    nominal_mass: float | None = None,
    duration: float = DURATION,
    solref: tuple[float, float] = (0.006, 1.0),
    landing_speed: float = 0.2,
    start: float | np.ndarray = START,
    keep_path: bool = False,
    keep_inputs: bool = False,
    label: str = "walk",
) -> Run:
    """Walk over each seed's own boxes; series of pelvis height and its reference, estimated mass, forces.

    `start` [s] may differ from seed to seed, so that what happens at one time meets each robot elsewhere in its step.
    """
    plant = model(terrain=Terrain.CORNER_PLANES, solref=solref)
    gains = eqx.tree_at(lambda g: g.height, GAINS, (stiffness, 2.0 * stiffness**0.5))
    brain = make_brain(plant, settings, sensors, strolling, gains=gains, nominal_mass=nominal_mass)
    mode, seed = crew(seeds, modes)
    starts = np.broadcast_to(start, len(seeds))
    walks = [
        walk_figures(
            plant,
            boxes(int(s), amplitude),
            step=step,
            start=float(begin),
            knows_ground=knows_ground,
            landing_speed=landing_speed,
            force_noise=sensors.foot_force(),
        )
        for s, begin in zip(seed, np.tile(starts, len(modes)), strict=True)
    ]
    plans = [begin_at_home(one, plant) for one in walks]
    plan = jax.tree.map(lambda *x: jnp.stack(x), *plans)
    fleet = Fleet(plant, seed, sensors, height=heights(plan[0].ground))
    link = LinkMass(plant, TORSO)
    body = plant.body(TORSO).id

    def truth(t: float) -> np.ndarray:
        link.set(mass(t))
        return body_pi(plant, body)[None]

    def watch(fleet: Fleet, out) -> dict[str, np.ndarray]:
        force = fleet.force_window[:, -1].reshape(fleet.size, 2, 4, 3)
        path = {"q": fleet.q} if keep_path else {}
        return {
            **path,
            "height": fleet.q[:, 2],
            "wanted": out.record[:, 0],
            "x": fleet.q[:, 0],
            "mass": out.pi[:, 0, 0],
            "inertia": out.pi[:, 0, (4, 7, 9)],
            "physical": out.physical[:, 0],
            "accepted": out.accepted,
            "nis": out.nis,
            "true": np.full(fleet.size, link.mass),
            "load": force[..., 2].sum(axis=2),
            "steps": out.record[:, 4],
        }

    return drive(
        brain,
        fleet,
        mode,
        seed,
        duration,
        watch,
        truth=truth,
        plan=plan,
        keep_inputs=keep_inputs,
        label=label,
    )


def refiltered(found: Run, settings: Settings, sensors: Sensors = SENSORS) -> Run:
    """A walk that the truth steered and that kept its inputs, as a filter of other settings saw it."""
    return replay(make_brain(model(), settings, sensors, strolling), found)


def errors(found: Run, start: float = START) -> np.ndarray:
    """RMSE of the pelvis height of each robot while it is up [m]."""
    away = found.series["height"].astype(float) - found.series["wanted"]
    on = (found.time[:, None] >= start) & (found.time[:, None] < found.fell[None] - 0.5)
    return np.sqrt(np.sum(np.where(on, away, 0.0) ** 2, axis=0) / np.maximum(on.sum(axis=0), 1))


def results(seeds: np.ndarray, sweep_seeds: np.ndarray, duration: float = DURATION) -> dict:
    """Everything that the report says of this experiment.

    Controllers without a filter have the sweep's seeds alone: nothing but noise tells theirs apart.
    """
    cells = ((60.0, None), (120.0, None), (400.0, None), (120.0, 30.0))
    whole = {"duration": duration, "label": "pelvis"}
    wanted = [
        Wanted(walk, seeds, (ADAPTIVE, COMPOSITE), whole),
        Wanted(walk, sweep_seeds, (NONE, ORACLE), whole),
    ]
    for stiffness, nominal in cells:
        own = {"stiffness": stiffness, "nominal_mass": nominal, "duration": min(15.0, duration)}
        wanted.append(Wanted(walk, sweep_seeds, (NONE, ADAPTIVE, ORACLE), own))
    filtered, others, *parts = every(wanted)
    found = merged([filtered, others])
    error = errors(found)
    out = by_controller(found.mode, error)
    fallen = np.isfinite(found.fell)
    falls = {name: int(fallen[found.mode == i].sum()) for i, name in enumerate(MODES)}
    out["falls"] = falls["adaptive"]
    out["falls_by_controller"] = falls
    out["distance_m"] = {
        name: float(np.median(found.series["x"][-1, found.mode == i]))
        for i, name in enumerate(MODES)
    }
    out["duration_s"] = duration
    out["unphysical"] = int(found.unphysical.sum())
    out["unsolved"] = float(found.unsolved.max())
    adaptive = (found.mode == 1) & ~fallen
    on = found.time >= START
    wrong = (found.series["mass"] - found.series["true"])[on][:, adaptive]
    out["mass_rmse_kg"] = summary(np.sqrt(np.mean(wrong.astype(float) ** 2, axis=0)))
    out["sweep"] = []
    for (stiffness, nominal), part in zip(cells, parts, strict=True):
        e = errors(part)
        row: dict = {MODES[i]: float(np.median(e[part.mode == i])) for i in np.unique(part.mode)}
        row["falls"] = int(np.isfinite(part.fell).sum())
        out["sweep"].append({"stiffness": stiffness, "nominal_mass": nominal or 13.5, **row})
    _draw(found)
    return out


def _draw(found: Run) -> None:
    fig, axes = figure(3, height=6.4)
    first = found.seed == found.seed[0]
    on = (found.time > START) & (found.time < START + 20.0)
    t = found.time[on]
    for i, name in enumerate(MODES):
        away = (found.series["height"] - found.series["wanted"])[on][:, first & (found.mode == i)]
        axes[0].plot(t, 1000 * away, label=name, lw=1)
    axes[0].set_ylabel("height error [mm]")
    legend(axes[0])
    adaptive = first & (found.mode == 1)
    for name, label, colour in (("wanted", "reference", "k"), ("height", "pelvis", "C1")):
        axes[1].plot(t, found.series[name][on][:, adaptive], label=label, lw=1, color=colour)
    axes[1].set_ylabel("pelvis height [m]")
    legend(axes[1])
    for name, label, colour in (("mass", "estimate", "C1"), ("true", "true", "k")):
        axes[2].plot(t, found.series[name][on][:, adaptive], label=label, lw=1, color=colour)
    axes[2].set_ylabel("torso mass [kg]")
    axes[2].set_xlabel("time [s]")
    legend(axes[2])
    save(fig, "paper_pelvis")
