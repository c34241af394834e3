"""What a diagnosis takes for noise, for rest, and for an error of the model: a chain of five joints in MuJoCo C."""

import dataclasses

import mujoco
import numpy as np
import pytest
from chain_log import DAMPING, FRICTION, JOINTS, QPOS, TAU, chain_xml, simulate
from scipy import signal

from jax_inertia import load_model
from jax_inertia.diagnosis.effects.base import Columns
from jax_inertia.diagnosis.effects.registry import NAMES
from jax_inertia.diagnosis.features.band import Band
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.gap import Verdict, diagnose
from jax_inertia.gap.block import Beside, Block, Plain
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.noise import Whitener, stage_of, whitener
from jax_inertia.gap.nuisance import Tolerance, nuisances
from jax_inertia.gap.scales import Learner
from jax_inertia.gap.strain import Left, Strained, strained
from jax_inertia.gap.verdict import with_strain
from jax_inertia.logs.log import TorqueKind
from jax_inertia.signals.creep import softness
from jax_inertia.signals.dry_friction import at_rest
from jax_inertia.signals.outliers import without_outliers
from jax_inertia.signals.sensor_noise import resolution, sensor_noise
from jax_inertia.signals.torque_residual import prepare


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(chain_xml(np.zeros(JOINTS))))


@pytest.fixture(scope="module")
def rubbing():
    return load_model(mujoco.MjModel.from_xml_string(chain_xml(FRICTION)))


@pytest.mark.slow
def test_one_damping_that_is_off_where_all_others_are_right_is_a_gap(robot):
    wrong = DAMPING * np.array([1.0, 1.0, 1.14, 1.0, 1.0])
    found = diagnose(robot, simulate(wrong))
    (effect,) = found.findings
    assert (effect.family, effect.place.name) == ("viscous_friction", "axis3")
    assert effect.parameters["damping"].value == pytest.approx(0.14 * DAMPING[2], rel=0.1)


@pytest.mark.slow
def test_frictions_at_all_joints_stand_beside_what_is_not_in_the_library(robot):
    """No one cause looks like dry friction at five joints; twice the damping, which is barred, is left over."""
    barred = [name for name in NAMES if name != "coulomb_friction"]
    log = simulate(2.0 * DAMPING, friction=2.0 * FRICTION)
    found = diagnose(robot, log, exclude=barred, max_effects=5)
    assert found.verdict is Verdict.PARTLY
    assert {e.place.name for e in found.findings} == {f"axis{k + 1}" for k in range(JOINTS)}
    assert any("damping" in doubt for doubt in found.doubts)


@pytest.mark.slow
def test_a_weight_comes_before_what_is_not_in_the_library():
    """Beside torques of no cause within the motion's band, tolerances twice as wide as stated carried half of it."""
    model = mujoco.MjModel.from_xml_string(chain_xml(np.zeros(JOINTS)))
    model.body_mass[-1] *= 0.8
    model.body_inertia[-1] *= 0.8
    log = simulate()
    noise = np.random.default_rng(8).standard_normal(log.tau.shape)
    band = signal.butter(2, [0.3, 2.5], "bandpass", fs=log.rate, output="sos")
    wander = signal.sosfiltfilt(band, noise, axis=0)
    wander *= 0.02 * np.std(log.tau, axis=0) / np.std(wander, axis=0)
    found = diagnose(load_model(model), dataclasses.replace(log, tau=log.tau + wander))
    assert found.verdict is Verdict.UNKNOWN
    first = found.findings[0]
    assert (first.family, first.place.name) == ("payload", "segment5")


@pytest.mark.slow
def test_a_friction_beyond_its_tolerance_competes_as_an_effect():
    """The only friction of its kind, so that no other tells how good such numbers are."""
    friction = np.array([0.0, 0.0, 0.5, 0.0, 0.0])
    robot = load_model(mujoco.MjModel.from_xml_string(chain_xml(friction)))
    found = diagnose(robot, simulate(friction=1.25 * friction))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.findings
    assert (effect.family, effect.place.name) == ("coulomb_friction", "axis3")
    assert effect.parameters["coulomb"].value == pytest.approx(0.125, rel=0.05)
    # It is known no better than the model's own.
    assert effect.parameters["coulomb"].high - 0.125 > 0.05 * 0.5


