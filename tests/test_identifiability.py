"""What is said of bodies' parameters, against closed forms, Pinocchio and the spread of repeated fits."""

import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from excitation import compiled, log_of
from pinocchio_oracle import PinocchioRobot

import jax_inertia as ji
from jax_inertia.estimation.identifiability import Knowledge, Source, knowledge, of_rows, structure
from jax_inertia.estimation.log_filter import regressors
from jax_inertia.estimation.priors import Load
from jax_inertia.maths.inertial_parameters import PI_NAMES
from jax_inertia.maths.least_squares import weighted_least_squares

NOISE = 0.1
# Two links in a plane. Vertical: of each its moment about its joint and two first moments, the second's mass hung into
# the first's, so 6. Horizontal: gravity shows neither link's weight, and of the first no more than its moment: 4.
PLANAR = """
<mujoco><compiler angle="radian"/><option gravity="0 0 {gravity}"/><worldbody>
  <body name="upper"><inertial pos="0.02 0 -0.2" mass="1.7" diaginertia="0.021 0.024 0.004"/>
    <joint name="shoulder" axis="{axis}"/>
    <body name="lower" pos="{link}"><inertial pos="0.01 0 -0.15" mass="0.9" diaginertia="0.009 0.01 0.002"/>
      <joint name="elbow" axis="{axis}"/></body></body>
</worldbody></mujoco>
"""


def planar(*, vertical: bool) -> ji.Robot:
    axis, link = ("0 1 0", "0 0 -0.45") if vertical else ("0 0 1", "0.45 0 0")
    text = PLANAR.format(gravity=-9.81, axis=axis, link=link)
    return ji.load_model(mujoco.MjModel.from_xml_string(text))


# --- structure ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("vertical", "rank"), [(True, 6), (False, 4)])
def test_a_planar_arm_has_its_known_number_of_base_parameters(vertical, rank):
    seen = structure(planar(vertical=vertical))
    assert seen.rank == len(seen.combinations) == rank
    alone = {n for n, yes in zip(seen.names, seen.determined, strict=True) if yes}
    first, second = ("hx", "hz") if vertical else ("hx", "hy")
    moment = "Iyy" if vertical else "Izz"
    assert alone == {f"lower.{first}", f"lower.{second}", f"lower.{moment}"} | (
        {"upper.hx"} if vertical else set()
    )
    assert {"lower.Ixy", "upper.Ixy"} <= {
        n for n, yes in zip(seen.names, seen.invisible, strict=True) if yes
    }


@pytest.mark.parametrize("name", ["universal", "arm7", "free_body", "humanoid"])
def test_structural_rank_is_that_of_pinocchios_regressor(name, cases):
    case = cases(name)
    bodies = case.chosen if name == "humanoid" else list(case.robot.body_names)
    oracle = PinocchioRobot(case.model)
    index = [case.robot.body_index(b) for b in bodies]
    count = 40 + 20 * len(bodies)
    rows = [
        oracle.regressor(*state)[:, index] for state in zip(*case.states(count, 7), strict=True)
    ]
    y = np.concatenate(rows).reshape(-1, 10 * len(bodies))
    size = np.linalg.norm(y, axis=0)
    s = np.linalg.svd(y / np.where(size > 1e-9 * size.max(), size, 1.0), compute_uv=False)
    assert structure(case.robot, bodies).rank == int(np.sum(s > 1e-9 * s[0]))


# --- a log -------------------------------------------------------------------------------------------------------


@functools.cache
def arm() -> tuple[mujoco.MjModel, ji.Robot]:
    model = compiled("universal")
    return model, ji.load_model(model)


def test_sigma_is_the_spread_of_fits_to_many_noisy_logs():
    """Ridge regression with the prior, 400 draws of torque noise: its spread about the truth is what is said."""
    model, robot = arm()
    prior = Load(0.5)
    log = log_of(model, 120, noise=0.0)
    known = knowledge(robot, log, ["tip"], NOISE, prior=prior)
    y, _, _ = regressors(robot, log, ["tip"])
    flat = y.reshape(-1, 10)
    sigma = np.asarray(prior.sigma_pi())
    rng = np.random.default_rng(3)
    # The truth is drawn from the prior too: that is what a posterior's width is about.
    truth = sigma * rng.normal(size=(400, 10))
    torque = truth @ flat.T + NOISE * rng.normal(size=(400, len(flat)))
    normal = flat.T @ flat / NOISE**2 + np.diag(sigma**-2)
    found = np.linalg.solve(normal, flat.T @ torque.T / NOISE**2).T
    spread = np.std(found - truth, axis=0)
    # The deviation of a standard deviation of 400 draws is 3.5 %; of ten, none is off by four times that.
    np.testing.assert_allclose(spread, known.sigma[0], rtol=0.14)
    assert known.log_det == pytest.approx(
        0.5 * np.linalg.slogdet(normal * np.outer(sigma, sigma))[1], rel=1e-9
    )


