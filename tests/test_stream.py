"""Logs in chunks: the answer does not depend on the cuts, memory does not grow, a saved state goes on."""

import dataclasses
import functools
import gc
import itertools
import tracemalloc
import warnings
from collections.abc import Iterator

import equinox as eqx
import jax
import numpy as np
import pytest
from excitation import compiled, loaded, motion_of, torques

import jax_inertia as ji
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.estimation import log_filter
from jax_inertia.estimation.checkpoint import (
    StateError,
    load_state,
    load_stream,
    save_state,
    save_stream,
)
from jax_inertia.estimation.inertial_filter import Estimator, make_estimator
from jax_inertia.estimation.priors import Load
from jax_inertia.estimation.stream import Part, Stream, StreamState
from jax_inertia.logs.log import Log, LogError, TorqueUnit
from jax_inertia.maths import charts
from jax_inertia.maths.gates import ChiSquaredGate
from jax_inertia.signals.differences import aligned_differences
from jax_inertia.signals.generalised_motion import generalised

RATE, SAMPLES = 333.0, 3001


def estimator(**options) -> Estimator:
    """For a load on the tip of the arm of three hinges, with a gate, so that every part of a state is in use."""
    robot = ji.load_model(compiled("universal"))
    defaults = {"sigma_tau": 0.1, "prior": Load(3.0), "drift": Load(0.05), "reopen_after": 0.5}
    defaults |= {"gate": ChiSquaredGate(0.999, 3), "iterations": 3}
    return make_estimator(robot, ["tip"], **{**defaults, **options})


@functools.cache
def log() -> Log:
    """Nine seconds; the load is there from the start, a knock is in the middle, and sensors drop out."""
    plant = loaded(compiled("universal"), "tip")
    time, q, v, a = motion_of(plant, SAMPLES, rate=RATE)
    tau = torques(plant, q, v, a) + 0.1 * np.random.default_rng(0).normal(size=v.shape)
    tau[1500:1600] += 40.0
    tau[700:720, 1] = np.nan
    q[2000:2003] = np.nan
    # A pause in the stamps.
    time = time + 0.25 * (np.arange(SAMPLES) > 2500)
    names = tuple(plant.joint(j).name for j in range(plant.njnt))
    return Log(time=time, joint_names=names, qpos=q, qvel=v, tau=tau)


def rows(whole: Log, part: slice) -> Log:
    return whole.map_channels(lambda x: x[part], time=whole.time[part])


def cut(whole: Log, edges: list[int]) -> Iterator[Log]:
    for begin, end in itertools.pairwise([0, *edges, len(whole.time)]):
        yield rows(whole, slice(begin, end))


def joined(parts: list[Part]) -> Part:
    return jax.tree.map(lambda *x: np.concatenate(x), *parts)


def equal_bits(one, other) -> bool:
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.array_equal(np.asarray(a), np.asarray(b), equal_nan=True) for a, b in pairs)


@functools.cache
def stream() -> Stream:
    return Stream(estimator(), window=8, block=32)


@functools.cache
def whole() -> Part:
    return joined(list(stream().run([log()])))


# --- cuts --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "edges",
    [
        [1500],
        [1, 2, 3, 9, 10, 257, 2502, 3000],
        list(range(97, SAMPLES, 97)),
        sorted(np.random.default_rng(4).choice(np.arange(1, SAMPLES), 60, False).tolist()),
    ],
    ids=["half", "odd", "even", "random"],
)
def test_cuts_do_not_change_a_bit(edges):
    assert equal_bits(joined(list(stream().run(cut(log(), edges)))), whole())


