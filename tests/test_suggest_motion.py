"""A suggested motion against MuJoCo C: its limits, its derivatives, and what a log of it is really worth."""

import csv
import functools

import equinox as eqx
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from excitation import torques
from schemas import validated

import jax_inertia as ji
from jax_inertia.cli.main import main
from jax_inertia.estimation.priors import Load
from jax_inertia.estimation.suggest.excitation import (
    SAMPLE_RATE,
    Series,
    Suggestion,
    suggest_motion,
)
from jax_inertia.estimation.suggest.motion_limits import Limits, collision_free
from jax_inertia.maths.inertial_parameters import PI_NAMES
from jax_inertia.model.load import body_pi

PRIOR, NOISE, PERIOD = Load(2.0), 0.5, 6.0
# Three hinges, armature, damping and a spring, so that what the motors give is not the rigid body's torque alone.
ARM = """
<mujoco><compiler angle="radian" autolimits="true"/><worldbody>
  {wall}
  <body name="upper" pos="0 0 1"><inertial pos="0 0 -0.2" mass="2" diaginertia="0.03 0.03 0.004"/>
    <joint name="yaw" axis="0 0 1" range="-2 2" armature="0.1" damping="0.6"/>
    <body name="fore" pos="0 0.05 -0.4"><inertial pos="0 0 -0.15" mass="1.1" diaginertia="0.01 0.01 0.002"/>
      <joint name="pitch" axis="0 1 0" range="-1.2 1.8" armature="0.05" stiffness="2" springref="0.3"/>
      <body name="hand" pos="0 0 -0.3"><inertial pos="0.02 0 -0.06" mass="0.6" diaginertia="0.002 0.003 0.001"/>
        <joint name="roll" axis="1 0 0.2"/>
        <geom type="sphere" size="0.04" mass="0"/>
  </body></body></body>
</worldbody><actuator>
  <motor joint="yaw" ctrlrange="-9 9"/><motor joint="pitch" gear="10" ctrlrange="-0.7 0.8"/>
  <motor joint="roll" ctrlrange="-40 40" forcerange="-4 4"/>
</actuator></mujoco>
"""


