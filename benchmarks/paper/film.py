"""A short animated figure of the walk, drawn without a graphics card: the robot's shapes as seen from the side.

One robot walks over boxes of ±3 cm with the torso's load switching; positions come from the closed loop, outlines from
the model's own geoms.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np
from matplotlib import animation
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from benchmarks.paper import pelvis
from benchmarks.paper.brain import ADAPTIVE
from benchmarks.paper.figures import FOLDER
from benchmarks.paper.strides import boxes
from jax_inertia.robots import HumanoidOptions, humanoid_mjcf

SECONDS, RATE, SEED = 10.0, 10, 0
VIEW = 0.9  # m to either side of the pelvis


def make() -> Path:
    """Run one robot and write `docs/figures/paper_walk.gif`."""
    found = pelvis.walk(
        np.array([SEED]), (ADAPTIVE,), duration=SECONDS, label="film", keep_path=True
    )
    path = found.series["q"][:, 0]
    model = mujoco.MjModel.from_xml_string(humanoid_mjcf(HumanoidOptions()))
    data = mujoco.MjData(model)
    ground = boxes(SEED, 0.03)
    frames = np.arange(0, len(path), round(1.0 / RATE / (found.time[1] - found.time[0])))
    fig, (scene, plot) = plt.subplots(
        1, 2, figsize=(6.4, 3.4), gridspec_kw={"width_ratios": [1, 1]}, dpi=80
    )
    mass, true = found.series["mass"][:, 0], found.series["true"][:, 0]

    def draw(k: int) -> None:
        data.qpos[:] = path[k]
        mujoco.mj_forward(model, data)
        x = float(path[k][0])
        scene.clear()
        _draw_ground(scene, ground, x)
        for geom in _by_depth(model, data):
            colour = model.mat_rgba[model.geom_matid[geom]][:3]
            outline = _outline(model, data, geom)
            scene.add_patch(Polygon(outline, facecolor=colour, edgecolor="0.25", lw=0.4))
        scene.set(xlim=(x - VIEW, x + VIEW), ylim=(-0.1, 1.85), aspect="equal")
        scene.set_yticks([])
        scene.set_xlabel("x [m]")
        plot.clear()
        plot.plot(found.time[: k + 1], mass[: k + 1], "C1", lw=1.2, label="estimate")
        plot.plot(found.time[: k + 1], true[: k + 1], "k", lw=1, label="true")
        plot.set(xlim=(0, SECONDS), ylim=(0, 45), xlabel="time [s]", title="torso mass [kg]")
        plot.legend(loc="lower right")

    draw(0)  # labels first, so that the layout leaves room for them
    fig.tight_layout()
    film = animation.FuncAnimation(fig, draw, frames=list(frames), interval=1000 / RATE)
    FOLDER.mkdir(exist_ok=True)
    target = FOLDER.parents[1] / "docs" / "figures" / "paper_walk.gif"
    film.save(target, writer=animation.PillowWriter(fps=RATE))
    plt.close(fig)
    return target


def _draw_ground(scene, ground, x: float) -> None:
    """The boxes under the robot's middle."""
    points = np.linspace(x - VIEW, x + VIEW, 400)
    height = np.asarray(ground.at(np.stack([points, np.full_like(points, 0.13)], axis=1)))
    scene.fill_between(points, -0.1, height, color="0.8", step="mid")
    other = np.asarray(ground.at(np.stack([points, np.full_like(points, -0.13)], axis=1)))
    scene.plot(points, other, color="0.55", lw=0.8)


def _by_depth(model: mujoco.MjModel, data: mujoco.MjData) -> list[int]:
    """Drawn geoms, the farthest (left) first, seen from the robot's right."""
    shown = [g for g in range(model.ngeom) if model.geom_group[g] == 2]
    return sorted(shown, key=lambda g: -data.geom_xpos[g][1])


def _outline(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> np.ndarray:
    """Convex hull in x and z of points on the geom."""
    size, kind = model.geom_size[geom], model.geom_type[geom]
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 24), np.linspace(-np.pi / 2, np.pi / 2, 13))
    ball = np.stack([np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), np.sin(v)], -1).reshape(-1, 3)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        points = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]) * size
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        points = ball * size
    else:
        ends = np.array([0.0, 0.0, size[1]])
        points = np.concatenate([size[0] * ball + ends, size[0] * ball - ends])
    world = points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
    flat = world[:, [0, 2]]
    return flat[ConvexHull(flat).vertices]
