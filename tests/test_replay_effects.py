"""Effects of robots that are told positions: what a model is made to do against the equations, and what is found."""

import dataclasses

import mujoco
import numpy as np
import pytest

import jax_inertia as ji
from jax_inertia.logs.log import Log, LogError
from jax_inertia.replay import entry, pipeline
from jax_inertia.replay.corrected import corrected
from jax_inertia.replay.fitting import columns
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.listing import listed, size_of
from jax_inertia.replay.loop import ORDINARY, Loop, Parameter
from jax_inertia.replay.record import Commanded, Record, feeds_forward, record_of
from jax_inertia.replay.search.odd import Search
from jax_inertia.replay.search.parsimony import simplest
from jax_inertia.replay.search.probability import Sure
from jax_inertia.replay.search.undecided import open_between
from jax_inertia.replay.simulation.plant import Plant, Structure
from jax_inertia.replay.simulation.simulate import replay
from jax_inertia.replay.step_law import StepLaw

TWO = """
<mujoco><option timestep="0.001"/><worldbody>
<body name="left"><joint name="a" axis="0 1 0" armature="0.02"/>
<inertial pos="0 0 -0.15" mass="0.8" diaginertia="0.004 0.004 0.001"/></body>
<body name="right" pos="0 1 0"><joint name="b" axis="0 1 0" armature="0.02"/>
<inertial pos="0 0 -0.15" mass="0.8" diaginertia="0.004 0.004 0.001"/></body></worldbody></mujoco>"""
NAMES = ("a", "b")
KP, KD = np.array([20.0, 15.0]), np.array([0.7, 0.5])
LOOP = Loop(KP, KD, np.full(2, np.inf), "log")


def two():
    return mujoco.MjSpec.from_string(TWO)


def one():
    spec = two()
    spec.delete(spec.body("right"))
    return spec


