"""What the curl's estimator is told of a diagnosis, against MuJoCo's own forces."""

import equinox as eqx
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.paper import curl
from benchmarks.paper.brain import Brain, Inputs
from benchmarks.paper.curl_causes import informed, knowable, share
from benchmarks.paper.plant import NV, model
from jax_inertia.diagnosis.effects.identified import Identified
from jax_inertia.robots import CORNERS

HOIST = Identified(
    "constant_force", "body", "torso_link", {"force_x": 3.0, "force_y": -2.0, "force_z": 40.0}
)
RUB = Identified(
    "load_friction",
    "joint",
    "left_elbow_y",
    {"coulomb": 0.5, "load_coefficient": 0.1, "of_motor": 1.0},
)
STIFF = Identified("viscous_friction", "joint", "spine_y", {"damping": 0.2})
LOAD = Identified(
    "payload", "body", curl.FOREARM, {"mass": 5.0, "com_x": 0.0, "com_y": 0.0, "com_z": -0.3}
)


@pytest.fixture(scope="module")
def brain() -> Brain:
    return curl.mind()


def test_forearm_and_what_no_torque_shows_are_left_to_the_estimator():
    delay = Identified("time_delay", "global", "global", {"delay": 0.01})
    told, untold = knowable([HOIST, LOAD, RUB, delay])
    assert told == [HOIST, RUB]
    assert untold == [LOAD, delay]


@pytest.mark.slow
def test_known_effects_act_as_in_mujoco(brain):
    plant = model()
    told = informed(brain, [HOIST, RUB, STIFF], ("torso_link",))
    elbow, spine = (plant.joint(n).dofadr[0] for n in ("left_elbow_y", "spine_y"))
    rng = np.random.default_rng(0)
    q, v = plant.key_qpos[0].copy(), rng.normal(size=NV)
    q[7:] += 0.3 * rng.normal(size=NV - 6)
    tau = np.concatenate([np.zeros(6), rng.normal(size=NV - 6)])
    q, v, tau = (jnp.asarray(x) for x in (q, v, tau))
    nothing = jnp.zeros((len(CORNERS), 3))
    x = Inputs(q, v, q, v, 0.0 * v, tau, nothing, jnp.asarray(1), brain.robot.pi[:1], jnp.ones(()))
    before, after = (eqx.filter_jit(b.observation)(x).motion.tau for b in (brain, told))

    data = mujoco.MjData(plant)
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_forward(plant, data)
    body = plant.body("torso_link").id
    expected = np.zeros(NV)
    force = np.array([3.0, -2.0, 40.0])
    mujoco.mj_applyFT(plant, data, force, np.zeros(3), data.xipos[body], body, expected)
    expected[elbow] -= 0.1 * abs(float(tau[elbow])) * np.tanh(float(v[elbow]) / 0.01)
    np.testing.assert_allclose(after - before, expected, atol=1e-9)

    of_robot = told.estimator.robot
    assert float(of_robot.frictionloss[elbow]) == pytest.approx(0.5)
    more = np.asarray(of_robot.damping - brain.robot.damping)
    assert more[spine] == pytest.approx(0.2)
    assert np.count_nonzero(more) == 1
    np.testing.assert_allclose(of_robot.pi, brain.robot.pi, atol=1e-9)


@pytest.mark.slow
def test_estimator_cannot_be_told_of_what_it_has_no_equation_for(brain):
    delay = Identified("time_delay", "global", "global", {"delay": 0.01})
    with pytest.raises(ValueError, match="cannot be told of time_delay"):
        informed(brain, [delay], ())


def test_share_is_what_is_gone_of_all_and_of_what_is_over_the_floor():
    rows = [{"ripple": {"median": m}} for m in (1.0, 0.7, 0.6)]
    assert share(rows, "ripple") == pytest.approx({"of_all": 0.3, "over_floor": 0.75})
