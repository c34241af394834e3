"""The whole robot: what closed-form logs were made with comes back, and nothing else."""

import dataclasses
import json

import mujoco
import numpy as np
import pytest
from diagnosis_robot import (
    ARMATURE,
    BIAS,
    COULOMB,
    NOMINAL,
    VISCOUS,
    log_of,
    motion,
    needed,
    ordinary,
)
from scipy.integrate import solve_ivp

from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.diagnosis.effects.dry_friction import CoulombFriction
from jax_inertia.diagnosis.effects.friction_forms import MILD_STICTION, FrictionForms
from jax_inertia.diagnosis.effects.identified import effects_in
from jax_inertia.diagnosis.effects.joint import Cogging
from jax_inertia.diagnosis.effects.registry import EFFECTS
from jax_inertia.diagnosis.pipeline import diagnose
from jax_inertia.diagnosis.report.json_report import to_report
from jax_inertia.diagnosis.report.next_motion import to_record
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.diagnosis.search.ordinary import ordinary_physics
from jax_inertia.diagnosis.settings import CalibrationState, Settings
from jax_inertia.diagnosis.simulate.whole_robot import correction
from jax_inertia.logs.log import Log
from jax_inertia.model.load import load_model

MODEL = mujoco.MjModel.from_xml_string(NOMINAL)
MOTIONS = {seed: motion(seed) for seed in (0, 1)}
NEEDED = {seed: needed(MODEL, *MOTIONS[seed][1:]) for seed in MOTIONS}


@pytest.fixture(scope="module")
def robot():
    return load_model(MODEL)


def found(robot, effect=lambda model, t, q, v, a, tau: tau, model=MODEL, level=1.0):
    """The diagnosis of a robot that has ordinary physics everywhere, and an effect of its own on the logged torque."""
    logs = []
    for seed, (t, q, v, a) in MOTIONS.items():
        tau = NEEDED[seed] if model is MODEL else needed(model, q, v, a)
        tau = tau + ordinary(v, a, level)
        logs.append(log_of(t, q, effect(model, t, q, v, a, tau), seed))
    return diagnose(robot, logs[0], test_log=logs[1])


@pytest.fixture(scope="module")
def plain(robot):
    return found(robot)


def test_every_joint_s_ordinary_physics_comes_back(plain):
    for k, name in enumerate(("shoulder", "elbow", "wrist")):
        own = plain.joints[name]
        for family, true in (
            ("viscous_friction", VISCOUS[k]),
            ("coulomb_friction", COULOMB[k]),
            ("armature", ARMATURE[k]),
        ):
            assert own[family].value == pytest.approx(true, rel=0.03), (name, family)
            assert own[family].low < true < own[family].high
        assert own["torque_bias"].value == pytest.approx(BIAS[k], abs=0.03)


def test_mild_forms_turn_round_as_the_friction_and_are_no_large_part_of_it(robot):
    t, q, v, a = MOTIONS[0]
    residual = Residual(robot, log_of(t, q, NEEDED[0] + ordinary(v, a), 0), Settings())
    found = ordinary_physics(residual, EFFECTS, Settings(), CalibrationState.AS_BOUGHT).posterior
    dry = {h.place: h for h in found.chosen if isinstance(h.effect, CoulombFriction)}
    forms = {h.place: h for h in found.chosen if isinstance(h.effect, FrictionForms)}
    assert len(forms) == len(COULOMB)
    assert dry.keys() == forms.keys()
    for place, h in forms.items():
        assert h.shape[0] == dry[place].shape[0]
        assert np.all(h.scale[:2] <= MILD_STICTION * 1.1 * found.of(dry[place])[0][0])


def test_nothing_odd_is_invented_and_the_gap_goes(plain):
    assert [f.family for f in plain.odd] == []
    assert plain.verdict == "explained"
    assert plain.test.after < 0.02 * plain.test.before
    assert "no dry friction, damping and rotor inertia" in plain.headline


def test_a_model_that_lacks_ordinary_physics_is_told_from_a_good_one(robot, plain):
    assert plain.as_bought > 0
    assert found(robot, level=0.0).as_bought < 0


