"""Masks, resampling, low-pass, generalised coordinates, and differences that stay aligned."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jax_inertia.logs.log import Log, LogError
from jax_inertia.maths.finite_difference import centred_slopes
from jax_inertia.model.load import load_model
from jax_inertia.signals.differences import Differentiator, aligned_differences, central_differences
from jax_inertia.signals.filtering import gap_limit, low_pass, mask, resample
from jax_inertia.signals.generalised_motion import Motion, body_rates, generalised

OMEGA = 2 * np.pi * 1.5


def sine_log(time: np.ndarray, joints=("a", "b"), **changes) -> Log:
    """Every joint a sine of its own phase; τ = q̈, so that the truth is known at any time."""
    phase = OMEGA * time[:, None] + np.arange(len(joints))
    fields = {
        "time": time,
        "joint_names": joints,
        "qpos": np.sin(phase),
        "qvel": OMEGA * np.cos(phase),
        "tau": -(OMEGA**2) * np.sin(phase),
        "sigma_tau": np.ones(len(joints)),
    }
    return Log(**(fields | changes))


def sine_motion(time: np.ndarray) -> Motion:
    log = sine_log(time)
    return Motion(
        time=time, q=log.qpos, v=log.qvel, tau=log.tau, valid=np.ones(log.tau.shape, dtype=bool)
    )


def jittered(samples: int, period: float, amount: float, seed=0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return period * (np.arange(samples) + amount * rng.uniform(-0.5, 0.5, samples))


# Masks


def test_mask_bridges_by_lines_and_marks_each_row_by_what_it_needs():
    time = np.arange(40) * 0.01
    log = sine_log(time)
    qpos, tau = log.qpos.copy(), log.tau.copy()
    qpos[10, 0], tau[20, 1] = np.nan, np.inf
    masked = mask(sine_log(time, qpos=qpos, tau=tau))
    assert masked.log.qpos[10, 0] == pytest.approx((qpos[9, 0] + qpos[11, 0]) / 2)
    assert masked.log.tau[20, 1] == pytest.approx((tau[19, 1] + tau[21, 1]) / 2)
    expected = np.ones((40, 2), dtype=bool)
    expected[10] = False
    expected[20, 1] = False
    np.testing.assert_array_equal(masked.rows, expected)


def test_mask_marks_what_follows_a_gap_and_an_empty_channel():
    time = np.arange(40) * 0.01
    time[10:] += 0.015
    time[25:] += 0.05
    tau = sine_log(time).tau.copy()
    tau[:, 0] = np.nan
    masked = mask(sine_log(time, tau=tau))
    assert gap_limit(time) == pytest.approx(0.03)
    assert gap_limit(0.1 * time) == pytest.approx(0.01)
    assert not masked.motion_valid[25]
    assert masked.motion_valid.sum() == 39
    assert not masked.torque_valid[:, 0].any()
    assert np.isfinite(masked.log.tau).all()


# Resampling


@pytest.mark.parametrize("rate", [50.0, 100.0, 173.0, 250.0])
def test_resample_keeps_a_slow_sine_through_jitter(rate):
    time = jittered(600, 0.01, 0.6)
    masked = resample(sine_log(time), rate)
    np.testing.assert_allclose(np.diff(masked.log.time), 1 / rate, rtol=1e-9)
    truth = sine_log(masked.log.time)
    inner = slice(10, -10)
    for name in ("qpos", "qvel", "tau"):
        expected = getattr(truth, name)
        error = np.abs(getattr(masked.log, name) - expected)[inner].max()
        assert error < 0.015 * np.abs(expected).max()
    assert masked.rows[inner].all()


def test_resample_is_exact_for_parabolas_at_any_stamps():
    time = jittered(200, 0.01, 0.9, seed=3)
    parabola = (1 + 2 * time - 3 * time**2)[:, None]
    log = Log(time=time, joint_names=("a",), qpos=parabola, tau=parabola)
    masked = resample(log, 130.0)
    t = masked.log.time
    ok = masked.rows[:, 0]
    assert ok.mean() > 0.9
    np.testing.assert_allclose(masked.log.qpos[ok, 0], (1 + 2 * t - 3 * t**2)[ok], atol=1e-9)


def test_resample_scales_sigma_by_what_it_does_to_white_noise():
    rng = np.random.default_rng(1)
    noise = rng.normal(size=(20000, 1))
    log = Log(
        time=np.arange(20000) / 1000,
        joint_names=("a",),
        qpos=noise,
        tau=noise,
        sigma_tau=np.ones(1),
    )
    for rate in (250.0, 1000.0, 1700.0):
        masked = resample(log, rate)
        assert masked.log.sigma_tau[0] == pytest.approx(np.std(masked.log.tau), rel=0.03)


def test_resample_downwards_does_not_alias():
    time = np.arange(4000) / 1000
    fast = np.sin(2 * np.pi * 230 * time)[:, None]
    log = Log(time=time, joint_names=("a",), qpos=fast, tau=fast)
    kept = np.std(resample(log, 250.0).log.tau) / np.std(fast)
    assert kept < 0.15
    assert np.std(np.interp(np.arange(900) / 250, time, fast[:, 0])) > 0.9 * np.std(fast)


def test_validity_survives_resampling():
    time = np.arange(300) * 0.01
    tau = sine_log(time).tau.copy()
    tau[100:120, 1] = np.nan
    time = np.where(time > 2.0, time + 0.3, time)
    masked = resample(sine_log(time, tau=tau), 200.0)
    t = masked.log.time
    assert not masked.rows[(t > 0.99) & (t < 1.2), 1].any()
    assert not masked.rows[(t > 2.0) & (t < 2.3)].any()
    clear = ((t > 0.1) & (t < 0.96)) | ((t > 1.24) & (t < 1.97)) | ((t > 2.35) & (t < 3.2))
    assert masked.rows[clear].all()
    assert masked.rows[(t > 0.1) & (t < 1.97), 0].all()
    assert np.isfinite(masked.log.tau).all()


def test_resample_refuses_a_rate_that_leaves_nothing():
    with pytest.raises(ValueError, match="leaves fewer than two samples"):
        resample(sine_log(np.arange(20) * 0.01), 3)


def test_resample_refuses_what_would_fill_the_memory():
    time = np.arange(20) * 0.01
    time[-1] = 1e9
    with pytest.raises(ValueError, match="over 100 times the log's 20 samples"):
        resample(sine_log(time), 250)
    bunched = np.concatenate([np.linspace(0, 1e-6, 20000), np.linspace(1, 5000, 8000)])
    with pytest.raises(ValueError, match="too many to weigh"):
        resample(sine_log(bunched), 1)


# Low-pass


def test_low_pass_has_no_phase_and_halves_the_amplitude_at_its_cutoff():
    time = np.arange(4000) / 500
    wave = np.sin(2 * np.pi * 20 * time)[:, None]
    log = Log(time=time, joint_names=("a",), qpos=wave, tau=3 * wave)
    masked = low_pass(log, 20)
    inner = slice(500, -500)
    np.testing.assert_allclose(masked.log.qpos[inner], 0.5 * wave[inner], atol=1e-6)
    np.testing.assert_allclose(masked.log.tau[inner], 1.5 * wave[inner], atol=3e-6)


def test_low_pass_scales_sigma_and_spreads_marks():
    rng = np.random.default_rng(2)
    noise = rng.normal(size=(20000, 1))
    time = np.arange(20000) / 500
    log = Log(
        time=time, joint_names=("a",), qpos=noise, tau=noise.copy(), sigma_tau=np.full(1, 2.0)
    )
    masked = low_pass(log, 40)
    assert masked.log.sigma_tau[0] == pytest.approx(2 * np.std(masked.log.tau), rel=0.05)
    holed = noise.copy()
    holed[10000:10040] = np.nan
    holed[15000] = np.nan
    marked = low_pass(dataclasses.replace(log, tau=holed), 40)
    bridged = mask(dataclasses.replace(log, tau=holed)).log.tau
    off = np.abs(bridged - noise).max()
    error = np.abs(marked.log.tau - masked.log.tau)[:, 0]
    # A tenth of the weight may lie on what was bridged; |weights| sum to little more than one.
    assert error[marked.rows[:, 0]].max() < 0.15 * off
    assert not marked.rows[10000:10040].any()
    assert 40 < np.sum(~marked.rows) < 60


def test_low_pass_refuses_jitter_and_impossible_cutoffs():
    with pytest.raises(ValueError, match="resample first"):
        low_pass(sine_log(jittered(100, 0.01, 0.5)), 10)
    with pytest.raises(ValueError, match="between 0 and 50 Hz"):
        low_pass(sine_log(np.arange(100) * 0.01), 50)


# Generalised coordinates

WALKER = """<mujoco><worldbody><body name="base"><freejoint name="root"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<body name="leg"><joint name="hip" axis="0 1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<body name="foot"><joint name="ankle" type="ball"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body>
<body name="arm"><joint name="lift" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body></worldbody></mujoco>"""
TURN = np.sqrt(0.5)


@pytest.fixture(scope="module")
def walker():
    return load_model(mujoco.MjModel.from_xml_string(WALKER))


def tumbling(time: np.ndarray, **changes) -> Log:
    """A base that turns about a fixed body axis at a rate that varies, and moves on a circle."""
    angle = np.sin(3 * time)
    rate = 3 * np.cos(3 * time)
    axis = np.array([2.0, -1.0, 2.0]) / 3
    fields = {
        "joint_names": ("lift", "hip"),
        "base_pos": np.stack([np.cos(time), np.sin(time), 0 * time], axis=1),
        "base_quat": np.hstack([np.cos(angle / 2)[:, None], np.sin(angle / 2)[:, None] * axis]),
        "base_linvel": np.stack([-np.sin(time), np.cos(time), 0 * time], axis=1),
        "base_angvel": rate[:, None] * axis,
    }
    return sine_log(time, **(fields | changes))


def test_generalised_puts_names_where_the_model_has_them(walker):
    time = np.arange(200) * 0.01
    log = tumbling(time)
    motion = generalised(log, walker, fixed={"ankle": (TURN, 0.0, TURN, 0.0)})
    np.testing.assert_allclose(motion.q[:, :3], log.base_pos)
    np.testing.assert_allclose(motion.q[:, 3:7], log.base_quat)
    np.testing.assert_allclose(motion.v[:, :3], log.base_linvel)
    np.testing.assert_allclose(motion.v[:, 3:6], log.base_angvel)
    hip, ankle, lift = (walker.joint_names.index(n) for n in ("hip", "ankle", "lift"))
    for joint, column in ((hip, 1), (lift, 0)):
        np.testing.assert_array_equal(motion.q[:, walker.joint_qposadr[joint]], log.qpos[:, column])
        dof = walker.joint_dofadr[joint]
        np.testing.assert_array_equal(motion.v[:, dof], log.qvel[:, column])
        np.testing.assert_array_equal(motion.tau[:, dof], log.tau[:, column])
    at = walker.joint_qposadr[ankle]
    np.testing.assert_allclose(motion.q[:, at : at + 4], [[TURN, 0, TURN, 0]] * 200)
    np.testing.assert_array_equal(motion.tau[:, :6], 0)
    unmeasured = np.flatnonzero(~motion.valid.all(axis=0))
    np.testing.assert_array_equal(unmeasured, walker.joint_dofadr[ankle] + np.arange(3))
    assert sorted(motion.quaternions) == [3, at]


def test_missing_velocities_come_from_positions_to_second_order(walker):
    fixed = {"ankle": (1.0, 0.0, 0.0, 0.0)}
    worst = []
    for samples in (200, 400):
        time = jittered(samples, 2.0 / samples, 0.3)
        full = generalised(tumbling(time), walker, fixed)
        absent = dict.fromkeys(("qvel", "base_linvel", "base_angvel"))
        derived = generalised(tumbling(time, **absent), walker, fixed)
        worst.append(np.abs(full.v - derived.v).max())
        assert sum("central differences" in note for note in derived.notes) == 3
    assert worst[0] < 0.05 * np.abs(full.v).max()
    assert worst[1] < 0.35 * worst[0]


def test_flipped_quaternion_signs_do_not_disturb_rates():
    time = np.arange(100) * 0.01
    log = tumbling(time)
    flipped = log.base_quat * np.where(np.arange(100) % 3 == 0, -1, 1)[:, None]
    np.testing.assert_allclose(body_rates(time, flipped), body_rates(time, log.base_quat))


def test_dropouts_mark_rows_in_the_model_order(walker):
    time = np.arange(50) * 0.01
    log = tumbling(time)
    tau, pos = log.tau.copy(), log.base_pos.copy()
    tau[5, 1], pos[9, 2] = np.nan, np.nan
    motion = generalised(
        tumbling(time, tau=tau, base_pos=pos), walker, {"ankle": (1.0, 0.0, 0.0, 0.0)}
    )
    hip = walker.joint_dofadr[walker.joint_names.index("hip")]
    np.testing.assert_array_equal(np.flatnonzero(~motion.valid[:, hip]), [5, 9])
    np.testing.assert_array_equal(np.flatnonzero(~motion.valid[:, 0]), [9])
    assert np.isfinite(motion.q).all()


@pytest.mark.parametrize(
    ("changes", "fixed", "said"),
    [
        ({}, {}, r"no joints \['ankle'\]"),
        ({"joint_names": ("lift", "hop")}, {}, "'hop' is no hinge or slide.*did you mean 'hip'"),
        ({"joint_names": ("lift", "ankle")}, {}, "'ankle' is no hinge or slide"),
        ({"base_quat": None}, {}, "needs base_quat, and base_pos or an IMU"),
        ({}, {"ankel": 0.0}, "'ankel' is not in the model; did you mean 'ankle'"),
        ({}, {"hip": 0.0}, "fixed and in the log"),
        ({}, {"ankle": 0.0}, "takes 4 numbers"),
        ({}, {"ankle": (1.0, 1.0, 0.0, 0.0)}, "unit quaternion"),
        ({"base_quat": np.zeros((50, 4))}, {"ankle": (1.0, 0.0, 0.0, 0.0)}, "has length 0"),
    ],
)
def test_generalised_names_what_is_missing(walker, changes, fixed, said):
    with pytest.raises(LogError, match=said):
        generalised(tumbling(np.arange(50) * 0.01, **changes), walker, fixed)


def test_a_free_joint_may_be_fixed_too(walker):
    pose = (0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0)
    fixed = {"root": pose, "ankle": (1.0, 0.0, 0.0, 0.0)}
    motion = generalised(tumbling(np.arange(50) * 0.01), walker, fixed)
    np.testing.assert_allclose(motion.q[:, :7], [pose] * 50)
    assert not motion.valid[:, :6].any()


# Differences


def test_centred_slopes_are_exact_for_parabolas_at_any_stamps():
    time = jittered(30, 0.1, 0.8)
    slopes = np.diff(time**2 - 3 * time)[:, None] / np.diff(time)[:, None]
    np.testing.assert_allclose(centred_slopes(time, slopes)[:, 0], 2 * time - 3, atol=1e-12)


def test_centred_slopes_of_a_sine_on_a_grid_are_of_sixth_order():
    """Closed form: a sine of ω h = 0.5 comes out 1 − (ω h)⁶ / 140 as large, at stamps of some years too."""
    time = 0.01 * np.arange(200)
    for start in (0.0, 1.7e9):
        stamps = start + time
        slopes = np.diff(np.sin(50 * time))[:, None] / np.diff(stamps)[:, None]
        error = centred_slopes(stamps, slopes)[3:-3, 0] / 50 - np.cos(50 * time)[3:-3]
        assert np.abs(error).max() == pytest.approx(0.5**6 / 140, rel=0.15)


def misfit(a: np.ndarray, tau: np.ndarray) -> float:
    """With τ = q̈, what a filter would see as torque error, relative."""
    return float(np.abs(a - tau).max() / np.abs(tau).max())


@pytest.mark.parametrize("window", [1, 2, 5])
def test_aligned_differences_agree_to_second_order_and_misaligned_ones_do_not(window):
    aligned, misaligned = [], []
    for samples in (200, 400, 800):
        time = np.linspace(0, 2, samples)
        observed = aligned_differences(sine_motion(time), window)
        aligned.append(misfit(observed.a, observed.motion.tau))
        misaligned.append(misfit(observed.a, sine_motion(time).tau[window:]))
    h = 2 / 199
    # Closed form for a sine of angular rate ω: the mean over a window of width w h by the trapezoid
    # rule differs from the exact one by the factor (ω h / 2) / tan(ω h / 2) ≈ 1 − (ω h)² / 12,
    # while a delay of half the window turns the phase by ω w h / 2.
    assert aligned[0] == pytest.approx((OMEGA * h) ** 2 / 12, rel=0.05)
    assert misaligned[0] == pytest.approx(OMEGA * window * h / 2, rel=0.15)
    np.testing.assert_allclose(np.divide(aligned[:-1], aligned[1:]), 4, rtol=0.1)
    np.testing.assert_allclose(np.divide(misaligned[:-1], misaligned[1:]), 2, rtol=0.1)


@pytest.mark.parametrize("window", [1, 4])
def test_a_misaligned_torque_looks_like_friction_and_an_aligned_one_does_not(window):
    """Fit τ = m a + d v: the delay of a alone puts −ω² window h / 2 into d."""
    time = np.linspace(0, 2, 1000)
    motion = sine_motion(time)
    observed = aligned_differences(motion, window)

    def damping(tau, v):
        columns = np.stack([observed.a.ravel(), v.ravel()], axis=1)
        return np.linalg.lstsq(columns, tau.ravel(), rcond=None)[0][1]

    expected = OMEGA**2 * window * (time[1] - time[0]) / 2
    assert abs(damping(motion.tau[window:], motion.v[window:])) == pytest.approx(expected, rel=0.05)
    assert abs(damping(observed.motion.tau, observed.motion.v)) < 1e-3 * expected


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), window=st.integers(1, 6))
def test_every_channel_gets_one_delay_at_any_stamps(seed, window):
    """Signals linear in time come out exact at the row's own time, however the stamps fall."""
    time = jittered(40, 0.01, 0.9, seed)
    line = np.stack([2 * time, 5 - 3 * time], axis=1)
    motion = Motion(time=time, q=line, v=line, tau=line, valid=np.ones_like(line, dtype=bool))
    observed = aligned_differences(motion, window)
    np.testing.assert_allclose(observed.a, [[2.0, -3.0]] * (40 - window), atol=1e-9)
    centre = observed.motion.time
    np.testing.assert_allclose(centre, (time[window:] + time[:-window]) / 2, atol=1e-12)
    for x in (observed.motion.q, observed.motion.v, observed.motion.tau):
        np.testing.assert_allclose(x, np.stack([2 * centre, 5 - 3 * centre], axis=1), atol=1e-12)


