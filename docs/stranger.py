"""The first minutes of somebody new to the package, as they go: `python docs/stranger.py` writes first_path.md.

In an empty folder and a fresh environment: install, demo, a CSV with names of its own, a report, the corrected model in
MuJoCo and the file that a trainer reads. Every line of output is what was printed; times are of this run.
"""

import platform
import re
import resource
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = Path(__file__).with_name("first_path.md")
MOST_LINES = 14
RECORD = '''import mujoco
import numpy as np

XML = """<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody>
<body pos="0 0 0.5"><joint name="shoulder" axis="0 1 0" armature="0.05" damping="0.4" frictionloss="0.2"/>
<inertial pos="0 0 -0.15" mass="2" diaginertia="0.02 0.02 0.003"/>
<body pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" armature="0.03" damping="0.2" frictionloss="{friction}"/>
<inertial pos="0 0 -0.12" mass="1.2" diaginertia="0.01 0.01 0.002"/></body></body></worldbody>
<actuator><position joint="shoulder" kp="80" kv="3"/><position joint="elbow" kp="40" kv="1.5"/></actuator></mujoco>"""
with open("arm.xml", "w") as file:
    file.write(XML.format(friction=0.1))

def record(name, seed):
    """The robot, whose elbow has more friction than its model: positions and targets, 250 Hz, columns of its own."""
    model = mujoco.MjModel.from_xml_string(XML.format(friction=0.6))
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    pace, phase = rng.uniform(1.0, 5.0, (3, 2)), rng.uniform(0, 6, (3, 2))
    rows = []
    for k in range(12_000):
        if k % 4 == 0:
            data.ctrl[:] = 0.35 * np.sin(pace * k * 0.001 + phase).sum(axis=0)
            rows.append([k * 0.001, *(data.qpos + 2e-5 * rng.normal(size=2)), *data.ctrl])
        mujoco.mj_step(model, data)
    head = "t_s,J_shoulder_pos,J_elbow_pos,J_shoulder_cmd_pos,J_elbow_cmd_pos"
    np.savetxt(name, rows, delimiter=",", header=head, comments="")

record("run.csv", 1)
record("other.csv", 2)
'''
LOOK = """import mujoco
model = mujoco.MjModel.from_xml_path("out/corrected.xml")
print(dict(zip(("shoulder", "elbow"), model.dof_frictionloss.round(3).tolist())))
"""


class Walk:
    """The transcript, and the commands that it holds."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.text, self.rows = folder, "", []

    def run(self, told: str, words: list[str], said: str) -> str:
        """Run a command in the folder; what it printed, which the page shows as `said`."""
        used, begin = _cpu(), time.monotonic()
        done = subprocess.run(words, cwd=self.folder, capture_output=True, text=True)
        lasted, used = time.monotonic() - begin, _cpu() - used
        if done.returncode not in (0, 2):
            raise SystemExit(f"{said}: {done.stderr[-2000:]}")
        printed = (done.stdout if done.returncode == 0 else done.stderr).rstrip().splitlines()
        more = [f"... ({len(printed) - MOST_LINES} more lines)"] * (len(printed) > MOST_LINES)
        lines = [x.rstrip() for x in printed[:MOST_LINES]] + more
        self.text += f"{told}\n\n    {said}\n\n" + "".join(f"    {x}\n" for x in lines) + "\n"
        self.rows.append((said, lasted, used))
        return done.stdout + done.stderr


def _cpu() -> float:
    own = resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime


def main() -> None:
    """Walk the path, and write the page."""
    with tempfile.TemporaryDirectory() as name:
        walk = Walk(Path(name))
        program = walk.folder / ".venv" / "bin"
        python, tool = str(program / "python"), str(program / "jax-inertia")
        venv = [sys.executable, "-m", "venv", ".venv"]
        subprocess.run(venv, cwd=walk.folder, check=True)
        walk.run(
            "Install, in a fresh environment:",
            [python, "-m", "pip", "install", "-q", "--disable-pip-version-check", str(ROOT)],
            "pip install .",
        )
        walk.run("The demo:", [tool, "demo"], "jax-inertia demo")
        (walk.folder / "record.py").write_text(RECORD)
        subprocess.run([python, "record.py"], cwd=walk.folder, check=True)
        head = (walk.folder / "run.csv").read_text().splitlines()[0]
        walk.text += f"A robot of one's own, a CSV that begins with\n\n    {head}\n\n"
        said = walk.run(
            "First try, which names all columns:",
            [tool, "convert", "run.csv", "run.npz"],
            "jax-inertia convert run.csv run.npz",
        )
        (line,) = re.findall(r"\(jax-inertia convert IN OUT (.*?)\); it has", said)
        for log in ("run", "other"):
            words = ["convert", f"{log}.csv", f"{log}.npz", *shlex.split(line)]
            walk.run(
                "The line as it was printed:" if log == "run" else "And for the other run:",
                [tool, *words, "--model", "arm.xml"],
                f"jax-inertia convert {log}.csv {log}.npz {line} --model arm.xml",
            )
        words = [
            "diagnose",
            "run.npz",
            "--model",
            "arm.xml",
            "--test-log",
            "other.npz",
            "--out",
            "out",
        ]
        walk.run(
            "The report, and the files:",
            [tool, *words, "--export", "playground"],
            f"jax-inertia {' '.join(words)} --export playground",
        )
        (walk.folder / "look.py").write_text(LOOK)
        walk.run("The corrected model in MuJoCo:", [python, "look.py"], "python look.py")
        walk.run("What there is now:", ["ls", "out"], "ls out")
    total = sum(lasted for _, lasted, _ in walk.rows)
    table = "".join(
        f"| `{said if len(said) < 60 else said[:57] + '...'}` | {lasted:.0f} | {used:.0f} |\n"
        for said, lasted, used in walk.rows
    )
    PAGE.write_text(
        "# The first minutes, as they went\n\n"
        "An empty folder, a fresh environment, and every command with what it printed. "
        "`python docs/stranger.py` walks\nthis path and writes this page.\n\n"
        f"Python {platform.python_version()}, {total:.0f} s in all:\n\n"
        f"| command | s | s of CPU |\n|---|---|---|\n{table}\n{walk.text}"
        "The program that recorded the robot:\n\n```python\n" + RECORD + "```\n"
    )
    print(f"{total:.0f} s in all, {PAGE}")


if __name__ == "__main__":
    main()