def made(law, *, spec=two, seed=0, seconds=10.0, kp=KP, kd=KD, pull=None, swing=1.0) -> Log:
    """A log of 200 Hz by MuJoCo C at 0.5 ms, a 1 kHz loop; `law(miss, v)` is the loop's torque, (torque, friction)."""
    m = spec().compile()
    n = m.nv
    m.opt.timestep = 5e-4
    m.dof_solimp[:] = [0.9999, 0.9999, 0.001, 0.5, 2.0]
    d, rng = mujoco.MjData(m), np.random.default_rng(seed)
    at = np.arange(0, seconds, 0.02)
    told = 0.5 + sum(
        rng.uniform(0.1, 0.5)
        * np.sin(2 * np.pi * np.outer(at, rng.uniform(0.1, 1.2, n)) + rng.uniform(0, 6, n))
        for _ in range(3)
    )
    told = told + np.repeat(rng.normal(size=(len(at) // 50 + 1, n)) * 0.2, 50, axis=0)[: len(at)]
    told = 0.5 + swing * (told - 0.5)
    d.qpos[:] = told[0]
    for body, force in (pull or {}).items():
        d.xfrc_applied[m.body(body).id, :3] = force
    rows = []
    for k in range(int(seconds / m.opt.timestep) - 1):
        now = told[int((k * m.opt.timestep + 1e-9) / 0.02)]
        if k % 2 == 0:
            torque, friction = law(now - d.qpos, d.qvel)
            d.qfrc_applied[:], m.dof_frictionloss[:] = torque, friction
        if k % 10 == 0:
            rows.append((k * m.opt.timestep, *d.qpos, *now))
        mujoco.mj_step(m, d)
    x = np.array(rows)
    count = 2 * np.pi / 2**14
    return Log(
        time=x[:, 0], joint_names=NAMES[:n], qpos=np.round(x[:, 1 : 1 + n] / count) * count, qpos_target=x[:, 1 + n :],
        kp=kp[:n], kd=kd[:n],
    )  # fmt: skip


def dead_zone(x, width):
    return np.sign(x) * np.maximum(np.abs(x) - width, 0.0)


TABLE = (
    Parameter("dead_band", 0, 0.0, 0.01, 0.0, 1.0),
    Parameter("torque_saturation", 0, np.inf, 0.5, -9.0, 9.0, "", 0.0),
    Parameter("torque_speed", 0, 0.0, 0.1, 0.0, 9.0),
    Parameter("torque_saturation", 1, np.inf, 0.5, -9.0, 9.0, "", 0.0),
    Parameter("kp_scale", 1, 0.0, 0.5, -6.0, 3.0),
    Parameter("torque_bias", 1, 0.0, 1.0, -9.0, 9.0),
)
THETA = np.array([0.05, np.log(3.0), 0.2, np.log(2.0), 0.3, 0.4])


def test_a_model_gives_the_torque_of_the_equation():
    plant = Plant(two(), NAMES, LOOP)
    x = plant.numbers(TABLE, THETA, None)
    model = plant.variants(Structure(dead=True), [x])[0]
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    at = plant.compiled(Structure(dead=True))
    for _ in range(50):
        data.qpos[:], data.qvel[:] = rng.normal(size=2) * 0.3, rng.normal(size=2) * 8
        told = rng.normal(size=2) * 0.3
        data.ctrl[at.act] = data.ctrl[at.dead] = told
        mujoco.mj_forward(model, data)
        # Back-EMF is in the joint's damping.
        got = data.qfrc_actuator + data.qfrc_passive
        np.testing.assert_allclose(got, x.torque(told, data.qpos, data.qvel), atol=1e-9)
    e, v = dead_zone(0.3, 0.05), 6.0
    by_hand = np.clip(20 * e - (0.7 - 0.2) * v, -3, 3) - 0.2 * v
    assert x.torque(np.full(2, 0.3), np.zeros(2), np.full(2, v))[0] == pytest.approx(by_hand)


def test_velocities_and_torques_fed_forward_act_in_the_loop():
    time = np.arange(0, 2, 0.005)
    still, ones = np.zeros((len(time), 2)), np.ones((len(time), 2))
    pushed = Record(time, still, np.zeros(2), Commanded(time, still, None, 0.3 * ones), LOOP)
    aimed = Record(time, still, np.zeros(2), Commanded(time, still + 0.3 / KP), LOOP)
    led = Record(time, still, np.zeros(2), Commanded(time, still, 0.3 / KD * ones), LOOP)
    plant = Plant(two(), NAMES, LOOP)
    paths = [replay(plant, (), np.zeros((1, 0)), r)[0] for r in (pushed, aimed, led)]
    np.testing.assert_allclose(paths[0], paths[1], atol=1e-12)
    np.testing.assert_allclose(paths[0], paths[2], atol=1e-12)


def test_a_command_that_is_the_loops_own_is_not_fed_forward():
    rng = np.random.default_rng(0)
    time, q = np.arange(0, 1, 0.01), rng.normal(size=(100, 2))
    log = {"time": time, "joint_names": NAMES, "qpos": q, "qpos_target": np.zeros_like(q)}
    assert not feeds_forward(Log(**log, tau_command=-KP * q), LOOP)
    assert feeds_forward(Log(**log, tau_command=np.full_like(q, 2.0) + 0.1 * q), LOOP)
    assert not feeds_forward(Log(**log), LOOP)


def test_joints_of_separate_trees_share_replays():
    assert columns.together([0, 0, 1, None, 1, 1, None]) == [0, 1, 0, 3, 1, 2, 4]
    log = made(lambda miss, v: (KP * miss - KD * v, 0.05))
    record, plant = record_of(log, LOOP), Plant(two(), NAMES, LOOP)
    table = tuple(
        Parameter(f, j, n, s, -9.0, 9.0)
        for j in range(2)
        for f, n, s in (("kp_scale", 0.0, 0.3), ("coulomb_friction", 0.0, 0.2))
    )
    theta, free = np.array([0.1, 0.04, -0.1, 0.06]), np.ones(4, bool)
    shared = columns.wide(plant, table, [record], theta, free)
    plant.trees = np.zeros(2, int)
    alone = columns.wide(plant, table, [record], theta, free)
    np.testing.assert_allclose(shared, alone, atol=1e-9)


def test_broydens_formula_says_what_the_last_step_did():
    rng = np.random.default_rng(0)
    plant = Plant(two(), NAMES, LOOP)
    table = tuple(Parameter("kp_scale", j, 0.0, 0.3, -9.0, 9.0) for j in range(2))
    known = rng.normal(size=(2, 7, 2)) * columns.touches(plant, table, 2)[:, None]
    step, change = rng.normal(size=2), rng.normal(size=(7, 2))
    mended = columns.mend(plant, table, known, step, change)
    np.testing.assert_allclose(np.einsum("p,pnj->nj", step, mended), change)
    assert np.all(mended[0, :, 1] == 0)


def odd_effects(found):
    return {(e.family, e.name): e for e in found.effects if not e.ordinary}


@pytest.mark.slow
def test_a_dead_band_is_found_and_replays_in_mujoco_alone():
    def law(miss, v):
        return KP * dead_zone(miss, np.array([0.03, 0.0])) - KD * v, 0.06

    log, other = (made(law, seed=k) for k in (0, 1))
    found = pipeline.diagnose([log], two, test_log=other)
    odd = odd_effects(found)
    assert set(odd) == {("dead_band", "a")}
    size = odd["dead_band", "a"].size
    assert size.value == pytest.approx(0.03, rel=0.05)
    assert {t.family for t in odd["dead_band", "a"].ties} >= {"coulomb_friction"}
    assert any("give it the target of the first" in n for n in corrected(two(), found.correction))
    assert np.all(in_mujoco_alone(found) < found.replayed.after + found.replayed.floor)


@pytest.mark.slow
def test_a_dead_band_of_a_slide_is_found():
    def slide():
        spec = one()
        spec.joint("a").type = mujoco.mjtJoint.mjJNT_SLIDE
        spec.joint("a").axis = [1, 0, 0]
        return spec

    def law(miss, v):
        return KP[:1] * dead_zone(miss, 0.03) - 4.0 * v, 0.2

    kd = np.array([4.0])
    log, other = (made(law, spec=slide, seed=k, kd=kd) for k in (0, 1))
    odd = odd_effects(pipeline.diagnose([log], slide, test_log=other))
    assert set(odd) == {("dead_band", "a")}
    assert odd["dead_band", "a"].size.value == pytest.approx(0.03, rel=0.1)


@pytest.mark.slow
def test_a_rotor_that_is_most_of_a_light_joint_is_found():
    """Twenty times the inertia of its link, and half of what the other joint has."""

    def light(rotor=0.0):
        spec = two()
        body, joint = spec.body("right"), spec.joint("b")
        body.mass, body.inertia, joint.armature = 0.04, [2e-5, 2e-5, 2e-5], rotor
        return spec

    kp, kd = np.array([20.0, 1.5]), np.array([0.7, 0.06])
    logs = [
        made(lambda miss, v: (kp * miss - kd * v, 0.0), spec=lambda: light(0.02), seed=k, kp=kp, kd=kd)
        for k in (0, 1)
    ]  # fmt: skip
    found = pipeline.diagnose(logs[:1], light, test_log=logs[1])
    (effect,) = [e for e in found.effects if e.share > 0.05]
    assert (effect.family, effect.name) == ("armature", "b")
    assert effect.size.value == pytest.approx(0.02, rel=0.05)


def in_mujoco_alone(found) -> np.ndarray:
    """What corrected.xml errs by on the other run, rms of each joint."""
    spec = two()
    corrected(spec, found.correction)
    model = mujoco.MjModel.from_xml_string(spec.to_xml())
    r = found.replayed.records[0]
    model.opt.timestep, model.opt.integrator = 1e-3, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data, error = mujoco.MjData(model), []
    data.qpos[:], data.qvel[:] = r.q[0], r.start
    joints = model.actuator_trnid[: model.nu, 0]
    for k in range(int(r.time[-1] / 1e-3)):
        row = int((k + 1e-6) / 5)
        if k % 5 == 0 and k > 500:
            error.append(data.qpos - r.q[row])
        data.ctrl[:] = r.target[row][joints]
        mujoco.mj_step(model, data)
    return np.sqrt(np.mean(np.square(error), axis=0))


@pytest.mark.slow
def test_friction_that_slides_at_once_gives_by_nothing():
    log, other = (made(lambda miss, v: (KP * miss - KD * v, 0.2), seed=k) for k in (0, 1))
    found = pipeline.diagnose([log], two, test_log=other)
    assert not {e.family for e in found.effects} - {*ORDINARY}


@pytest.mark.slow
@pytest.mark.parametrize(
    "family", ["torque_saturation", "torque_speed", "load_friction", "torque_bias"]
)
def test_what_else_may_be_odd_is_found(family):
    def law(miss, v):
        asked = KP[:1] * miss - KD[:1] * v
        if family == "torque_saturation":
            return np.clip(asked, -2.2, 2.2), 0.05
        if family == "torque_speed":
            return np.clip(asked, -3.0 * (1 + v / 9.0), 3.0 * (1 - v / 9.0)), 0.05
        if family == "load_friction":
            return asked, 0.05 + 0.25 * np.abs(asked)
        return asked + 0.5, 0.05

    log, other = (made(law, spec=one, seed=k) for k in (2, 3))
    found = pipeline.diagnose([log], one, test_log=other)
    odd = odd_effects(found)
    assert (family, "a") in odd
    values = {k: s.value for k, s in odd[family, "a"].sizes}
    wanted = {
        "torque_saturation": {"limit": 2.2}, "torque_speed": {"stall": 3.0, "no_load_speed": 9.0},
        "load_friction": {"load_coefficient": 0.25}, "torque_bias": {"bias": 0.5},
    }[family]  # fmt: skip
    assert values == pytest.approx(wanted, rel=0.15)
    assert np.all(found.replayed.after < 0.2 * found.replayed.before)


@pytest.mark.slow
@pytest.mark.parametrize("falls", [False, True])
def test_a_limit_is_found_that_validation_rows_never_reach(falls):
    def law(miss, v):
        asked = KP[:1] * miss - KD[:1] * v
        if falls:
            return np.clip(asked, -3.0 * (1 + v / 9.0), 3.0 * (1 - v / 9.0)), 0.05
        return np.clip(asked, -2.2, 2.2), 0.05

    log = made(law, spec=one, seed=2)
    other, test = (made(law, spec=one, seed=k, swing=0.1) for k in (3, 4))
    found = pipeline.diagnose([log], one, validation_log=other, test_log=test)
    odd = odd_effects(found)
    assert set(odd) == {("torque_speed" if falls else "torque_saturation", "a")}
    (effect,) = odd.values()
    values = {k: s.value for k, s in effect.sizes}
    wanted = {"stall": 3.0, "no_load_speed": 9.0} if falls else {"limit": 2.2}
    assert values == pytest.approx(wanted, rel=0.15)
    assert effect.probability > 0.9


@pytest.mark.slow
def test_a_second_setting_of_kd_parts_it_from_damping():
    """kd 0.8 of what is said, and 0.2 N m s/rad of the joint's own."""
    logs = []
    for seed, kd in ((0, 0.7), (1, 0.3), (2, 1.1)):
        logs.append(
            made(
                lambda miss, v, kd=kd: (20.0 * miss - (0.8 * kd + 0.2) * v, 0.04),
                spec=one, seed=seed, seconds=6.0, kd=np.array([kd]),
            )
        )  # fmt: skip
    found = pipeline.diagnose(logs, one, exclude=("odd",))
    sizes = {p.family: k for k, p in enumerate(found.everything.table)}
    numbers = found.everything.theta
    assert np.exp(numbers[sizes["kd_scale"]]) == pytest.approx(0.8, abs=0.06)
    assert numbers[sizes["viscous_friction"]] - 0.7 == pytest.approx(0.2, abs=0.05)
    alone = pipeline.diagnose(logs[:1], one, exclude=("odd",))
    assert "kd_scale" not in {p.family for p in alone.everything.table}


def test_play_is_a_second_joint_and_the_motor_is_what_the_encoder_sees():
    table = (Parameter("backlash", 0, 0.0, 0.01, 0.0, 0.5),)
    plant = Plant(one(), NAMES[:1], LOOP._replace(kp=KP[:1], kd=KD[:1], limit=np.array([np.inf])))
    time = np.arange(0, 3, 0.01)
    # Gravity turns the link against the lower end of its play where it hangs to the other side.
    target = np.where(time < 1.5, 0.6, -0.6)[:, None]
    record = Record(time, target, np.zeros(1), Commanded(time, target))
    path = replay(plant, table, np.array([[0.2]]), record)[0, :, 0]
    droop = 0.8 * 9.81 * 0.15 / 20.0
    for row, q in ((140, 0.6), (290, -0.6)):
        link = path[row] - np.sign(q) * 0.1
        assert path[row] == pytest.approx(q - droop * np.sin(link), abs=2e-3)


def test_friction_that_varies_is_set_by_a_callback():
    model = two().compile()
    data = mujoco.MjData(model)
    varying = {"slope": 0.5, "middle": 0.2, "load": 0.2, "stiction": 0.3, "stribeck_velocity": 0.5}
    law = {"b": {"coulomb": 0.1, **varying}}
    data.qvel[:] = 0.5
    data.qpos[:] = 0.6
    data.qfrc_actuator[:] = -2.0
    StepLaw(model, (), {"friction": law}).set(data, np.zeros(0))
    np.testing.assert_allclose(model.dof_frictionloss, [0.0, 0.1 + 0.2 + 0.4 + 0.3 * np.exp(-1.0)])
    with pytest.raises(ValueError, match="no joint 'c'"):
        StepLaw(model, (), {"friction": {"c": law["b"]}})


def test_the_python_entry_takes_a_log_without_torque(tmp_path):
    log = made(lambda miss, v: (0.7 * KP[:1] * miss - KD[:1] * v, 0.0), spec=one)
    path = tmp_path / "rig.xml"
    path.write_text(one().to_xml())
    found = ji.diagnose(path, log, exclude=["odd"])
    assert ji.to_report(found)["effects"][0]["family"] == "kp_scale"
    with pytest.raises(LogError, match="takes the model's file"):
        ji.diagnose(ji.load_model(path), log)
    with pytest.raises(ValueError, match="unknown families"):
        ji.diagnose(path, log, exclude=["dead_bands"])
    with pytest.raises(LogError, match="qpos_target"):
        entry.usable(
            Log(time=log.time, joint_names=NAMES[:1], qpos=log.qpos, tau=log.qpos),
            ji.load_model(path),
        )


@pytest.mark.parametrize(
    ("total", "family", "size"),
    [(0.9, "viscous_friction", 0.2), (0.56, "kd_scale", 0.8)],
    ids=["more than kd", "less than kd"],
)
def test_a_sum_of_damping_and_kd_below_kd_is_no_negative_friction(total, family, size):
    """Of kd 0.7 N m s/rad: a sum of 0.9 is a damping of 0.2, one of 0.56 a kd of 0.8 of what is stated."""
    number = Parameter("viscous_friction", 0, 0.7, 1.0, 0.0, 5.0)
    one = np.array([[1e-6]])
    found = Fit(
        (number,), np.array([total]), one, one, 100.0, np.zeros((3, 2)), np.zeros((1, 3, 2)), None
    )
    search = Search(found, (), (), ())
    odds = {(0,): Sure(2.0, 2.0)}
    (effect,) = listed(found, search, {}, {(0,): 0.8}, odds, LOOP, ["shoulder", "elbow"])
    assert (effect.family, effect.name) == (family, "shoulder")
    assert effect.size.value == pytest.approx(size)
    other = {"viscous_friction", "kd_scale"} - {family}
    assert {t.family for t in effect.ties if t.exact} == other


@pytest.mark.parametrize(("family", "low"), [("coulomb_friction", 0.0), ("viscous_friction", -0.7)])
def test_an_interval_holds_no_negative_friction_nor_kd(family, low):
    """Of a kd of 0.7 N m s/rad, damping and kd together are none at least."""
    number, wide = Parameter(family, 0, 0.0, 1.0, 0.0, 5.0), np.array([[0.04]])
    none = np.zeros((1, 3, 2))
    found = Fit((number,), np.array([0.1]), wide, wide, 100.0, none[0], none, None)
    assert size_of(found, 0, LOOP).low == pytest.approx(low)
    assert size_of(found, 0, LOOP).high > size_of(found, 0, LOOP).value


def test_numbers_are_given_up_while_that_costs_less_than_a_number_is_worth():
    """Backwards, the others following, as least squares with those numbers at 0 has it."""
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(40, 4))
    wanted = columns @ [2.0, 0.0, 0.3, 0.0] + 0.5 * rng.normal(size=40)
    off = np.linalg.lstsq(columns, wanted, rcond=None)[0]
    covariance = np.linalg.inv(columns.T @ columns)
    may_go = np.array([True, True, False, True])
    least = simplest(covariance, off, may_go, 3.0)
    np.testing.assert_array_equal(least.kept, [True, False, True, False])
    again, *_ = np.linalg.lstsq(columns[:, least.kept], wanted, rcond=None)
    np.testing.assert_allclose(least.off[least.kept], again)
    risen = np.sum((wanted - columns @ least.off) ** 2) - np.sum((wanted - columns @ off) ** 2)
    assert least.price == pytest.approx(risen + 3.0)


@pytest.mark.slow
def test_a_load_stands_for_many_numbers_that_pass_for_it():
    """On the lower link of two: kp, damping and offset of both joints, a little off each, replay nearly as well."""
    found, odd = of_two_links(heavy)
    assert set(odd) == {("payload", "lower")}
    assert odd["payload", "lower"].size.value == pytest.approx(0.15, rel=0.15)
    assert not {e.family for e in found.effects} & {"kp_scale", "kd_scale", "encoder_offset"}


def of_two_links(robot):
    """(what is found of a robot beside the plain two links, its odd effects), another motion as test log."""
    logs = [made(lambda miss, v: (KP * miss - KD * v, 0.05), spec=robot, seed=k) for k in (4, 5)]
    found = pipeline.diagnose(logs[:1], chain, test_log=logs[1])
    return found, odd_effects(found)


def chain(load: float = 0.0):
    """The right body below the left one, and more mass of the same shape there."""
    spec = mujoco.MjSpec.from_string(TWO.replace(
        "</body>\n<body name=\"right\" pos=\"0 1 0\">", "<body name=\"lower\" pos=\"0 0 -0.3\">"
    ).replace("</body></worldbody>", "</body></body></worldbody>"))  # fmt: skip
    body = spec.body("lower")
    body.inertia, body.mass = body.inertia * (1 + load / body.mass), body.mass + load
    return spec


def heavy():
    return chain(0.15)


def clamped():
    """0.25 kg at the end of the lower link."""
    spec = chain()
    ball = {
        "mass": 0.25,
        "inertia": np.full(3, 1e-4),
        "ipos": np.zeros(3),
        "explicitinertial": True,
    }
    spec.body("lower").add_body(name="ball", pos=[0.01, 0.0, -0.28], **ball)
    return spec


def heavier_and_shifted():
    """A shifted centre of mass, and half as much mass again on the link before it."""
    spec = chain()
    spec.body("lower").ipos = spec.body("lower").ipos + np.array([0.03, 0.0, 0.02])
    left = spec.body("left")
    left.add_body(
        name="plate", pos=left.ipos, mass=0.5 * left.mass, inertia=0.5 * np.asarray(left.inertia),
        ipos=np.zeros(3), explicitinertial=True,
    )  # fmt: skip
    return spec


@pytest.mark.slow
def test_a_load_and_a_shifted_centre_are_no_lower_gains():
    """All masses by one factor are all gains, frictions and rotors by another: the few numbers are those that are said.

    Errors of the other run are below what encoders and clocks leave before either is there, and tell nothing.
    """
    found, odd = of_two_links(heavier_and_shifted)
    assert set(odd) == {("com_shift", "lower"), ("payload", "left")}
    assert not {e.family for e in found.effects} & {"kp_scale", "kd_scale"}


@pytest.mark.slow
def test_a_load_at_the_end_of_a_link_weighs_what_it_does():
    """Where it is is a part of what it is: as more of the link it would be 0.5 kg, and gains would not be as said."""
    found, odd = of_two_links(clamped)
    assert set(odd) == {("payload", "lower")}
    sizes = dict(odd["payload", "lower"].sizes)
    assert sizes["mass"].value == pytest.approx(0.25, rel=0.1)
    assert sizes["z"].value == pytest.approx(-0.13, abs=0.01)
    assert not {e.family for e in found.effects} & {"kp_scale", "kd_scale"}


@pytest.mark.slow
def test_a_load_is_no_lower_gain_of_every_joint_where_nobody_says_the_gains():
    """Gains are the model's, and the second joint has 0.8 of its kp and kd."""

    def driven(robot):
        def spec():
            out = robot()
            for name, kp, kd in zip(NAMES, KP, KD, strict=True):
                actuator = out.add_actuator(name=name, target=name)
                actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
                actuator.set_to_position(kp=kp, kv=kd)
            return out

        return spec

    weak = np.array([1.0, 0.8])
    logs = [
        dataclasses.replace(
            made(lambda miss, v: (weak * (KP * miss - KD * v), 0.05), spec=clamped, seed=k),
            kp=None, kd=None,
        )
        for k in (4, 5)
    ]  # fmt: skip
    found = pipeline.diagnose(logs[:1], driven(chain), test_log=logs[1])
    odd = odd_effects(found)
    assert set(odd) == {("payload", "lower")}
    assert dict(odd["payload", "lower"].sizes)["mass"].value == pytest.approx(0.25, rel=0.2)
    assert {(e.family, e.name) for e in found.effects if e.family == "kp_scale"} == {
        ("kp_scale", "b")
    }
    assert ("kp_scale", "global") in {(t.family, t.name) for t in odd["payload", "lower"].ties}
    assert any("one factor" in note for note in found.notes)


@pytest.mark.slow
def test_a_load_on_a_joint_that_moves_alone_is_a_kp_by_the_equation():
    """kp / (mass of what moves) is one number: 0.8 of a kp is 0.8 kg (1 / 0.8 − 1) = 0.2 kg more."""
    log, other = (
        made(lambda miss, v: (0.8 * KP[:1] * miss - KD[:1] * v, 0.05), spec=one, seed=k)
        for k in (2, 3)
    )
    found = pipeline.diagnose([log], one, test_log=other)
    (effect,) = [e for e in found.effects if e.family == "kp_scale"]
    (tie,) = [t for t in effect.ties if t.family == "payload"]
    assert (tie.name, tie.exact) == ("left", True)
    mass = float(tie.text.split(" kg more at left")[0])
    assert mass == pytest.approx(0.8 * (1.0 / effect.size.value - 1.0), rel=0.01)


def test_odds_of_a_size_that_is_not_known_are_the_integral_over_it():
    slope, bend, sd = 3.0, 40.0, 0.4
    x = np.linspace(0.0, 6.0, 200001)
    # Of the cost, half is the logarithm; the bend has the prior's 1 / sd² in it.
    density = np.exp(-0.5 * (2 * slope * x + bend * x**2)) * np.sqrt(2 / np.pi) / sd
    odds, size = open_between([slope], [bend], sd)
    assert odds == pytest.approx(np.log(np.trapezoid(density, x)), abs=1e-6)
    assert size == pytest.approx(np.trapezoid(x * density, x) / np.trapezoid(density, x), rel=1e-6)
    assert open_between([0.0, 0.0], [sd**-2.0] * 2, sd)[0] == pytest.approx(0.0)


def coarse(log: Log) -> Log:
    """50 Hz and an encoder of 12 bit."""
    count, rows = 2 * np.pi / 2**12, slice(None, None, 4)
    return dataclasses.replace(
        log, time=log.time[rows], qpos=np.round(log.qpos[rows] / count) * count, qpos_target=log.qpos_target[rows]
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dry", "more", "speed"),
    [(0.1, 0.05, 0.05), (0.1, 0.04, 0.3), (0.1, 0.02, 0.03), (0.2, 0.0, 0.05)],
)
def test_friction_that_may_fall_with_speed_is_a_tie_where_the_log_does_not_decide(dry, more, speed):
    def law(miss, v):
        return KP[:1] * miss - KD[:1] * v, dry + more * np.exp(-((v / speed) ** 2))

    log, other = (coarse(made(law, spec=one, seed=k, seconds=8.0)) for k in (2, 3))
    found = pipeline.diagnose([log], one, test_log=other)
    named = {e.family for e in found.effects} | {t.family for e in found.effects for t in e.ties}
    assert "coulomb_friction" in named
    assert ("stribeck_friction" in named) == (more > 0)