def test_it_is_the_filter_over_aligned_differences():
    """The same windows by hand, and the filter compiled as a whole, to other instructions: equal but for rounding."""
    # Without what is bridged by straight lines, which a whole log and its blocks see differently.
    sound = rows(log(), slice(0, 1999))
    sound = eqx.tree_at(lambda x: x.tau, sound, np.nan_to_num(sound.tau))
    got = joined(list(stream().run([sound])))
    motion = dataclasses.replace(generalised(sound, stream().estimator.robot), notes=())
    seen = jax.tree.map(lambda x: x[::8], aligned_differences(motion, 8))
    _, wanted = log_filter.run(stream().estimator, stream().estimator.initial(), seen)
    np.testing.assert_allclose(got.time, seen.motion.time, rtol=1e-12)
    for a, b in zip(jax.tree.leaves(got.trace), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_allclose(np.asarray(a, float), np.asarray(b, float), rtol=1e-6, atol=1e-8)


def test_it_weighs_the_load_and_leaves_out_what_was_not_measured():
    part = whole()
    estimate = part.trace.estimate
    error = np.abs(estimate.pi[:, 0, 0] - 3.2)  # 0.8 kg of tip and 2.4 kg of load
    assert np.all(error[20:] < 4.0 * estimate.sigma_pi[20:, 0, 0])
    assert np.median(error[20:]) < 0.15
    used = part.trace.innovation.rows
    period = 1 / RATE
    assert np.all(used[(part.time > 700 * period) & (part.time < 720 * period)] == 2)
    assert used[np.argmin(np.abs(part.time - 2001 * period))] == 0
    # The window with the pause in it, whose difference would be of nothing.
    assert used[np.searchsorted(part.time, log().time[2500]) - 1 :][:2].min() == 0
    knocked = (part.time > 1505 * period) & (part.time < 1595 * period)
    assert not part.trace.innovation.accepted[knocked].any()


# --- memory ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_memory_does_not_grow_with_the_log():
    """What is held once Python's garbage (cycles) is collected, a few chunks in and many chunks later."""
    sound = rows(log(), slice(0, 1000))
    span = float(sound.time[-1]) + 1 / RATE
    few, many, held = 4, 20, []

    def endless(count: int) -> Iterator[Log]:
        for k in range(count):
            if k in (few, many - 1):
                gc.collect()
                held.append(tracemalloc.get_traced_memory()[0])
            yield sound.map_channels(lambda x: x.copy(), time=sound.time + k * span)

    for _ in stream().run(endless(2)):  # compiling allocates, and caches fill
        pass
    tracemalloc.start()
    try:
        samples = sum(len(part.time) for part in stream().run(endless(many)))
    finally:
        tracemalloc.stop()
    assert samples == (1000 * many - 1) // 8
    # Not even one joint channel of the chunks between (360 kB of 1.2 MB) is kept; the type checks' tables, which
    # tests alone have, grow by up to 100 kB.
    assert held[1] - held[0] < (many - 1 - few) * sound.tau.nbytes
    state = stream().start()
    for chunk in endless(few):
        state, _ = stream().feed(state, chunk)
        assert len(state.waiting.time) <= 8 * 32


# --- a state in a file -------------------------------------------------------------------------------------------


def half_way() -> StreamState:
    return stream().feed(stream().start(), rows(log(), slice(0, 1555)))[0]


def test_a_saved_stream_goes_on_bit_for_bit(tmp_path):
    before = half_way()
    assert float(before.filter.rejected_for) > 0  # in the middle of the knock
    assert len(before.waiting.time) > 1
    save_stream(tmp_path / "state.npz", stream(), before)
    after = load_stream(tmp_path / "state.npz", stream())
    assert jax.tree.structure(after) == jax.tree.structure(before)
    assert equal_bits(after, before)
    rest = joined(list(stream().run([rows(log(), slice(1555, None))], after)))
    count = len(whole().time) - len(rest.time)
    assert equal_bits(rest, jax.tree.map(lambda x: x[count:], whole()))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_saved_filter_is_the_same_to_the_last_bit(tmp_path, dtype):
    robot = ji.load_model(compiled("universal")).astype(dtype)
    ekf = make_estimator(robot, ["tip"], sigma_tau=0.1, prior=Load(3.0))
    rng = np.random.default_rng(0)
    state = jax.tree.map(
        lambda x: (x + rng.uniform(0.1, 1.0, size=x.shape)).astype(x.dtype), ekf.initial()
    )
    root = np.tril(state.belief.covariance)
    state = eqx.tree_at(lambda s: s.belief.covariance, state, root @ root.T)
    save_state(tmp_path / "state.npz", ekf, state)
    again = load_state(tmp_path / "state.npz", ekf)
    assert equal_bits(again, state)
    assert again.belief.mean.dtype == dtype
    assert [p.name for p in tmp_path.iterdir()] == ["state.npz"]


@pytest.mark.slow
def test_the_state_of_another_filter_is_refused_in_one_line(tmp_path):
    path = tmp_path / "state.npz"
    ekf = estimator()
    save_state(path, ekf, ekf.initial())
    robot = ekf.robot
    for other, words in (
        (estimator(chart=charts.LogCholesky()), "chart is 'LogCholeskyUUt'.*'LogCholesky'"),
        (make_estimator(robot, ["gimbal"], sigma_tau=0.1), "bodies is 'tip'.*'gimbal'"),
        (make_estimator(robot, ["tip", "gimbal"], sigma_tau=0.1), "bodies"),
        (make_estimator(robot.astype("float32"), ["tip"], sigma_tau=0.1), "precision"),
    ):
        with pytest.raises(StateError, match=words) as caught:
            load_state(path, other)
        assert "\n" not in str(caught.value)
    with pytest.raises(StateError, match="last is missing"):
        load_stream(path, stream())
    save_stream(path, stream(), half_way())
    with pytest.raises(StateError, match="its window is '8', this filter's is '16'"):
        load_stream(path, Stream(estimator(), window=16, block=32))


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (lambda: estimator(iterations=2), "of another filter: iterations differs"),
        (lambda: estimator(gate=ChiSquaredGate(0.99, 3)), "of another filter: gate differs"),
        (lambda: estimator(sigma_tau=0.2), "of another filter: noise differs"),
        (lambda: with_robot(lambda r: r.armature), "of another robot: robot.armature differs"),
        (lambda: with_robot(lambda r: r.gravity), "of another robot: robot.gravity differs"),
    ],
    ids=["iterations", "gate", "noise", "armature", "gravity"],
)
def test_the_state_of_another_robot_or_setting_is_refused_by_name(tmp_path, other, words):
    save_state(tmp_path / "state.npz", estimator(), estimator().initial())
    assert equal_bits(load_state(tmp_path / "state.npz", estimator()), estimator().initial())
    with pytest.raises(StateError, match=words) as caught:
        load_state(tmp_path / "state.npz", other())
    assert "\n" not in str(caught.value)


