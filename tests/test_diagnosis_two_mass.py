"""Motor and link apart: paths against closed forms and SciPy, and logs of a motor of its own beside MuJoCo C."""

import mujoco
import numpy as np
import pytest
from arm_log import ARM, TORQUE, asked, logged, wave
from scipy.integrate import solve_ivp

from jax_inertia import load_model
from jax_inertia.diagnosis.effects.identified import Identified
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.features.two_mass import DrivenLink, OwnFriction
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.diagnosis.simulate.corrected import corrected

MASS, STIFFNESS, RATIO = 0.8, 900.0, 0.02
TIME = np.arange(0.0, 6.0, 0.004)


def path(needed, carried, stiffness=STIFFNESS, dead_zone=0.0):
    still = np.zeros_like(TIME)
    link = DrivenLink(TIME, needed, carried, still + MASS, still, still)
    return link.separation((stiffness, RATIO, dead_zone, 1.0, 0.0))


@pytest.mark.parametrize("frequency", [0.7, 3.0, 5.3])
def test_a_link_on_a_spring_moves_as_the_closed_form_says(frequency):
    # Below and near the resonance of 5.3 Hz, from the first sample of a log that begins in the middle of the motion.
    omega, loss = 2 * np.pi * frequency, 2 * RATIO * np.sqrt(STIFFNESS * MASS)
    turn = np.exp(1j * omega * TIME)
    delta = 5.0 / (STIFFNESS - MASS * omega**2 + 1j * loss * omega) * turn
    carried = (STIFFNESS + 1j * loss * omega) * delta
    found = path(5.0 * turn.imag, carried.imag)
    # ṡ/K is the rate but for the spring's own loss, 2 ζ ω/ω₀ of it at the most.
    assert np.max(np.abs(found - delta.imag)) < 0.08 * np.abs(delta[0])


def test_a_predicted_link_is_right_at_its_resonance_but_for_how_it_began():
    """By SciPy, from a start that no motor shows: what is left of the path is a ringing of two numbers."""
    needed, loss = needed_near_resonance(), 2 * RATIO * np.sqrt(STIFFNESS * MASS)
    delta, _ = solved(needed, lambda x, v: STIFFNESS * x + loss * v, start=0.04)
    still = np.zeros_like(TIME)
    link = DrivenLink(TIME, needed, still, still + MASS, still, still).by_motion(needed)
    coupling = (STIFFNESS, RATIO, 0.0, 0.0, 0.0)
    apart, rings = delta - link.separation(coupling), link.ringing(coupling)
    left = apart - rings @ np.linalg.lstsq(rings, apart, rcond=None)[0]
    assert np.std(apart) > 0.1 * np.std(delta)
    assert np.std(left) < 0.02 * np.std(delta)


def test_noise_of_the_first_torques_does_not_ring():
    """Two samples of it would tell a speed that the link never had."""
    omega, loss = 2 * np.pi * 0.7, 2 * RATIO * np.sqrt(STIFFNESS * MASS)
    turn = np.exp(1j * omega * TIME)
    delta = (5.0 / (STIFFNESS - MASS * omega**2 + 1j * loss * omega) * turn).imag
    noise = 0.01 * 5.0 * np.random.default_rng(4).standard_normal((20, len(TIME)))
    errors = [path(5.0 * turn.imag, STIFFNESS * delta + x) - delta for x in noise]
    first, later = (np.std(np.array(errors)[:, part]) for part in (TIME < 0.3, TIME > 3.0))
    assert first < 5.0 * later


def needed_near_resonance():
    return sum(
        a * np.sin(2 * np.pi * f * TIME + f) for a, f in ((20.0, 0.6), (6.0, 2.0), (2.0, 4.6))
    )


def solved(needed, force, start=0.0):
    """Path and rate of the link by SciPy."""

    def rates(t, state):
        return state[1], (np.interp(t, TIME, needed) - force(*state)) / MASS

    return solve_ivp(rates, (0, TIME[-1]), [start, 0.0], t_eval=TIME, max_step=1e-3).y