@pytest.mark.slow
def test_dampings_that_are_all_off_by_as_much_are_a_model_slightly_off(robot):
    wrong = DAMPING * (1 + 0.07 * np.array([1.0, -1.0, 1.2, -0.8, 1.0]))
    found = diagnose(robot, simulate(wrong))
    assert found.verdict is Verdict.NO_GAP


def learned(robot, log):
    prepared = prepare(robot, log)
    white, _, _ = whitener(prepared, log)
    doubts = nuisances(Context(prepared), Tolerance(), log)
    evidence = Evidence(prepared, white, doubts)
    nothing = np.zeros((len(evidence.y), 0))
    return Learner(evidence, 1.0).beside(nothing, evidence.y), evidence


@pytest.mark.slow
def test_a_number_of_the_model_beyond_its_tolerance_is_named(robot):
    _, right = learned(robot, simulate())
    assert not strained(Left(right, right.y))
    _, off = learned(robot, simulate(DAMPING * np.array([1.0, 1.0, 1.3, 1.0, 1.0])))
    first, *_ = strained(Left(off, off.y))
    assert first.name == "damping of axis3"
    assert abs(first.off - 0.3 / Tolerance().damping) < 4.0 * first.error
    assert first.error < 0.5


@pytest.mark.parametrize(
    ("energy", "verdict"),
    [(0.0, Verdict.EXPLAINED), (20.0, Verdict.PARTLY), (90.0, Verdict.UNKNOWN)],
)
def test_an_explanation_that_leans_on_a_bent_model_is_doubted(energy, verdict):
    strains = [Strained(0, "mass of arm", 6.0, 0.5, energy)] if energy else []
    assert with_strain(Verdict.EXPLAINED, strains, explained=1000.0, allowed=0.0) is verdict
    assert with_strain(Verdict.UNKNOWN, strains, explained=1000.0, allowed=0.0) is Verdict.UNKNOWN
    assert (
        with_strain(Verdict.EXPLAINED, strains, explained=1000.0, allowed=100.0)
        is Verdict.EXPLAINED
    )


def test_what_the_models_own_errors_have_in_the_missing_torque(robot):
    # Dampings 4 to 8 % off: the torque −Δd q̇ that they miss, and none of what a force adds.
    by = DAMPING * np.array([0.05, -0.08, 0.06, 0.04, -0.07])
    _, evidence = learned(robot, simulate(DAMPING + by))
    prepared = evidence.prepared
    true = prepared.finish(-by * np.asarray(prepared.observation.motion.v))
    error = evidence.excused(evidence.y) - true
    assert np.sqrt(np.mean(error**2, axis=0)) == pytest.approx(0.0, abs=0.01)
    assert np.sqrt(np.mean(true**2)) > 0.02


@pytest.mark.slow
def test_an_effect_that_a_tolerance_swallows_is_no_absence_of_a_gap(robot):
    wrong = DAMPING * np.array([1.0, 1.0, 1.4, 1.0, 1.0])
    found = diagnose(robot, simulate(wrong), exclude=["viscous_friction", "friction_drift"])
    assert found.verdict is Verdict.UNKNOWN
    assert any("damping of axis3" in note for note in found.doubts)


def test_scales_tell_which_numbers_of_the_model_are_off(robot):
    right, _ = learned(robot, simulate())
    off, _ = learned(robot, simulate(DAMPING * (1 + 0.1 * np.array([1, -1, 1, -1, 1]))))
    assert right.scales["damping"] <= 0.12
    assert off.scales["damping"] >= 1.4
    assert off.scales["mass"] <= 0.5