def compiled(wall: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(ARM.format(wall=wall))


@functools.cache
def suggested() -> tuple[mujoco.MjModel, ji.Robot, Limits, Suggestion]:
    model = compiled()
    robot, limits = ji.load_model(model), Limits.of(model, velocity=2.0)
    options = {"prior": PRIOR, "noise": NOISE, "period": PERIOD, "starts": 2, "steps": 80}
    return model, robot, limits, suggest_motion(robot, ["hand"], limits, rate=500.0, **options)


def test_limits_come_from_the_model():
    limits = Limits.of(compiled(), velocity=2.0, swing=1.0, share=0.5)
    np.testing.assert_allclose(limits.low, [-1.0, 0.3 - 0.75, -1.0])
    np.testing.assert_allclose(limits.high, [1.0, 0.3 + 0.75, 1.0])
    np.testing.assert_allclose(limits.torque, [4.5, 3.5, 2.0])
    np.testing.assert_allclose(limits.velocity, 2.0)


@pytest.mark.slow
def test_limits_hold_in_mujocos_inverse_dynamics_and_some_bind():
    model, _, limits, found = suggested()
    needed = torques(model, found.q, found.v, found.a)
    np.testing.assert_allclose(found.tau, needed, atol=1e-9)
    assert np.all(found.q >= limits.low)
    assert np.all(found.q <= limits.high)
    assert np.all(np.abs(found.v) <= limits.velocity)
    assert np.all(np.abs(needed) <= limits.torque)
    shares = [np.abs(found.v) / limits.velocity, np.abs(needed) / limits.torque]
    assert max(np.max(x) for x in shares) > 0.9


@pytest.mark.slow
def test_it_is_one_smooth_motion_from_rest_to_rest():
    _, _, _, found = suggested()
    step = found.time[1] - found.time[0]
    middle = slice(1, -1)
    for lower, higher in ((found.q, found.v), (found.v, found.a)):
        np.testing.assert_allclose(
            np.gradient(lower, step, axis=0)[middle], higher[middle], atol=2e-3
        )
    np.testing.assert_allclose(found.v[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.a[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.q[0], found.q[-1], atol=1e-9)
    assert found.time[-1] == pytest.approx(PERIOD)


def random_motions(robot: ji.Robot, limits: Limits, model: mujoco.MjModel, count: int):
    """Random series of the same kind, each as large as the limits allow in MuJoCo's inverse dynamics."""
    rng = np.random.default_rng(11)
    time = np.arange(0.0, PERIOD, 1.0 / SAMPLE_RATE)
    k = np.arange(1, 7)
    for _ in range(count):
        sine, cosine = rng.normal(size=(2, robot.nv, 6))
        sine -= sine.mean(axis=1, keepdims=True)
        cosine -= (cosine @ k)[:, None] * k / (k @ k)
        middle = 0.5 * (limits.low + limits.high)
        series = Series(jnp.asarray(PERIOD), *map(jnp.asarray, (middle, sine, cosine)))
        for share in 3.0 * 0.93 ** np.arange(100):
            q, v, a = (np.asarray(x) for x in series.scaled(float(share)).at(jnp.asarray(time)))
            if not limits.broken(q, v, torques(model, q, v, a), robot.joint_names):
                yield q, v, a
                break


@eqx.filter_jit
def rows_of(robot: ji.Robot, q, v, a):
    import jax

    return jax.vmap(lambda *x: ji.torque_regressor(robot, *x, bodies=["hand"]))(q, v, a)


def information(robot: ji.Robot, q, v, a) -> np.ndarray:
    """1 + Lᵀ Λ L at 20 Hz."""
    y = np.asarray(rows_of(robot, *map(jnp.asarray, (q, v, a)))).reshape(-1, 10)
    scaled = y * np.asarray(PRIOR.sigma_pi()) / NOISE
    return np.eye(10) + scaled.T @ scaled


@pytest.mark.slow
def test_it_tells_more_than_any_of_twenty_random_motions():
    """By 4 nats at least over the best, 6 over the median: σ smaller by a half on (geometric) average."""
    model, robot, limits, found = suggested()
    pick = slice(0, -1, round(500.0 / SAMPLE_RATE))
    own = information(robot, found.q[pick], found.v[pick], found.a[pick])
    value = 0.5 * np.linalg.slogdet(own)[1]
    assert found.log_det == pytest.approx(value, rel=1e-6)
    others = [
        0.5 * np.linalg.slogdet(information(robot, *x))[1]
        for x in random_motions(robot, limits, model, 20)
    ]
    assert value > max(others) + 4.0
    assert value > np.median(others) + 6.0
    assert np.median(others) - 6.0 < found.random.log_det < max(others) + 3.0


@pytest.mark.slow
def test_what_it_promises_is_what_a_noisy_log_gives():
    """Torques of MuJoCo C with a load drawn from the prior, 300 times, ridge regression: the spread of its errors."""
    model, robot, _, found = suggested()
    pick = slice(0, -1, round(500.0 / SAMPLE_RATE))
    q, v, a = found.q[pick], found.v[pick], found.a[pick]
    sigma = np.asarray(PRIOR.sigma_pi())
    # What MuJoCo adds for each unit of each parameter is Y itself: checked once with a body that exists.
    heavy = compiled()
    heavy.body_mass[heavy.body("hand").id] *= 2.5
    heavy.body_inertia[heavy.body("hand").id] *= 1.7
    change = [body_pi(x, x.body("hand").id) for x in (heavy, model)]
    y = np.asarray(rows_of(robot, *map(jnp.asarray, (q, v, a)))).reshape(-1, 10)
    more = torques(heavy, q, v, a) - torques(model, q, v, a)
    np.testing.assert_allclose(y @ (change[0] - change[1]), more.ravel(), atol=1e-9)

    rng = np.random.default_rng(5)
    truth = sigma * rng.normal(size=(300, 10))
    seen = truth @ y.T + NOISE * rng.normal(size=(300, len(y)))
    normal = y.T @ y / NOISE**2 + np.diag(sigma**-2)
    errors = np.linalg.solve(normal, y.T @ seen.T / NOISE**2).T - truth
    np.testing.assert_allclose(np.std(errors, axis=0), found.known.sigma[0], rtol=0.16)


@pytest.mark.slow
def test_a_wall_is_kept_clear_of():
    wall = '<geom name="wall" type="box" pos="-0.26 0 0.5" size="0.02 1 1"/>'
    model = compiled(wall)
    robot, limits = ji.load_model(model), Limits.of(model, velocity=2.0)
    clear = collision_free(model)
    free = suggested()[3]
    assert not np.all(clear(free.q))
    options = {"prior": PRIOR, "noise": NOISE, "period": PERIOD, "starts": 1, "steps": 30}
    found = suggest_motion(robot, ["hand"], limits, clear=clear, **options)
    assert np.all(clear(found.q))
    assert np.ptp(found.q, axis=0).min() > 0.05


def test_bad_requests_are_one_line():
    _, robot, limits, _ = suggested()
    floating = ji.load_model(
        mujoco.MjModel.from_xml_string(
            '<mujoco><worldbody><body name="b"><freejoint/><geom size="1"/></body></worldbody></mujoco>'
        )
    )
    with pytest.raises(ValueError, match="fix the base"):
        suggest_motion(floating, ["b"], limits)
    with pytest.raises(ValueError, match="no moving body named 'hnad'"):
        suggest_motion(robot, ["hnad"], limits)
    with pytest.raises(ValueError, match="'yaw' has a range that is empty"):
        suggest_motion(robot, ["hand"], eqx.tree_at(lambda x: x.low, limits, limits.high))
    with pytest.raises(ValueError, match=r"limits\.torque is .* expected 3"):
        suggest_motion(robot, ["hand"], eqx.tree_at(lambda x: x.torque, limits, np.ones(2)))
    weak = eqx.tree_at(lambda x: x.torque, limits, np.array([9.0, 0.01, 4.0]))
    with pytest.raises(ValueError, match="pitch leaves its torque"):
        suggest_motion(robot, ["hand"], weak, period=PERIOD, starts=1, steps=2)


# --- the command -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_command_writes_a_motion_to_play(tmp_path, capsys):
    (tmp_path / "arm.xml").write_text(ARM.format(wall=""))
    out = tmp_path / "deep" / "motion.csv"
    # As long as the motion above, so that nothing is compiled anew.
    arguments = [tmp_path / "arm.xml", "--bodies", "hand", "--out", out, "--period", f"{PERIOD:g}"]
    arguments += ["--range", "roll", "-0.5", "0.7", "--velocity", "1", "1", "2", "--rate", "50"]
    assert main(["suggest-motion", *map(str, arguments), "--json"]) == 0
    told = validated("suggest-motion", capsys.readouterr().out)
    assert told["nats"]["suggested"] > told["nats"]["random"]
    assert list(told["sigma"]["suggested"]) == [f"hand.{name}" for name in PI_NAMES]
    with open(out, newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 301
    roll = np.array([float(row["qpos.roll"]) for row in rows])
    assert -0.5 <= roll.min() < roll.max() <= 0.7
    assert roll[0] == pytest.approx(told["start"]["roll"], abs=1e-6)
    assert max(abs(float(row["qvel.yaw"])) for row in rows) <= 1.0
    assert {p.name for p in out.parent.iterdir()} == {"motion.csv", "motion.png"}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--bodies", "hnd"], "no moving body named 'hnd'"),
        (["--bodies", "hand", "--out", "motion.npz"], "written as .csv"),
        (["--bodies", "hand", "--velocity", "1", "2"], "2 values of --velocity for 3 joints"),
        (["--bodies", "hand", "--range", "elbow", "0", "1"], "no joint named 'elbow'"),
        (["--bodies", "hand", "--range", "roll", "0", "x"], "two numbers"),
        (["--bodies", "hand", "--period", "0"], "--period is 0"),
    ],
)
def test_command_refuses_in_one_line(tmp_path, capsys, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.xml").write_text(ARM.format(wall=""))
    assert main(["suggest-motion", "arm.xml", *options]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert words in err
    assert [p.name for p in tmp_path.iterdir()] == ["arm.xml"]