def test_a_spring_that_hardens_does_not_ring_out_of_step():
    # A law of its own, 5 to 20 % stiffer where it is bent: the linear spring's own path is far off.
    needed, loss = needed_near_resonance(), 2 * RATIO * np.sqrt(STIFFNESS * MASS)

    def force(x, v):
        return STIFFNESS * x * (1 + 200.0 * x**2) + loss * v

    delta, rate = solved(needed, force)
    alone, _ = solved(needed, lambda x, v: STIFFNESS * x + loss * v)
    late = TIME > 1.0
    drawn = path(needed, force(delta, rate))
    assert np.std((drawn - delta)[late]) < 0.2 * np.std(delta[late])
    assert np.std((alone - delta)[late]) > 2 * np.std((drawn - delta)[late])


def test_teeth_meet_where_they_are_measured_to():
    # Hard teeth by SciPy, stiffer than the coupling that is tried: rattle that is a little late stays a little late.
    gap, needed = 0.02, needed_near_resonance()
    loss = 2 * 0.2 * np.sqrt(5 * STIFFNESS * MASS)

    def force(x, v):
        over = abs(x) - gap / 2
        push = 5 * STIFFNESS * over + np.sign(x) * loss * v
        return np.sign(x) * max(push, 0.0) if over > 0 else 0.0

    delta, rate = solved(needed, force, 0.011)
    carried = np.array([force(x, v) for x, v in zip(delta, rate, strict=True)])
    found = path(needed, carried, 4 * STIFFNESS, gap)
    assert np.std((found - delta)[TIME > 1.0]) < 0.15 * np.std(delta)


@pytest.mark.parametrize("of_link", [True, False], ids=["a hose at the link", "a sensor's zero"])
def test_a_constant_torque_moves_a_link_through_its_play_if_it_is_the_links(of_link):
    gap, pull = 0.02, 3.0
    needed, loss = 0.3 * needed_near_resonance(), 2 * RATIO * np.sqrt(STIFFNESS * MASS)

    def force(x, v):
        over = abs(x) - gap / 2
        push = STIFFNESS * over + np.sign(x) * loss * v
        return np.sign(x) * max(push, 0.0) if over > 0 else 0.0

    delta, rate = solved(needed - of_link * pull, force, 0.011)
    carried = np.array([force(x, v) for x, v in zip(delta, rate, strict=True)])
    # What the log says the motor gives: a sensor's zero is not in it.
    logged_torque = carried - (0.0 if of_link else pull)
    still = np.zeros_like(TIME)
    link = DrivenLink(TIME, needed, logged_torque, still + MASS, still, still, offset=pull)
    right, wrong = (
        np.std((link.separation((STIFFNESS, RATIO, gap, side, 0.0)) - delta)[TIME > 0.5])
        for side in (float(of_link), float(not of_link))
    )
    assert right < 0.1 * np.std(delta) < 0.5 * np.std(delta) < wrong


def test_a_link_that_rubs_stays_where_it_is_while_its_teeth_part():
    """Its own friction holds it in its play, by SciPy: friction of the motor's leaves it to what it needs."""
    gap, dry, viscous = 0.03, 6.0, 0.4
    speed, turned = 2.0 * np.cos(2 * np.pi * 0.6 * TIME), 2 * np.pi * 0.6
    inertial = -MASS * 2.0 * turned * np.sin(turned * TIME)
    loss = 2 * RATIO * np.sqrt(STIFFNESS * MASS)

    def teeth(x, v):
        over = abs(x) - gap / 2
        return np.sign(x) * max(STIFFNESS * over + np.sign(x) * loss * v, 0.0) if over > 0 else 0.0

    def rub(link):
        return dry * np.tanh(link / 2e-3) + viscous * link

    def rates(t, state):
        moving = np.interp(t, TIME, speed)
        push = np.interp(t, TIME, inertial) + rub(moving - state[1]) - teeth(*state)
        return state[1], push / MASS

    begun = [gap / 2 + rub(2.0) / STIFFNESS, 0.0]
    delta, rate = solve_ivp(
        rates, (0, TIME[-1]), begun, t_eval=TIME, method="LSODA", max_step=1e-3
    ).y
    carried = np.array([teeth(x, v) for x, v in zip(delta, rate, strict=True)])
    still = np.zeros_like(TIME)
    friction = OwnFriction(speed, viscous, dry, carried)
    link = DrivenLink(TIME, inertial, carried, still + MASS, still, still, friction)
    on_link, on_motor = ((STIFFNESS, RATIO, gap, 1.0, side) for side in (1.0, 0.0))
    late = TIME > 0.5
    assert np.std((link.separation(on_link) - delta)[late]) < 0.05 * np.std(delta)
    assert np.std((link.separation(on_motor) - delta)[late]) > 0.2 * np.std(delta)
    rubbed = dry * np.tanh((speed - rate) / 2e-3)
    assert np.mean(np.abs(link.rubbing(on_link) - rubbed)[late] > 0.2 * dry) < 0.05
    assert not link.rubbing(on_motor).any()