@pytest.mark.slow
def test_every_combination_is_as_well_known_as_it_says():
    model, robot = arm()
    bodies, prior = ["gimbal", "tip"], Load(0.5)
    log = log_of(model, 120, noise=0.0)
    known = knowledge(robot, log, bodies, NOISE, prior=prior)
    y, _, _ = regressors(robot, log, bodies)
    flat = y.reshape(-1, 20) / NOISE
    sigma = np.tile(np.asarray(prior.sigma_pi()), 2)
    posterior = np.linalg.inv(flat.T @ flat + np.diag(sigma**-2))
    names = [f"{b}.{p}" for b in bodies for p in PI_NAMES]
    assert 0 < len(known.combinations) < 20
    for one in known.combinations:
        first, *rest = one.text.split(" ")
        w = np.zeros(20)
        w[names.index(first)] = 1.0
        for coefficient, name in zip(rest[::2], rest[1::2], strict=True):
            w[names.index(name)] = float(coefficient)
        assert one.sigma == pytest.approx(np.sqrt(w @ posterior @ w), rel=0.01)
        assert one.prior_sigma == pytest.approx(np.linalg.norm(w * sigma), rel=0.01)
        assert one.sigma < 0.6 * one.prior_sigma
    assert repr(known).count("\n") == 3 + len(known.combinations)


def test_in_a_notebook_names_are_text():
    """A body's name comes from a file: it must not become part of the page."""
    robot = ji.load_model(
        mujoco.MjModel.from_xml_string(
            PLANAR.format(gravity=-9.81, axis="0 1 0", link="0 0 1").replace(
                'name="lower"', 'name="&lt;script&gt;x"'
            )
        )
    )
    page = of_rows(robot, np.eye(20).reshape(10, 2, 20), [0, 1], prior=Load(1.0))._repr_html_()
    assert "&lt;script&gt;x" in page
    assert "<script" not in page
    assert page.count("<td ") == 20


def sources(known: Knowledge) -> dict[str, str]:
    row = {}
    for body, values in zip(known.bodies, known.source, strict=True):
        row |= {f"{body}.{n}": str(s) for n, s in zip(PI_NAMES, values, strict=True)}
    return row


def test_data_prior_and_nothing_by_a_motion_that_is_understood():
    """The vertical planar arm with the elbow alone turning fast: three numbers of the lower link are the data's, what
    acts out of the plane is nobody's, and the upper link, at rest, shows two first moments that the lower's weight
    mixes into."""
    robot = planar(vertical=True)
    rng = np.random.default_rng(0)
    q, v, a = rng.normal(size=(3, 80, 2)) * [[[1.0, 1.0]], [[0.0, 4.0]], [[0.0, 30.0]]]
    q[:, 0] = 0.3
    y = jax.vmap(functools.partial(ji.torque_regressor, robot))(*map(jnp.asarray, (q, v, a)))
    rows = np.asarray(y).reshape(80, 2, 20) / 0.01
    seen = sources(of_rows(robot, rows, ["upper", "lower"], prior=Load(1.0)))
    assert {k for k, s in seen.items() if s == "data"} == {"lower.hx", "lower.hz", "lower.Iyy"}
    assert {k for k, s in seen.items() if s == "prior"} == {"upper.hx", "upper.hz", "lower.m"}
    # Without a prior, the same three, and nothing else is anybody's word.
    flat = sources(of_rows(robot, rows, ["upper", "lower"]))
    assert {k for k, s in flat.items() if s == "data"} == {"lower.hx", "lower.hz", "lower.Iyy"}
    assert "prior" not in flat.values()


def test_without_a_prior_it_is_the_least_squares_report():
    model, robot = arm()
    log = log_of(model, 120, noise=0.0)
    known = knowledge(robot, log, ["tip"], NOISE)
    y, _, _ = regressors(robot, log, ["tip"])
    fit = weighted_least_squares(y.reshape(-1, 10), np.zeros(y.size // 10), NOISE**-2)
    assert known.alone.rank == fit.identifiability.rank
    fixed = np.isfinite(known.sigma[0])
    np.testing.assert_array_equal(fixed, fit.identifiability.determined)
    np.testing.assert_allclose(known.sigma[0][fixed], np.sqrt(np.diag(fit.covariance))[fixed])
    assert np.isnan(known.log_det)


def test_masked_rows_say_nothing_and_bad_input_is_named():
    model, robot = arm()
    log = log_of(model, 40, noise=0.0)
    silent = jax.tree.map(lambda x: x, log)
    silent.motion.valid[:] = False
    known = knowledge(robot, silent, ["tip"], NOISE, prior=Load(1.0))
    assert known.of(Source.NOTHING) == tuple(f"tip.{p}" for p in PI_NAMES)
    assert known.combinations == ()
    assert known.log_det == 0.0
    with pytest.raises(ValueError, match="no moving body named 'tap'"):
        knowledge(robot, log, ["tap"], NOISE)
    with pytest.raises(ValueError, match="must be positive"):
        knowledge(robot, log, ["tip"], 0.0)