def test_the_state_of_a_chart_with_another_reference_is_refused(tmp_path):
    """A chart is not known by its name alone: coordinates relative to three times the body are others."""
    ekf = estimator()
    pi = ekf.robot.pi[np.array(ekf.bodies)]
    one, other = (dataclasses.replace(ekf, chart=charts.Relative.to(k * pi)) for k in (1.0, 3.0))
    save_state(tmp_path / "state.npz", one, one.initial())
    assert equal_bits(load_state(tmp_path / "state.npz", one), one.initial())
    with pytest.raises(StateError, match="of another filter: chart differs"):
        load_state(tmp_path / "state.npz", other)


def with_robot(leaf) -> Estimator:
    """The filter of a robot in one number different."""
    ekf = estimator()
    return eqx.tree_at(lambda e: leaf(e.robot), ekf, leaf(ekf.robot) + 1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: p + np.triu(p, 1) + np.eye(10, k=1), "covariance is not symmetric"),
        (lambda p: p - 2.0 * np.diag(np.diag(p)), "covariance is not positive semidefinite"),
        (lambda p: np.where(np.eye(10, dtype=bool), p, 0.99 * np.sqrt(np.outer(np.diag(p), np.diag(p))))
         * (1 - 2 * ((np.add.outer(np.arange(10), np.arange(10)) % 3) == 1) * (1 - np.eye(10))),
         "covariance is not positive semidefinite"),
    ],
    ids=["lopsided", "negative", "correlated beyond one"],
)  # fmt: skip
def test_what_is_no_covariance_is_refused(tmp_path, change, words):
    path, ekf = tmp_path / "state.npz", estimator()
    state = ekf.initial()
    save_state(path, ekf, state)
    forged(path, covariance=change(np.asarray(state.belief.covariance)))
    with pytest.raises(StateError, match=words):
        load_state(path, ekf)


@pytest.mark.parametrize("scale", [1e3, 1e12, 1e300])
def test_a_mass_that_no_robot_moves_is_refused(tmp_path, scale):
    """Finite numbers with a sound covariance, and no body of this robot nor of any."""
    path, ekf = tmp_path / "state.npz", estimator()
    save_state(path, ekf, ekf.initial())
    forged(path, mean=scale * (1.0 + np.abs(np.asarray(ekf.initial().belief.mean))))
    with pytest.raises(StateError, match=r"the mass of '.*' is .* kg, of a robot of"):
        load_state(path, ekf)


