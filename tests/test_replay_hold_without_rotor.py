"""A drive that holds its torque takes inertia from joints: from links, where a model has no rotors to take it from."""

import mujoco
import numpy as np
import pytest

import jax_inertia as ji
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.model.joint_inertia import lighten, mass_matrix
from jax_inertia.replay.loop import Loop
from jax_inertia.replay.simulation.model_edits import lightened
from jax_inertia.replay.simulation.plant import Plant

HEAD = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <body name="base">
      <joint name="pan" axis="0 0 1"/>
      <inertial pos="0.01 0.03 0.06" mass="2.1" diaginertia="0.0104 0.006 0.0095"/>
      <body name="head" pos="0 0 0.14">
        <joint name="tilt" axis="0 1 0"/>
        <inertial pos="0.06 -0.01 0.05" mass="3.4" diaginertia="0.0136 0.0328 0.0319"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""
KP, KD = np.array([8.4, 18.9]), np.array([0.98, 1.41])
LOOP = Loop(KP, KD, np.full(2, np.inf), "log")


def held(seconds: float, seed: int, hold: float, step: float) -> ji.Log:
    """MuJoCo C in its own steps [s]; a drive that holds its torque so long [s]; encoders of 2⁻¹⁴ turns."""
    model, rng = mujoco.MjModel.from_xml_string(HEAD), np.random.default_rng(seed)
    model.opt.timestep = step
    data, count, inner = mujoco.MjData(model), 2 * np.pi / 2**14, round(hold / step)
    time = np.arange(0.0, seconds, hold)
    steps = rng.normal(size=(int(seconds) + 1, 2)) * 0.4
    targets = 0.3 * np.sin(2 * np.pi * np.outer(time, [0.9, 1.3])) + steps[time.astype(int)]
    qpos = np.zeros((len(time), 2))
    for k, target in enumerate(targets):
        qpos[k] = np.round(data.qpos / count) * count
        data.qfrc_applied[:] = KP * (target - qpos[k]) - KD * data.qvel
        mujoco.mj_step(model, data, inner)
    return ji.Log(
        time=time, joint_names=("pan", "tilt"), qpos=qpos, qpos_target=targets, kp=KP, kd=KD
    )


def test_what_is_taken_of_a_link_is_what_its_joint_loses_and_the_link_exists():
    model = mujoco.MjModel.from_xml_string(HEAD)
    q, at = np.array([0.4, -0.7]), np.array([0, 1])
    before = mass_matrix(model, q, at)
    lighten(model, model.joint("tilt").id, 2e-3)
    after = mass_matrix(model, q, at)
    assert before[1, 1] - after[1, 1] == pytest.approx(2e-3, rel=1e-9)
    np.testing.assert_allclose((before - after)[0], 0.0, atol=1e-12)
    lighten(model, model.joint("tilt").id, 1.0)
    moments = model.body("head").inertia
    assert np.all(moments > 0)
    assert np.max(moments) < np.sum(moments) - np.max(moments)


def test_a_link_without_a_name_keeps_its_inertia():
    """A file has inertials of bodies by their names."""
    for name, lost in (("head", 1e-3), ("", 0.0)):
        model = mujoco.MjModel.from_xml_string(
            HEAD.replace('name="head"', f'name="{name}"' if name else "")
        )
        before = model.body_inertia.copy()
        numbers = Plant(mujoco.MjSpec.from_string(HEAD), ("pan", "tilt"), LOOP).nominal
        numbers = numbers._replace(armature=np.array([0.0, -1e-3]))
        assert lightened(model, np.array([0, 1]), numbers) == ([name] if name else [])
        assert np.sum(before - model.body_inertia) == pytest.approx(lost, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("hold", "step"), [(2e-3, 1e-4), (1e-3, 5e-4)])
def test_a_head_without_rotors_has_no_gap(hold, step, tmp_path):
    """Its positions are of one step's end, its velocities younger than these by a part of the hold."""
    (tmp_path / "head.xml").write_text(HEAD)
    log, other = held(8.0, 0, hold, step), held(5.0, 1, hold, step)
    found = ji.diagnose(tmp_path / "head.xml", log, test_log=other)
    assert found.verdict is Verdict.NO_GAP, found
    assert not found.effects