@pytest.mark.slow
def test_one_dry_friction_on_a_good_model_is_no_robot_as_bought(robot):
    def rubbing(model, t, q, v, a, tau):
        return tau + np.array([0.0, 0.7, 0.0]) * np.tanh(v / 0.002)

    assert found(robot, rubbing, level=0.0).as_bought < 0


def test_a_wave_of_which_a_joint_sees_half_is_looked_for(robot):
    time, q, v, _ = motion(1)
    context = Residual(robot, log_of(time, q, 0.0 * v), Settings()).context
    place = Place("joint", "elbow", 1)
    waves = [n for (n,) in Cogging().shapes(context, place)]
    span = np.ptp(context.joint_position[:, 1])
    assert waves[0] == pytest.approx(max(4.0, np.pi / span))
    assert waves[-1] * span > 4 * np.pi


def test_a_sound_robot_has_no_gap(robot):
    sound = found(robot, level=0.0)
    assert sound.verdict == "no_gap"
    assert sound.found == ()


def bristle(seed: int, presliding: float, finer: int = 20) -> np.ndarray:
    """Direction of LuGre's friction along a motion, −1 to 1, exact over steps: ż = (q̇ − |q̇| z) / presliding."""
    t, _, v, _ = motion(seed, rate=200.0 * finer)
    z, out = np.sign(v[0]), np.empty_like(v)
    for k, dt in enumerate(np.diff(t, prepend=t[0])):
        side = np.sign(v[k])
        z = side + (z - side) * np.exp(-np.abs(v[k]) * dt / presliding)
        out[k] = z
    return out[::finer]


def test_a_stated_friction_that_is_a_bristle_in_truth_is_no_gap():
    model = mujoco.MjModel.from_xml_string(NOMINAL)
    model.dof_damping[:], model.dof_armature[:] = 1.05 * VISCOUS, ARMATURE
    model.dof_frictionloss[:] = COULOMB
    logs = []
    for seed, (t, q, v, a) in MOTIONS.items():
        level = COULOMB * (1.0 + 0.05 * np.exp(-((v / 0.03) ** 2)))
        friction = VISCOUS * v + level * bristle(seed, 1.5e-3) + ARMATURE * a
        logs.append(log_of(t, q, NEEDED[seed] + friction, seed))
    sound = diagnose(load_model(model), logs[0], test_log=logs[1])
    assert sound.found == ()
    assert sound.verdict == "no_gap"
    assert sound.as_bought < 0


def with_load():
    spec = mujoco.MjSpec.from_string(NOMINAL)
    load = spec.body("hand").add_body(name="load", pos=[0.03, 0.0, -0.1])
    load.add_geom(size=[0.02, 0, 0], mass=0.8)
    return spec.compile()


def tilted(angle=0.03):
    spec = mujoco.MjSpec.from_string(NOMINAL)
    spec.option.gravity = 9.81 * np.array([-np.sin(angle), 0.0, -np.cos(angle)])
    return spec.compile()


def on_a_slope():
    return tilted(0.5)


def on_a_wall():
    return tilted(np.pi / 2)


def weak(model, t, q, v, a, tau):
    # The motor gives 0.9 of what is logged.
    return tau / np.array([1.0, 0.9, 1.0])


def sprung(model, t, q, v, a, tau):
    return tau + np.array([0.0, 1.5, 0.0]) * q


def early(model, t, q, v, a, tau):
    """Logged 8 ms before it acts; a sensor's sample is taken for a quarter of its 5 ms later, so 6.8 ms are left."""
    seed = next(k for k in MOTIONS if np.array_equal(q, MOTIONS[k][1]))
    _, q, v, a = motion(seed, late=0.008)
    return needed(model, q, v, a) + ordinary(v, a)


def warming(model, t, q, v, a, tau):
    """The elbow's damping falls from 0.8 N m s/rad above what it comes to, by a time constant of 3 s."""
    out = tau.copy()
    out[:, 1] += 0.8 * np.exp(-t / 3.0) * v[:, 1]
    return out