def test_central_differences_sit_on_the_stamps_to_second_order():
    errors = []
    for samples in (200, 400):
        time = jittered(samples, 2 / samples, 0.3)
        observed = central_differences(sine_motion(time))
        np.testing.assert_array_equal(observed.motion.time, time[1:-1])
        errors.append(misfit(observed.a, observed.motion.tau))
    assert errors[0] < 0.02
    assert errors[1] < 0.35 * errors[0]


def walking(walker, samples=60) -> Motion:
    log = tumbling(jittered(samples, 0.01, 0.5))
    wrench = np.random.default_rng(0).normal(size=(samples, 1, 6))
    log = dataclasses.replace(log, contact_wrench=wrench, contact_bodies=("foot",))
    return generalised(log, walker, {"ankle": (1.0, 0.0, 0.0, 0.0)})


def online(motion: Motion, window: int):
    differentiator = Differentiator(window)
    first = jax.tree.map(lambda x: x[0], motion)
    rest = jax.tree.map(lambda x: jnp.asarray(x[1:]), motion)
    run = jax.jit(lambda state, xs: jax.lax.scan(differentiator.step, state, xs)[1])
    return run(differentiator.init(first), rest)


@pytest.mark.parametrize("window", [1, 2, 5])
def test_online_equals_offline(walker, window):
    motion = walking(walker)
    motion = dataclasses.replace(motion, valid=motion.valid & (motion.tau > -60))
    assert 0 < motion.valid[:, 6].sum() < 60
    # The sign of a quaternion may jump in a log; it must not matter.
    q = np.array(motion.q)
    q[20:33, 3:7] *= -1
    seen = online(dataclasses.replace(motion, q=q), window)
    expected = aligned_differences(motion, window)
    late = jax.tree.map(lambda x: x[window - 1 :], seen)
    signs = np.sign(np.sum(late.motion.q[:, 3:7] * expected.motion.q[:, 3:7], axis=1))
    q = np.array(late.motion.q)
    q[:, 3:7] *= signs[:, None]
    late = dataclasses.replace(late, motion=dataclasses.replace(late.motion, q=q))
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-9), late, expected)
    assert not seen.motion.valid[: window - 1].any()
    np.testing.assert_allclose(np.linalg.norm(q[:, 3:7], axis=1), 1)


