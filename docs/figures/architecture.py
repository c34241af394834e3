"""Draw the package's folders and which imports which, read from the source: `python docs/figures/architecture.py`."""

import ast
from collections import Counter
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

PACKAGE = Path(__file__).parents[2] / "jax_inertia"
OUT = Path(__file__).with_suffix(".svg")
WIDE, HIGH, PITCH = 2.0, 0.72, 2.45
# Colours of Okabe and Ito (2008), which every kind of colour vision tells apart.
GROUND, ROBOT, ANSWERS, LEAVES = "#0072B2", "#009E73", "#D55E00", "#CC79A7"
# What a folder does, its colour, and where it stands: column, and row counted upwards.
FOLDERS = {
    "text": ("words for people", GROUND, 0, 0),
    "maths": ("arrays only", GROUND, 2, 0),
    "logs": ("a log and its files", ROBOT, 0, 1),
    "model": ("MJCF, URDF", ROBOT, 1, 2),
    "dynamics": ("rigid bodies", ROBOT, 2, 3),
    "signals": ("log → motion, residual", ROBOT, 1, 4),
    "preflight": ("is the log sound?", ANSWERS, 0, 5),
    "estimation": ("inertial parameters", ANSWERS, 2, 6),
    "diagnosis": ("effects, whole robots", ANSWERS, 0, 7),
    "likelihood": ("closed loops, linear", ANSWERS, 1, 8),
    "replay": ("position targets only", ANSWERS, 2, 9),
    "fleet": ("many logs, many dates", ANSWERS, 0, 8),
    "control": ("whole-body controller", LEAVES, 3, 7),
    "robots": ("models for examples", LEAVES, 3, 3),
    "trainers": ("files to train with", ANSWERS, 3, 10),
    "cli": ("the commands", LEAVES, 2, 11),
}


def imports() -> tuple[Counter[str], Counter[tuple[str, str]]]:
    """Modules of each folder, and import statements from one folder to another."""
    modules: Counter[str] = Counter()
    arrows: Counter[tuple[str, str]] = Counter()
    for path in sorted(PACKAGE.rglob("*.py")):
        folder, *rest = path.relative_to(PACKAGE).parts
        # Modules of the root only hand on what is below.
        if not rest:
            continue
        modules[folder] += path.name != "__init__.py"
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            else:
                continue
            for name in names:
                package, _, inner = name.partition(".")
                other = inner.partition(".")[0]
                if package == PACKAGE.name and other not in ("", folder):
                    arrows[folder, other] += 1
    return modules, arrows


def implied(arrows: Counter[tuple[str, str]]) -> set[tuple[str, str]]:
    """Arrows that a longer way by others stands for."""
    below: dict[str, set[str]] = {}
    for a, b in arrows:
        below.setdefault(a, set()).add(b)

    def reach(start: str) -> set[str]:
        return {x for b in below.get(start, ()) for x in (b, *reach(b))}

    return {(a, b) for a, b in arrows if any(b in reach(c) for c in below[a] - {b})}


def draw(modules: Counter[str], arrows: Counter[tuple[str, str]]) -> None:
    if new := sorted(set(modules) - set(FOLDERS)):
        raise SystemExit(f"give {', '.join(new)} a place in FOLDERS")
    # Rows of folders that are not there close up.
    rows = sorted({FOLDERS[folder][3] for folder in modules})
    corner = {f: (PITCH * FOLDERS[f][2], float(rows.index(FOLDERS[f][3]))) for f in modules}
    plt.rcParams |= {"svg.fonttype": "path", "svg.hashsalt": "architecture", "font.size": 9.5}
    figure, axes = plt.subplots(figsize=(8.6, 8.2))
    for folder, (x, y) in corner.items():
        says, colour, *_ = FOLDERS[folder]
        shape = "round,pad=0,rounding_size=0.1"
        axes.add_patch(
            FancyBboxPatch(
                (x, y),
                WIDE,
                HIGH,
                shape,
                facecolor=colour + "22",
                edgecolor=colour,
                lw=1.8,
                zorder=3,
            )
        )
        middle = {"ha": "center", "va": "center", "zorder": 4}
        axes.text(x + WIDE / 2, y + 0.47, f"{folder}  ({modules[folder]})", weight="bold", **middle)
        axes.text(x + WIDE / 2, y + 0.2, says, fontsize=8, **middle)
    for a, b in sorted(set(arrows) - implied(arrows)):
        (xa, ya), (xb, yb) = corner[a], corner[b]
        if yb >= ya:
            raise SystemExit(f"{a} imports {b}, which FOLDERS does not place below it")
        lean = 0.32 * max(-1.0, min(1.0, (xb - xa) / PITCH))
        ends = (xa + WIDE * (0.5 + lean), ya), (xb + WIDE * (0.5 - lean), yb + HIGH)
        style = {"arrowstyle": "-|>", "mutation_scale": 13, "lw": 1.3, "color": "#444444"}
        axes.add_patch(FancyArrowPatch(*ends, shrinkA=0, shrinkB=1, zorder=2, **style))
    axes.set(xlim=(-0.15, 3 * PITCH + WIDE + 0.15), ylim=(-0.5, len(rows) - 0.15))
    axes.axis("off")
    note = (
        "An arrow: imports from; all point down. One that a chain of others stands for is not drawn.\n"
        "In brackets: modules."
    )
    axes.text(-0.1, -0.34, note, fontsize=8, va="center", color="#444444")
    figure.savefig(OUT, bbox_inches="tight", metadata={"Date": None})


if __name__ == "__main__":
    draw(*imports())