def pushed(model, t, q, v, a, tau):
    """A hand pulls at the hand, 12 N along x for 0.6 s of the first log."""
    if not np.array_equal(q, MOTIONS[0][1]):
        return tau
    data, jacobian = mujoco.MjData(model), np.zeros((3, model.nv))
    out = tau.copy()
    for k in np.flatnonzero((t > 5.0) & (t < 5.6)):
        data.qpos[:] = q[k]
        mujoco.mj_forward(model, data)
        body = model.body("hand").id
        mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
        out[k] -= jacobian.T @ [12.0, 0.0, 0.0]
    return out


@pytest.mark.parametrize(
    ("family", "place", "number", "true", "effect", "model"),
    [
        ("payload", "hand", "mass", 0.8, None, with_load),
        ("torque_gain", "elbow", "gain", 0.9, weak, None),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ("gravity_tilt", "global", "tilt_y", 0.03, None, tilted),
                ("gravity_tilt", "global", "tilt_y", 0.5, None, on_a_slope),
                ("gravity_tilt", "global", "tilt_y", np.pi / 2, None, on_a_wall),
                ("joint_spring", "elbow", "stiffness", 1.5, sprung, None),
                ("time_delay", "global", "delay", 0.0068, early, None),
                ("push", "hand", "force_x", 12.0, pushed, None),
                ("friction_drift", "elbow", "damping_final", VISCOUS[1], warming, None),
                ("friction_drift", "elbow", "damping", VISCOUS[1] + 0.8, warming, None),
            )
        ),
    ],
)
def test_one_odd_effect_beside_ordinary_physics(robot, family, place, number, true, effect, model):
    keep = effect or (lambda model, t, q, v, a, tau: tau)
    diagnosis = found(robot, keep, model() if model else MODEL)
    first = diagnosis.odd[0]
    named = {
        (first.family, first.place.name),
        *((t.family, t.place.name) for t in first.equivalent),
    }
    assert (family, place) in named
    if first.family == family:
        # A push with sudden ends is drawn with flanks, and larger by as much as they take.
        close = 0.2 if family == "push" else 0.1
        assert first.parameters[number].value == pytest.approx(true, rel=close)
    assert diagnosis.test.after < 0.05 * diagnosis.test.before


def at_its_voltage(seed, limit, no_load_speed, joint=1, seconds=10.0, rate=500.0):
    """A log of MuJoCo C: a controller that does not know its elbow's torque–speed line asks for more than it gets."""
    spec = mujoco.MjSpec.from_string(NOMINAL)
    spec.option.timestep, spec.option.integrator = (
        1.0 / rate,
        mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    )
    model = spec.compile()
    model.dof_damping[:], model.dof_armature[:] = VISCOUS, ARMATURE
    thought, data, rng = mujoco.MjData(model), mujoco.MjData(model), np.random.default_rng(seed)
    t, q, v, a = motion(seed, seconds=seconds, rate=rate)
    data.qpos[:], data.qvel[:] = q[0], v[0]
    rows = []
    for k in range(len(t)):
        off, fast = q[k] - data.qpos, v[k] - data.qvel
        thought.qpos[:], thought.qvel[:] = data.qpos, data.qvel
        thought.qacc[:] = a[k] + 60.0 * off + 15.0 * fast
        mujoco.mj_inverse(model, thought)
        asked = thought.qfrc_inverse + COULOMB * np.tanh(data.qvel / 0.002)
        rows.append((data.qpos.copy(), asked))
        given, part = asked.copy(), data.qvel[joint] / no_load_speed
        given[joint] = np.clip(asked[joint], -limit * (1 + part), limit * (1 - part))
        data.qfrc_applied[:] = given - COULOMB * np.tanh(data.qvel / 0.002)
        mujoco.mj_step(model, data)
    qpos, tau = (np.array(x) for x in zip(*rows, strict=True))
    return Log(
        time=t,
        joint_names=("shoulder", "elbow", "wrist"),
        qpos=qpos + rng.normal(0, 2e-5, q.shape),
        tau=tau + rng.normal(0, 0.005, tau.shape),
        tau_kind="commanded",
    )