def test_the_cost_is_the_marginal_likelihood(robot):
    # Against the dense Gaussian: y ~ N(0, 1 + N Λ² Nᵀ) once the fixed nuisances are charged.
    found, evidence = learned(robot, simulate(seconds=2.0))
    n = evidence.tolerances * np.array([found.scales[k] for k in evidence.kinds])[evidence.kind_of]
    y = evidence.without_tolerances(evidence.y[:, None])[:, 0]
    covariance = np.eye(len(y)) + n @ n.T
    dense = y @ np.linalg.solve(covariance, y) + np.linalg.slogdet(covariance)[1]
    assert found.cost == pytest.approx(dense, rel=1e-9)


def test_rescaled_evidence_is_what_those_scales_give_at_once(robot):
    log = simulate(seconds=3.0)
    prepared = prepare(robot, log)
    white, _, _ = whitener(prepared, log)
    doubts = nuisances(Context(prepared), Tolerance(), log)
    scales = {"mass": 0.1, "centre of mass": 2.0, "inertia": 1.0, "damping": 0.3, "armature": 0.5}
    before = Evidence(prepared, white, doubts)
    after, at_once = before.rescaled(scales), Evidence(prepared, white, doubts, scales)
    np.testing.assert_allclose(after.y, at_once.y, rtol=1e-9, atol=1e-9)
    moved = after.recharging(before)(before.y[:, None])[:, 0]
    np.testing.assert_allclose(moved, at_once.y, rtol=1e-6, atol=1e-6)


def test_products_of_columns_need_no_charging(robot):
    log = simulate(seconds=3.0)
    prepared = prepare(robot, log)
    white, _, _ = whitener(prepared, log)
    context = Context(prepared)
    doubts = nuisances(context, Tolerance(), log)
    scales = {"mass": 0.1, "centre of mass": 2.0, "inertia": 1.0, "damping": 0.3, "armature": 0.5}
    before = Evidence(prepared, white, doubts)
    after, at_once = before.rescaled(scales), Evidence(prepared, white, doubts, scales)
    # A payload's columns lie mostly in what errors of the masses are, a force's do not.
    for values in (-context.regressor[:, :, 2, :], context.force_rows[:, 2]):
        [split] = before.of_many([Columns(values)])
        block = Block(after, (), Plain(before, split))
        expected = at_once.column(Columns(values))
        size = np.abs(expected).max()
        np.testing.assert_allclose(block.columns, expected, atol=1e-8 * size)
        np.testing.assert_allclose(
            block.gram, expected.T @ expected, atol=1e-8 * np.abs(expected.T @ expected).max()
        )
        np.testing.assert_allclose(block.slow, at_once.slow(expected), atol=1e-8 * size)
        left = Beside.of(after, expected[:, :1], after.y)
        moments = left.moments(block)
        gram, cross = moments.gram, moments.cross
        free = left.free(expected)
        np.testing.assert_allclose(gram[1:, 1:], (free.T @ free)[1:, 1:], atol=1e-8 * size**2)
        np.testing.assert_allclose(cross[1:], free[:, 1:].T @ after.y, atol=1e-7 * size * 1e2)


def test_what_is_over_in_a_moment_is_charged_like_what_lasts(rubbing):
    log = simulate(friction=FRICTION, stops=True)
    prepared = prepare(rubbing, log)
    white, _, _ = whitener(prepared, log)
    apart = nuisances(Context(prepared), Tolerance(), log)
    assert apart.brief, "joints of this log set off after rests"
    together = dataclasses.replace(apart, fixed=[*apart.fixed, *apart.brief], brief=[])
    one, other = (Evidence(prepared, white, x) for x in (apart, together))
    # M^{1/2} may be any root of M: what counts is what it makes of products.
    raw = np.stack([one.raw[:, 0], np.sin(np.arange(one.rows))], axis=1)
    charged, expected = one.charge(raw), other.charge(raw)
    scale = np.sqrt(np.diagonal(expected.T @ expected))
    np.testing.assert_allclose(
        charged.T @ charged / np.outer(scale, scale),
        expected.T @ expected / np.outer(scale, scale),
        atol=1e-7,
    )
    excused, as_one = (e.excused(e.y) for e in (one, other))
    np.testing.assert_allclose(excused, as_one, atol=1e-6 * np.abs(as_one).max())


