"""What a person sees of a robot, a log and an estimate: in a console, in a notebook, and while they are traced."""

import html
import re

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import jax_inertia as ji
from jax_inertia.estimation.physical_estimate import Estimate
from jax_inertia.logs.log import Log

ODD = "<script>x</script>"
LEG = f"""
<mujoco><worldbody><body name="hip"><freejoint name="root"/><geom size="0.1" mass="4"/>
  <body name="thigh" pos="0 0 -0.1"><joint name="{html.escape(ODD)}" axis="1 0 0"/><joint name="pitch" axis="0 1 0"/>
    <inertial pos="0.01 0 -0.2" mass="2" diaginertia="0.02 0.02 0.004"/>
    <body name="sensor" pos="0 0 -0.1"><inertial pos="0 0 0" mass="0.25" diaginertia="1e-4 1e-4 1e-4"/></body>
  </body></body></worldbody></mujoco>
"""


@pytest.fixture(scope="module")
def robot() -> ji.Robot:
    return ji.load_model(mujoco.MjModel.from_xml_string(LEG))


def log() -> Log:
    qpos = np.array([[0.0, 1.0], [0.5, np.nan], [1.5, 3.0]])
    return Log(
        time=np.array([0.0, 0.1, 0.2]),
        joint_names=(ODD, "pitch"),
        qpos=qpos,
        tau=2.0 * np.ones((3, 2)),
        notes=("joint <b> left out",),
    )


def estimate() -> Estimate:
    pi = jnp.array([[3.0, 0.3, 0, -0.6, 1, 0, 0, 1, 0, 1], [1.0, 0.1, 0, 0, 1, 0, 0, 1, 0, 1]])
    return Estimate(pi, 0.1 * jnp.ones((2, 10)), pi[:, 1:4] / pi[:, :1], 0.001 * jnp.ones((2, 3)))


def cells(page: str) -> list[list[str]]:
    """The rows of a table's body, as text."""
    rows = re.findall(r"<tr>(.*?)</tr>", page.partition("<tbody>")[2])
    return [[html.unescape(x) for x in re.findall(r"<td[^>]*>(.*?)</td>", row)] for row in rows]


def test_robot(robot):
    text = f"Robot(free base, 3 bodies, nq=9, nv=8, 6.25 kg; joints root, {ODD}, pitch)"
    assert repr(robot) == text
    page = robot._repr_html_()
    assert "<script" not in page
    assert cells(page) == [
        ["hip", "root", "4", "0.0, 0.0, 0.0"],
        ["thigh", f"{ODD}, pitch", "2", "10.0, 0.0, -200.0"],
        ["sensor", "(welded)", "0.25", "0.0, 0.0, 0.0"],
    ]


def test_log():
    page = log()._repr_html_()
    assert "<script" not in page
    assert "<b>" not in page
    assert "left out" in page
    assert cells(page) == [[ODD, "0 … 1.5", "2 … 2"], ["pitch", "1 … 3 (1 missing)", "2 … 2"]]


def test_estimate():
    assert repr(estimate()).splitlines() == [
        "Estimate(2 bodies; ± 95 %)",
        "  3 ± 0.2 kg at (100.0, 0.0, -200.0) ± (2.0, 2.0, 2.0) mm",
        "  1 ± 0.2 kg at (100.0, 0.0, 0.0) ± (2.0, 2.0, 2.0) mm",
    ]
    assert cells(estimate()._repr_html_())[1][1] == "1 ± 0.2"
    over_time = jax.tree.map(lambda x: jnp.stack([0 * x, x]), estimate())
    assert repr(over_time).startswith("Estimate(2 bodies, 2 samples, the last; ± 95 %)\n  3 ± 0.2")


def test_what_has_no_numbers_still_reads(robot):
    """Under jit and vmap, in a batch, and as a tree of shapes."""
    seen = []

    def look(x):
        seen.append(repr(x) + x._repr_html_())
        return 0.0

    for thing in (robot, log(), estimate()):
        jax.jit(look)(thing)
        assert "traced" in repr(jax.eval_shape(lambda x: x, thing))
    jax.vmap(look)(jax.tree.map(lambda x: jnp.stack([x, x]), robot))
    assert [text.split("(")[0] for text in seen] == ["Robot", "Log", "Estimate", "Robot"]
    assert all("traced" in text for text in seen)
    assert "batched" in repr(jax.tree.map(lambda x: jnp.stack([x, x]), robot))