# The arm with the elbow's motor apart from its link: the same hinge twice, the second one passive.
APART = ARM.replace(
    '<joint name="elbow" axis="0 1 0.3" damping="0.2" armature="0.03"/>',
    """<joint name="elbow" axis="0 1 0.3" damping="0.2" armature="0.03"/>
<inertial mass="1e-4" pos="0 0 0" diaginertia="1e-6 1e-6 1e-6"/>
<body name="link"><joint name="twist" axis="0 1 0.3" COUPLING/>""",
).replace("</body></body></worldbody>", "</body></body></body></worldbody>")
APART = APART.replace("<mujoco>", '<mujoco><compiler angle="radian"/>')
SPRING = 'stiffness="60" damping="0.1"'
# MuJoCo's own law of a stop on either side: soft, and never pulling.
TEETH = 'limited="true" range="-{0} {0}" solreflimit="-1e5 -300" solimplimit="0.9 0.9 1"'


def log_of(
    coupling,
    seed=0,
    encoder=2e-5,
    friction=0.0,
    own=APART,
    wave=wave,
    ahead=0.0,
    of_link=(0.0, 0.0),
    pull=0.0,
    at_link=False,
):
    """A log of the real arm, whose encoders sit on the motors; `friction` of the elbow's motor [N m].

    `ahead`: how far its link is ahead of the motor when the log begins [rad]. `of_link`: dry [N m] and viscous
    [N m s/rad] friction between the elbow's link and the upper arm. `pull`: constant torque at its motor, or `at_link`
    [N m].
    """
    model = mujoco.MjModel.from_xml_string(own.replace("COUPLING", coupling))
    data = mujoco.MjData(model)
    data.qpos[:2], data.qvel[:2] = wave(0.0, seed)
    data.qpos[2] = ahead
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(4000):
        target, speed = wave(data.time, seed)
        u = asked(target, speed, data.qpos[:2], data.qvel[:2])
        seen = data.qpos[:2] + encoder * rng.standard_normal(2)
        rows.append((data.time, seen, u + TORQUE * rng.standard_normal(2)))
        for _ in range(4):
            data.qfrc_applied[:2] = u
            data.qfrc_applied[1] -= friction * np.tanh(data.qvel[1] / 0.01)
            speed = data.qvel[1] + data.qvel[2]
            rub = of_link[0] * np.tanh(speed / 0.005) + of_link[1] * speed
            data.qfrc_applied[2] = -rub + at_link * pull
            data.qfrc_applied[1] += pull - rub
            mujoco.mj_step(model, data)
    return logged(rows, encoder, TORQUE)


@pytest.mark.slow
def test_a_soft_joint_of_mujoco_is_named_and_sized():
    robot = load_model(mujoco.MjModel.from_xml_string(ARM))
    found = diagnose(robot, log_of(SPRING), test_log=log_of(SPRING, seed=5))
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("joint_elasticity", "elbow")
    assert effect.parameters["stiffness"].value == pytest.approx(60.0, rel=0.1)


@pytest.mark.slow
def test_a_soft_joint_behind_a_motor_with_friction_of_its_own():
    """As that friction turns round, or holds the motor, what the spring carries is not what it seems."""
    own = ARM.replace('damping="0.2"', 'damping="0.2" frictionloss="0.8"')
    robot = load_model(mujoco.MjModel.from_xml_string(own))
    logs = (log_of(SPRING, seed=seed, friction=0.8) for seed in (0, 5))
    found = diagnose(robot, next(logs), test_log=next(logs))
    (effect,) = found.odd
    assert found.verdict in (Verdict.EXPLAINED, Verdict.PARTLY)
    assert (effect.family, effect.place.name) == ("joint_elasticity", "elbow")
    assert effect.parameters["stiffness"].value == pytest.approx(60.0, rel=0.05)