def test_known_friction_at_rest_is_not_taken_for_noise(robot, rubbing):
    log = simulate(friction=FRICTION, stops=True)
    with_friction, _, _ = whitener(prepare(rubbing, log), log)
    without, _, _ = whitener(prepare(robot, log), log)
    np.testing.assert_allclose(with_friction.sigma, without.sigma, rtol=0.1)


@pytest.mark.slow
def test_a_robot_that_stops_with_its_known_friction_has_no_gap(rubbing):
    found = diagnose(rubbing, simulate(friction=FRICTION, stops=True))
    assert found.verdict is Verdict.NO_GAP


def test_bristles_may_straighten_while_joints_stand():
    """A joint sets off from wherever its friction has come to; without that the misfit is twelve times the noise's."""
    friction = 4.0 * FRICTION
    robot = load_model(mujoco.MjModel.from_xml_string(chain_xml(friction)))
    log = simulate(friction=friction, stops=True, reach=2e-3, creep=0.1)
    prepared = prepare(robot, log)
    white, replicas, again = whitener(prepared, log)
    context = Context(prepared, Band.of(prepared, again))
    evidence = Evidence(prepared, white, nuisances(context, Tolerance(), log))
    assert evidence.y @ evidence.y < 4.0 * evidence.noise_energy(replicas)


def test_standing_still_is_refused_in_one_line(robot):
    log = simulate(seconds=3.0)
    still = np.tile(np.asarray(log.qpos)[:1], (len(log.time), 1))
    noise = QPOS * np.random.default_rng(0).standard_normal(still.shape)
    with pytest.raises(ValueError, match="stands still"):
        diagnose(robot, dataclasses.replace(log, qpos=still + noise))


@pytest.mark.slow
def test_a_torque_sensors_sample_may_be_of_the_period_that_follows(robot):
    log = dataclasses.replace(simulate(seconds=5.0), tau_kind=TorqueKind.SENSOR)
    assert diagnose(robot, log).verdict is Verdict.NO_GAP


@pytest.mark.slow
def test_noise_of_a_torque_sensor_is_no_lag(robot):
    # A lagged torque is a smoother one, and so has less of its own noise.
    log = simulate(seconds=5.0)
    noise = 10 * TAU * np.random.default_rng(3).standard_normal(log.tau.shape)
    loud = dataclasses.replace(log, tau=log.tau + noise, sigma_tau=10 * TAU)
    assert diagnose(robot, loud).verdict is Verdict.NO_GAP


@pytest.mark.parametrize("draw", ["normal", "laplace"])
def test_unstated_noise_is_measured_with_its_tails_and_without_impacts(draw):
    rng = np.random.default_rng(0)
    noise = {
        "normal": lambda: rng.normal(size=(4000, 3)),
        "laplace": lambda: rng.laplace(scale=np.sqrt(0.5), size=(4000, 3)),
    }[draw]()
    x = 0.01 * noise + np.sin(np.linspace(0, 30, 4000))[:, None]
    x[1000:] += 3.0
    assert sensor_noise(x, None) == pytest.approx(0.01 * np.ones(3), rel=0.05)


@pytest.mark.parametrize("fastest", [0.3, 30.0])
def test_a_coarse_encoder_is_as_noisy_as_its_steps(fastest):
    """Slow motion repeats most samples, so that their third differences say nothing; fast motion dithers itself."""
    step = 1e-3
    x = np.sin(np.linspace(0, fastest, 4000) ** 2 / fastest)[:, None]
    coarse = step * np.round(x / step)
    assert sensor_noise(coarse, None) == pytest.approx([step / np.sqrt(12)], rel=0.1)
    rng = np.random.default_rng(0)
    assert resolution(x[:, 0]) == 0.0
    assert resolution(x[:, 0] + 1e-4 * rng.normal(size=4000)) == 0.0
    assert resolution(coarse[:, 0]) == pytest.approx(step)


