"""Friction at rest: a real one holds a joint short of its target, MuJoCo's own lets it creep; logs tell which."""

import mujoco
import numpy as np
import pytest

from jax_inertia.logs.log import Log
from jax_inertia.replay import pipeline
from jax_inertia.replay.corrected import corrected

ARM = """<mujoco><option timestep="0.0005" integrator="implicitfast"/><worldbody><body>
<joint name="shoulder" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.03" mass="1.2"/><body pos="0.25 0 0">
<joint name="elbow" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.025" mass="0.6"/>
</body></body></worldbody></mujoco>"""
KP, KD = np.array([40.0, 20.0]), np.array([2.0, 0.5])
ELBOW_KP, FRICTION = 0.85, np.array([0.5, 0.3])
"""Of what is said, and of what the model has none [N m]."""
HARD = [0.9999, 0.9999, 0.001, 0.5, 2.0]


def log_of(seed: int, seconds: float, solimp: list[float] | None) -> Log:
    """By MuJoCo C, a loop of 1 kHz: from pose to pose, with rests of a second and more."""
    model = mujoco.MjModel.from_xml_string(ARM)
    model.dof_frictionloss[:] = FRICTION
    if solimp:
        model.dof_solimp[:] = solimp
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    pose = data.qpos.copy()
    targets = []
    while len(targets) < seconds * 100:
        goal = rng.uniform(-0.9, 0.9, 2)
        s = np.linspace(0.0, 1.0, 50)[:, None]
        targets += [
            *(pose + (goal - pose) * s * s * (3 - 2 * s)),
            *[goal] * int(rng.uniform(60, 140)),
        ]
        pose = goal
    rows = []
    for k in range(int(seconds * 2000)):
        if k % 2 == 0:
            miss = targets[k // 20] - data.qpos
            data.qfrc_applied[:] = KP * [1.0, ELBOW_KP] * miss - KD * data.qvel
        if k % 20 == 0:
            rows.append((k * 5e-4, *data.qpos, *targets[k // 20]))
        mujoco.mj_step(model, data)
    x = np.array(rows)
    return Log(
        time=x[:, 0],
        joint_names=("shoulder", "elbow"),
        qpos=x[:, 1:3] + 2e-5 * rng.normal(size=(len(x), 2)),
        qpos_target=x[:, 3:],
        kp=KP,
        kd=KD,
    )


# Three minutes of processor: a quarter of the default run.
@pytest.mark.slow
@pytest.mark.parametrize("solimp", [HARD, None])
def test_logs_tell_whether_friction_holds_or_creeps(solimp):
    def spec():
        return mujoco.MjSpec.from_string(ARM)

    logs = log_of(0, 20.0, solimp), log_of(1, 10.0, solimp)
    found = pipeline.diagnose([logs[0]], spec, test_log=logs[1])
    assert found.holds is (solimp is not None)
    kept = {(e.family, e.name) for e in found.effects}
    assert ("kp_scale", "elbow") in kept
    x = found.numbers
    np.testing.assert_allclose(x.kp / KP, [1.0, ELBOW_KP], rtol=0.02)
    np.testing.assert_allclose(found.correction.friction, FRICTION, rtol=0.1)
    written = spec()
    corrected(written, found.correction)
    assert bool(written.joint("elbow").solimp_friction[0] > 0.99) is found.holds