@pytest.mark.slow
def test_a_motor_at_its_supply_s_voltage(robot):
    log, other = (at_its_voltage(seed, 5.0, 3.5) for seed in (0, 1))
    diagnosis = diagnose(robot, log, test_log=other)
    first = next(f for f in diagnosis.odd if f.place.name == "elbow")
    named = {first.family, *(t.family for t in first.equivalent)}
    assert "torque_speed" in named
    if first.family == "torque_speed":
        limit = first.parameters["limit"]
        assert limit.value == pytest.approx(5.0, rel=0.1)
        # Nonlinear numbers are no surer than the evidence about them.
        assert limit.low < limit.value < limit.high


@pytest.mark.slow
def test_a_mass_is_as_uncertain_as_the_gains_of_motors_whose_currents_were_logged(robot):
    def mass(kind):
        logs = []
        for seed, (t, q, v, a) in MOTIONS.items():
            tau = needed(with_load(), q, v, a) + ordinary(v, a)
            logs.append(dataclasses.replace(log_of(t, q, tau, seed), tau_kind=kind))
        diagnosis = diagnose(robot, logs[0], test_log=logs[1])
        return next(f for f in diagnosis.odd if f.family == "payload").parameters["mass"]

    sensor, current = mass("sensor"), mass("current")
    assert current.low < 0.8 < current.high
    assert current.high - current.low > 1.3 * (sensor.high - sensor.low)


@pytest.mark.slow
def test_no_friction_is_below_zero_where_joints_have_none(robot):
    """The arm with rotors and nothing else: the nearest level and slope of a mild form may lie beyond the bound."""
    t, q, _, a = MOTIONS[0]
    report = to_report(diagnose(robot, log_of(t, q, NEEDED[0] + 3.0 * ARMATURE * a, 0)))
    friction = [
        own[name]
        for own in report["joints"].values()
        for name in ("viscous_friction", "coulomb_friction")
    ]
    assert all(0.0 <= x["ci95"][0] <= x["value"] <= x["ci95"][1] for x in friction)
    assert min(x["value"] for x in friction) == 0.0
    assert max(x["ci95"][1] for x in friction) > 0.0


GAINS = np.array([1.15, 0.88, 1.25])
"""Torque at each joint over what its current was taken for."""


@pytest.fixture(scope="module")
def by_current(robot):
    """Of a robot whose torques are currents times constants that are off."""
    logs = []
    for seed, (t, q, v, a) in MOTIONS.items():
        log = log_of(t, q, (NEEDED[seed] + ordinary(v, a)) / GAINS, seed)
        logs.append(dataclasses.replace(log, tau_kind="current"))
    return diagnose(robot, logs[0], test_log=logs[1])


def left_by(report, gains: bool) -> float:
    """Torque error at the joints of the other motion [N m, rms] by MuJoCo C and the numbers of a report.json alone."""
    _, _, v, a = MOTIONS[1]
    own = report["joints"].values()
    viscous, dry, rotor, bias = (
        np.array([j[name]["value"] for j in own])
        for name in ("viscous_friction", "coulomb_friction", "armature", "torque_bias")
    )
    needs = NEEDED[1] + viscous * v + dry * np.tanh(v / 0.002) + rotor * a - bias
    logged = (NEEDED[1] + ordinary(v, a)) / GAINS
    gain = np.array([j["torque_gain"]["value"] for j in own]) if gains else 1.0
    return float(np.sqrt(np.mean((gain * logged - needs) ** 2)))


@pytest.mark.slow
def test_a_report_s_numbers_alone_give_the_torque_of_motors_whose_gains_are_off(by_current):
    report = json.loads(json.dumps(to_report(by_current), allow_nan=False))
    for k, own in enumerate(report["joints"].values()):
        gain = own["torque_gain"]
        assert gain["unit"] == "1"
        assert gain["ci95"][0] < GAINS[k] < gain["ci95"][1]
        # What rubs at the joint does so after the motor's gain.
        assert own["coulomb_friction"]["value"] == pytest.approx(COULOMB[k], rel=0.05)
        assert own["viscous_friction"]["value"] == pytest.approx(VISCOUS[k], rel=0.05)
    assert left_by(report, gains=True) < 0.15 * left_by(report, gains=False)