def forged(path, **changes) -> None:
    with np.load(path) as file:
        arrays = {**file, **changes}
    np.savez(path, **{k: v for k, v in arrays.items() if v is not None})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"version": np.array("jax-inertia state 9")}, "version is 'jax-inertia state 9'"),
        ({"mean": np.zeros(11)}, r"mean has shape \(11,\), not \(10,\)"),
        ({"covariance": None}, "covariance is missing"),
        ({"digests": np.array("[" * 2000)}, "digests are unreadable"),
        ({"bias": np.full(3, np.nan)}, "bias is not finite"),
        ({"mean": np.array(["x"] * 10)}, "mean has shape"),
        ({"mean": np.array([None] * 10, object)}, "pickles"),
        ({"last": np.zeros(2)}, "'last' has shape"),
        ({"qpos": np.zeros((4, 4))}, "the samples that wait are no log"),
        ({"tau_kind": np.array("guessed")}, "the samples that wait are no log"),
        ({"joint_names": None}, "the samples that wait are no log"),
        ({"qpos": None}, "the samples that wait are no log: qpos is missing"),
        ({"joint_names": np.array([["a", "b"]])}, "joint_names is no list of names"),
    ],
    ids=lambda x: next(iter(x)) if isinstance(x, dict) else "",
)
def test_a_damaged_state_is_refused_in_one_line(tmp_path, changes, words):
    path = tmp_path / "state.npz"
    save_stream(path, stream(), half_way())
    forged(path, **changes)
    with pytest.raises(StateError, match=words) as caught:
        load_stream(path, stream())
    assert "\n" not in str(caught.value)


def test_no_file_half_a_file_and_no_npz(tmp_path):
    path, ekf = tmp_path / "state.npz", estimator()
    with pytest.raises(StateError, match=r"state\.npz"):
        load_state(path, ekf)
    save_state(path, ekf, ekf.initial())
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(StateError, match="not a sound"):
        load_state(path, ekf)
    with pytest.raises(ValueError, match=r"written as \.npz"):
        save_state(tmp_path / "state.pkl", ekf, ekf.initial())


# --- chunks that do not fit --------------------------------------------------------------------------------------


def test_chunks_that_do_not_follow_are_refused():
    one = rows(log(), slice(0, 500))
    state, _ = stream().feed(stream().start(), one)
    with pytest.raises(LogError, match="chunks follow one another"):
        stream().feed(state, one)
    later = rows(log(), slice(500, 600))
    with pytest.raises(LogError, match="all chunks are of one log"):
        stream().feed(
            state,
            eqx.tree_at(lambda x: x.tau_command, later, later.tau, is_leaf=lambda x: x is None),
        )
    with pytest.raises(LogError, match="measured velocities"):
        stream().feed(state, eqx.tree_at(lambda x: x.qvel, later, None))
    with pytest.raises(LogError, match="no chunk yet"):
        stream().finish(stream().start())
    with pytest.raises(ValueError, match="window 0"):
        Stream(stream().estimator, window=0)


# --- what every way from a log to a result asks of it ------------------------------------------------------------


def by_stream(given: Log) -> None:
    list(Stream(estimator(), window=8, block=32).run([given]))


def by_observation(given: Log) -> None:
    log_filter.observe(given, estimator().robot)


def by_diagnosis(given: Log) -> None:
    diagnose(estimator().robot, given)


def by_other_motion(given: Log) -> None:
    diagnose(estimator().robot, log(), test_log=given)


@pytest.mark.parametrize("way", [by_stream, by_observation, by_diagnosis, by_other_motion])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda x: dataclasses.replace(x, tau_unit="A", tau_unit_text="A"), "tau is in 'A'"),
        (lambda x: dataclasses.replace(x, joint_names=("one", "two", "three")), "has none of the log.s joints, one"),
        (lambda x: x.select(x.joint_names[:2]), "the log lacks joints of the model"),
        (lambda x: dataclasses.replace(x, tau=x.tau * np.array([1.0, np.nan, 1.0])), "NaN or Inf|all finite"),
        (lambda x: dataclasses.replace(x, qpos=x.qpos * np.array([1.0, 1.0, np.inf])), "NaN or Inf|all finite"),
        (lambda x: dataclasses.replace(x, time=x.time[::-1]), "does not increase|does not come after"),
    ],
    ids=["amperes", "names", "joints", "NaN", "infinite", "stamps"],
)  # fmt: skip
def test_no_result_is_had_from_what_is_no_log_of_the_robot(way, change, words):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        given = change(rows(log(), slice(0, 400)))
    if way is by_diagnosis and given.tau_unit is not TorqueUnit.NEWTON_METRE:
        pytest.skip("of currents a gain is taken from the log itself")
    with pytest.raises(LogError, match=words) as caught:
        way(given)
    assert "\n" not in str(caught.value)


def test_currents_are_taken_where_gains_follow():
    given = dataclasses.replace(log(), tau=log().tau / 5.0, tau_unit="A", tau_unit_text="A")
    raw = log_filter.observe(given, estimator().robot, any_unit=True)
    usual = log_filter.observe(log(), estimator().robot)
    np.testing.assert_allclose(5.0 * raw.motion.tau, usual.motion.tau, atol=1e-9)