def test_rows_that_seldom_move_together_are_whitened_all_the_same():
    rng = np.random.default_rng(3)
    used = rng.random((300, 3)) < 0.4
    used = np.repeat(used, 5, axis=0)
    # Each pair is seen alone, and says something that the other two pairs contradict.
    noise = np.zeros((1, 1500, 3))
    pairs = rng.standard_normal((3, 1500))
    for k, (i, j) in enumerate([(0, 1), (1, 2), (0, 2)]):
        alone = used[:, i] & used[:, j] & ~used[:, 3 - i - j]
        noise[0, alone, i] = pairs[k, alone]
        noise[0, alone, j] = pairs[k, alone] * (-1 if k == 2 else 1)
    stage = stage_of(noise, used, quietest=1.0)
    assert np.linalg.eigvalsh(stage.covariance).min() > 0
    white = Whitener(np.ones(3), (stage,)).over(used)(noise[0])
    assert np.isfinite(white).all()


def test_at_rest_is_slow_for_long():
    v = np.full((500, 3), 0.5)
    v[100:200, 0] = 0.001  # 0.4 s: rest
    v[100:105, 1] = 0.001  # 20 ms: a reversal
    rest = at_rest(v, 250.0)
    assert rest[110:190, 0].all()
    assert not rest[:, 1:].any()


def test_a_joint_that_creeps_by_its_own_friction_is_at_rest():
    """Held by half its friction in MuJoCo C it creeps at half the speed that `softness` tells."""
    friction = np.full(JOINTS, 1.0)
    model = mujoco.MjModel.from_xml_string(chain_xml(friction))
    data = mujoco.MjData(model)
    for _ in range(1000):
        data.qfrc_applied[:] = data.qfrc_bias + 0.5 * friction
        mujoco.mj_step(model, data)
    creeping = friction * softness(load_model(model))
    np.testing.assert_allclose(data.qvel, 0.5 * creeping, rtol=0.1)
    v = np.tile(data.qvel, (200, 1))
    assert not at_rest(v, 250.0)[:, -1].any()
    assert at_rest(v, 250.0, creeping)[10:-10].all()


def test_repeated_and_struck_samples_are_replaced_and_the_rest_is_left():
    t = np.arange(1500) / 250.0
    rng = np.random.default_rng(4)
    clean = np.stack([np.sin(3 * t), 0.4 * np.cos(7 * t), 0.2 * t], axis=1)
    noisy = clean + QPOS * rng.standard_normal(clean.shape)
    bad = noisy.copy()
    for k in (120, 480, 900, 1201):
        bad[k, 0] = bad[k - 1, 0]
    # Two close together: neither fits with the other as it is.
    for k in (1000, 1002, 1100, 1101):
        bad[k, 0] = bad[k - 1, 0]
    bad[700, 1] += 0.01
    mended = without_outliers(bad)
    assert np.abs(mended - clean).max() < 6 * QPOS
    changed = np.flatnonzero(np.any(mended != bad, axis=1))
    assert set(changed) <= {120, 480, 700, 900, 1000, 1002, 1100, 1101, 1201}
    assert {120, 900, 700} <= set(changed)


def test_an_impact_and_a_coarse_encoder_are_no_outliers():
    t = np.arange(1500) / 250.0
    rng = np.random.default_rng(5)
    corner = 0.5 * np.abs(t - 3.0) + QPOS * rng.standard_normal(t.shape)
    coarse = np.round(np.sin(2 * t) / 1e-3) * 1e-3
    both = np.stack([corner, coarse], axis=1)
    np.testing.assert_array_equal(without_outliers(both), both)