@pytest.mark.parametrize("half", [pytest.param(0.01, marks=pytest.mark.slow), 0.0003])
@pytest.mark.slow
def test_play_between_stops_of_mujoco_is_named_and_sized(half):
    robot, teeth = load_model(mujoco.MjModel.from_xml_string(ARM)), TEETH.format(half)
    found = diagnose(robot, log_of(teeth), test_log=log_of(teeth, seed=5))
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("backlash", "elbow")
    assert effect.parameters["dead_zone"].value == pytest.approx(2 * half, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("of_link", [True, False], ids=["a hose at the link", "a sensor's zero"])
def test_play_of_a_robot_as_bought_that_a_constant_torque_pulls(of_link):
    """A model without friction and rotor inertia, and a torque of a sixth of the elbow's peak."""
    bare = ARM.replace('damping="0.2" armature="0.03"', "")
    robot, half = load_model(mujoco.MjModel.from_xml_string(bare)), 0.01
    logs = [
        log_of(TEETH.format(half), seed, friction=0.4, pull=0.6, at_link=of_link) for seed in (0, 5)
    ]
    found = diagnose(robot, logs[0], test_log=logs[1])
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("backlash", "elbow")
    assert effect.parameters["dead_zone"].value == pytest.approx(2 * half, rel=0.15)
    assert ("offset_on_link" in effect.parameters) == of_link
    assert found.joints["elbow"]["torque_bias"].value == pytest.approx(0.6, rel=0.15)


@pytest.mark.slow
def test_play_before_a_link_that_rubs_is_named_and_sized():
    """Friction that the model has at the joint, and that is the link's: it holds the link while the teeth part."""
    own = ARM.replace('damping="0.2"', 'damping="0.2" frictionloss="0.5"')
    rubbing = APART.replace('damping="0.2"', 'damping="0"')
    robot, half = load_model(mujoco.MjModel.from_xml_string(own)), 0.01
    logs = [log_of(TEETH.format(half), seed, own=rubbing, of_link=(0.5, 0.2)) for seed in (0, 5)]
    found = diagnose(robot, logs[0], test_log=logs[1])
    (effect,) = found.odd
    assert found.verdict is Verdict.EXPLAINED
    assert (effect.family, effect.place.name) == ("backlash", "elbow")
    assert effect.parameters["dead_zone"].value == pytest.approx(2 * half, rel=0.1)
    assert effect.parameters["friction_on_link"].value == 1.0
    assert found.test.share > 0.9


def test_the_corrected_models_constant_torque_pulls_at_the_link():
    """Wherever motor and link are: on both hinges alike, as a force at the link is."""
    values = {"stiffness": 80.0, "dead_zone": 0.04, "offset_on_link": 1.0}
    for pull, expected in ((1.0, 0.7), (0.0, 0.0)):
        made = corrected(
            mujoco.MjSpec.from_string(ARM),
            [
                Identified("torque_bias", "joint", "elbow", {"bias": 0.7}),
                Identified("backlash", "joint", "elbow", values | {"offset_on_link": pull}),
            ],
        )
        model = made.spec.compile()
        data = mujoco.MjData(model)
        elbow, between = (model.joint(n).dofadr[0] for n in ("elbow", "elbow_deflection"))
        for motor, ahead in ((0.4, 0.01), (-1.2, -0.015)):
            data.qpos[[elbow, between]] = motor, ahead
            mujoco.mj_forward(model, data)
            pulled = data.qfrc_passive[[elbow, between]]
            np.testing.assert_allclose(pulled, [0.7, expected], rtol=5e-3)


def test_the_corrected_models_friction_follows_the_link():
    own = ARM.replace('damping="0.2"', 'damping="0.2" frictionloss="0.5"')
    values = {"stiffness": 80.0, "dead_zone": 0.04, "friction_on_link": 1.0}
    made = corrected(
        mujoco.MjSpec.from_string(own), [Identified("backlash", "joint", "elbow", values)]
    )
    model = made.spec.compile()
    data = mujoco.MjData(model)
    elbow, between = (model.joint(n).dofadr[0] for n in ("elbow", "elbow_deflection"))
    shoulder = model.joint("shoulder").dofadr[0]
    for motor, link in ((1.0, 0.5), (-1.0, 1.0), (2.0, -1.0)):
        data.qvel[[elbow, between]] = motor, link - motor
        mujoco.mj_forward(model, data)
        rubs = data.qfrc_passive + data.qfrc_constraint
        expected = -(0.2 * link + 0.5 * np.sign(link))
        np.testing.assert_allclose(rubs[[elbow, between]], expected, atol=0.01)
        assert rubs[shoulder] == 0.0