def test_online_holds_and_marks_what_is_not_finite(walker):
    motion = walking(walker)
    tau, v = np.array(motion.tau), np.array(motion.v)
    tau[20, 6], v[40, 2] = np.nan, np.inf
    seen = online(dataclasses.replace(motion, tau=tau, v=v), window=2)
    clean = online(motion, window=2)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(seen))
    lost = np.array(clean.motion.valid & ~seen.motion.valid)
    # Sample k enters as step k − 1 and stays in a window of two periods for three steps.
    assert set(np.flatnonzero(lost[:, 6])) == {19, 20, 21, 39, 40, 41}
    assert set(np.flatnonzero(lost[:, 0])) == {39, 40, 41}
    kept = np.array(seen.motion.valid)
    np.testing.assert_allclose(np.array(seen.a)[kept], np.array(clean.a)[kept])


def test_a_bad_first_sample_is_only_marked(walker):
    motion = walking(walker)
    q = np.array(motion.q)
    q[0] = np.nan
    seen = online(dataclasses.replace(motion, q=q), window=1)
    assert not seen.motion.valid[0].any()
    assert seen.motion.valid[1, :6].all()
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(seen))


@pytest.mark.parametrize("late", [0.0, -0.005], ids=["repeated", "backward"])
def test_a_stamp_that_does_not_come_later_is_refused_and_online_marked(walker, late):
    motion = walking(walker)
    time = np.array(motion.time)
    time[30] = time[29] + late
    faulty = dataclasses.replace(motion, time=time)
    for differences in (aligned_differences, central_differences):
        with pytest.raises(LogError, match=r"time\[30\] = .* does not come after time\[29\]"):
            differences(faulty)
    seen, clean = online(faulty, window=2), online(motion, window=2)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(seen))
    lost = np.array(clean.motion.valid & ~seen.motion.valid).any(axis=1)
    # Sample 30 enters as step 29; the period that ends there is in two windows.
    assert set(np.flatnonzero(lost)) == {29, 30}
    assert not np.array(seen.motion.valid)[[29, 30]].any()


def test_windows_are_checked(walker):
    with pytest.raises(ValueError, match="window of 0"):
        Differentiator(0)
    with pytest.raises(ValueError, match="window of 60"):
        aligned_differences(walking(walker), 60)