def test_a_corrected_model_has_each_motor_s_gain(robot, by_current):
    spec = mujoco.MjSpec.from_string(NOMINAL)
    motor = spec.add_actuator(name="drive", target="elbow", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.gainprm[0] = 2.0
    done = correction(spec, robot, by_current)
    gain = by_current.gains["elbow"].value
    assert done.spec.compile().actuator_gainprm[0, 0] == pytest.approx(2.0 * gain)
    texts = [text.data for text in done.spec.texts]
    assert any(
        f"torque_gain at joint wrist: gain = {by_current.gains['wrist'].value:.6g}" in x
        for x in texts
    )
    # The step law gets from the report what the model's attributes do not hold.
    from_report = [e for e in effects_in(to_report(by_current)) if e.family == "torque_gain"]
    assert [e.values["gain"] for e in from_report] == [p.value for p in by_current.gains.values()]
    assert {e.name for e in done.by_callback if e.family == "torque_gain"} == set(by_current.gains)


def test_a_measured_torque_has_no_gain_in_its_report(plain):
    assert plain.gains == {}
    assert all("torque_gain" not in own for own in to_report(plain)["joints"].values())


def uneven(seed):
    """A wrist whose torque is all friction, which is uneven as gears are; nothing limits it."""
    t, q, v, a = MOTIONS[seed]
    model = mujoco.MjModel.from_xml_string(NOMINAL.replace('mass="0.6"', 'mass="0.01"'))
    rough = 1.0 + 0.3 * np.sin(11.0 * q[:, 2]) + 0.2 * np.sin(29.0 * q[:, 2] + 1.0)
    tau = needed(model, q, v, a) + ordinary(v, a)
    tau[:, 2] += COULOMB[2] * (rough - 1.0) * np.tanh(v[:, 2] / 0.002)
    return log_of(t, q, tau, seed)


@pytest.mark.slow
def test_torque_that_is_all_friction_is_no_limited_motor_s():
    robot = load_model(mujoco.MjModel.from_xml_string(NOMINAL.replace('mass="0.6"', 'mass="0.01"')))
    diagnosis = diagnose(robot, uneven(0), test_log=uneven(1))
    assert not [f for f in diagnosis.odd if f.family in ("torque_saturation", "torque_speed")]
    assert diagnosis.joints["wrist"]["coulomb_friction"].value == pytest.approx(0.25, rel=0.2)


def test_a_limit_that_is_there_is_found(robot):
    log, other = (at_its_voltage(seed, 3.0, np.inf) for seed in (0, 1))
    diagnosis = diagnose(robot, log, test_log=other)
    (first,) = [f for f in diagnosis.odd if f.place.name == "elbow"]
    assert first.family == "torque_saturation"
    assert first.parameters["limit"].value == pytest.approx(3.0, rel=0.03)


def test_a_report_is_json_of_the_contract(plain):
    report = json.loads(json.dumps(to_report(plain), allow_nan=False))
    assert {"verdict", "effects", "joints", "shrink", "remainder", "explained_share"} <= set(report)
    assert all(e["ordinary"] for e in report["effects"])
    assert report["shrink"]["test_log"]["after"] < report["shrink"]["test_log"]["before"]
    assert set(report["remainder"]["where"]) == set(report["joints"])
    assert [e["explained_heldout"] for e in report["effects"]] == pytest.approx(
        [e["share"] for e in report["effects"]], abs=0.1
    )
    low, high = report["shrink"]["heldout"]["ci95"]
    whole = report["shrink"]["heldout"]
    assert low <= 1.0 - whole["after"] / whole["before"] <= high
    assert [r["signal"] for r in report["where"]["regions"]] == ["q", "v", "tau"]
    assert all(sum(r["share"]) == pytest.approx(1.0) for r in report["where"]["regions"])
    assert sum(report["where"]["rows"].values()) == pytest.approx(1.0)
    shares = [b["share"] for b in report["where"]["bodies"]]
    assert shares == sorted(shares, reverse=True)
    assert report["remainder"]["with_shapes"] < report["shrink"]["test_log"]["before"]
    # Friction of tanh turns round at once: the smallest displacement there is.
    assert report["joints"]["elbow"]["coulomb_friction"]["presliding"]["value"] < 2e-4


def test_a_report_says_what_the_log_could_not_show_and_what_to_record(plain):
    report = to_report(plain)
    sizes = {(e["family"], e["location"]["name"]): e for e in report["undetectable_below"]}
    # A third of the hand's 0.6 kg, and some per cent of the elbow's torque, are seen beside noise of 0.01 N m.
    assert 0 < sizes["payload", "hand"]["value"] < 0.2
    assert 1.0 < sizes["torque_gain", "elbow"]["value"] < 1.1
    assert all(np.isfinite(e["value"]) and e["value"] != 0 for e in sizes.values())
    # Everything is told and checked on another run: nothing is left to ask for.
    assert report["suggested_motion"] == {}
    shoulder = plain.joints["shoulder"]
    unsure = shoulder | {"armature": dataclasses.replace(shoulder["armature"], low=0.0)}
    less = dataclasses.replace(plain, test=None, joints=plain.joints | {"shoulder": unsure})
    first, second = to_record(less)
    assert (first.between, first.where, first.kind) == (
        ("armature",),
        "shoulder",
        "starts and stops",
    )
    assert second.kind == "another motion"


def test_an_unknown_family_is_one_line(robot):
    t, q, *_ = MOTIONS[0]
    with pytest.raises(ValueError, match="unknown families \\['gremlins'\\]; valid: "):
        diagnose(robot, log_of(t, q, NEEDED[0]), exclude=["gremlins"])


@pytest.fixture(scope="module")
def residual(robot):
    t, q, v, a = MOTIONS[0]
    return Residual(robot, log_of(t, q, NEEDED[0] + ordinary(v, a)), Settings())


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_every_effect_keeps_the_interface(residual, effect):
    """Finite columns, a positive prior of as many numbers, and a report of them, at every place that it has."""
    for place in effect.places(residual.context)[:2]:
        for shape in list(effect.shapes(residual.context_of(effect), place))[:2]:
            columns, row = residual.rows_of(
                effect.columns(residual.context_of(effect), place, shape)
            )
            scale = effect.scale(residual.context, place, shape)
            assert columns.shape[-1] == len(scale)
            assert columns.ndim == (2 if row is not None else 3)
            assert np.all(np.isfinite(columns))
            assert np.all(scale > 0)
            numbers = effect.numbers(residual.context, place, shape, 0.5 * scale)
            assert all(np.isfinite(p.value) for p in numbers.values())
            assert numbers or not effect.named


@pytest.mark.slow
def test_what_swings_on_a_joint_is_placed_and_never_explained(robot):
    """A cover on a spring, by SciPy's Runge–Kutta: no effect is named so, and it takes a hundredth of the gap."""
    inertia, omega, ratio = 0.1, 2 * np.pi * 2.0, 0.05

    def swung(model, t, q, v, a, tau):
        def rates(now, state):
            at, speed = np.interp(now, t, q[:, 1]), np.interp(now, t, v[:, 1])
            pull = omega**2 * (at - state[0]) + 2 * ratio * omega * (speed - state[1])
            return state[1], pull

        state = solve_ivp(rates, t[[0, -1]], (q[0, 1], v[0, 1]), t_eval=t, max_step=2e-3).y
        out = tau.copy()
        out[:, 1] += inertia * rates(t, state)[1]
        return out

    diagnosis = found(robot, swung)
    assert diagnosis.verdict is Verdict.PARTLY
    assert diagnosis.remainder.share < 0.05
    assert diagnosis.remainder.resembles[0] == "something that swings on the joint at elbow"
    assert max(diagnosis.remainder.where, key=diagnosis.remainder.where.get) == "elbow"
    assert "swings on the joint at elbow" in diagnosis.headline


def test_names_are_distinct():
    names = [e.name for e in EFFECTS]
    assert len(set(names)) == len(names)
