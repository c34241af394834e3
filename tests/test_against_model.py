"""What everybody gets wrong first, on two arms by MuJoCo's inverse dynamics: said in one line, and nothing else is."""

import dataclasses
import re

import mujoco
import numpy as np
import pytest

import jax_inertia as ji
from jax_inertia.cli.main import main
from jax_inertia.logs.findings import Severity
from jax_inertia.model.lock import locked
from jax_inertia.preflight.against_model import against_model
from jax_inertia.preflight.preflight import preflight
from jax_inertia.robots.pendulum import double_pendulum, swing
from jax_inertia.signals.corrections import mounted, with_later_torque, with_model_gravity

RATE, SECONDS = 250.0, 10.0


def arm_xml(sizes: tuple[float, ...], masses: tuple[float, ...], gravity="0 0 -9.81") -> str:
    """A chain of links that turn about z, then y and x by turns."""
    axes = ["0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0"]
    body, end = "", ""
    for k, (size, mass) in enumerate(zip(sizes, masses, strict=True)):
        i = mass * size**2 / 12.0
        where = "0 0 0" if k == 0 else f"{sizes[k - 1]} 0 0.02"
        body += (
            f'<body name="link{k}" pos="{where}"><joint name="j{k}" axis="{axes[k]}"/>'
            f'<inertial mass="{mass}" pos="{0.5 * size} 0.01 0" diaginertia="{i / 2} {i} {i}"/>'
        )
        end += "</body>"
    return f'<mujoco><compiler angle="radian"/><option gravity="{gravity}"/><worldbody>{body}{end}</worldbody></mujoco>'


SIZES, MASSES = (0.1, 0.4, 0.35, 0.15, 0.1), (3.0, 5.0, 2.5, 1.2, 0.6)
SMALL = (0.05, 0.12, 0.1), (0.2, 0.15, 0.08)


def motion(joints: int, time: np.ndarray, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    q = 0.5 * rng.normal(size=joints) * np.ones((len(time), 1))
    for f in (0.15, 0.4, 0.7):
        phase = rng.uniform(0, 2 * np.pi, joints)
        q = q + 0.12 / f**0.7 * np.sin(2 * np.pi * f * time[:, None] + phase)
    return q


def log_of(
    xml: str, *, seed: int = 1, noise: float = 0.0, load: float = 0.0, sag=None, **more
) -> ji.Log:
    """A log by mj_inverse along a smooth motion; `load` at the last link, `sag` is added to the model's zeros."""
    spec = mujoco.MjSpec.from_string(xml)
    if load:
        body = spec.bodies[-1].add_body(name="load", pos=[0.08, 0.03, 0.05])
        body.explicitinertial, body.mass, body.inertia = True, load, np.full(3, 1e-4 * load)
    model = spec.compile()
    data, n = mujoco.MjData(model), model.nv
    time = np.arange(int(SECONDS * RATE)) / RATE
    step = 1e-4
    q, before, after = (motion(n, time + d, seed) for d in (0.0, -step, step))
    v, a = (after - before) / (2 * step), (after - 2 * q + before) / step**2
    tau = np.zeros_like(q)
    for k in range(len(time)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k] + (0 if sag is None else sag), v[k], a[k]
        mujoco.mj_inverse(model, data)
        tau[k] = data.qfrc_inverse
    rng = np.random.default_rng(2)
    tau = tau + noise * np.abs(tau).max(axis=0) * rng.normal(size=tau.shape)
    names = tuple(model.joint(j).name for j in range(n))
    return ji.Log(time=time, joint_names=names, qpos=q, tau=tau, **more)


ARMS = {"large": arm_xml(SIZES, MASSES), "small": arm_xml(*SMALL)}


@pytest.fixture(scope="module", params=list(ARMS))
def arm(request):
    xml = ARMS[request.param]
    return xml, ji.load_model(mujoco.MjModel.from_xml_string(xml)), log_of(xml, noise=0.01)


def speed(log: ji.Log) -> np.ndarray:
    return np.gradient(np.asarray(log.qpos), np.asarray(log.time), axis=0)


def friction(log: ji.Log, share: float) -> np.ndarray:
    """Dry and viscous friction, a share of each joint's largest torque each."""
    v = speed(log)
    size = share * np.abs(log.tau).max(axis=0)
    return size * np.tanh(v / 0.02) + size * v / np.abs(v).max(axis=0)


def only(robot, log, check: str) -> str:
    """The message of the one finding there is."""
    found = against_model(log, robot)
    assert [f.check for f in found] == [check], [str(f) for f in found]
    assert "\n" not in found[0].message
    return found[0].message


def test_a_sound_log_is_passed(arm):
    """A load, another motion, a gain, a short delay, a model that is off: all for a diagnosis."""
    xml, robot, log = arm
    joints = log.tau.shape[1]
    gains = np.where(np.arange(joints) % 2, 1.2, 0.8)
    heavier = robot.with_pi((1,), 1.3 * robot.pi[1:2])
    for passed in (
        log,
        dataclasses.replace(log, tau=log.tau * gains),
        with_later_torque(log, 0.02),
        log_of(xml, seed=4, load=0.3 * float(robot.pi[:, 0].sum()) / joints),
    ):
        assert against_model(passed, robot) == ()
    assert against_model(log, heavier) == ()
    assert against_model(swing(load=0.5), ji.load_model(double_pendulum())) == ()


def test_torque_without_gravity(arm):
    _, robot, log = arm
    still = dataclasses.replace(log, tau=0.0 * log.tau)
    bare = dataclasses.replace(log, tau=log.tau - with_model_gravity(still, robot).tau)
    assert "--gravity-compensated" in only(robot, bare, "gravity")
    assert against_model(with_model_gravity(bare, robot), robot) == ()


def test_external_torque_only(arm):
    xml, robot, log = arm
    loaded = log_of(xml, load=0.2 * float(robot.pi[-1, 0]))
    outside = dataclasses.replace(log, tau=loaded.tau - log_of(xml).tau)
    for sign in (1.0, -1.0):
        message = only(robot, dataclasses.replace(outside, tau=sign * outside.tau), "external")
        assert "external torque" in message


def test_motor_side_torque_and_other_units(arm):
    _, robot, log = arm
    motor = dataclasses.replace(log, tau=log.tau / 25)
    thousand = dataclasses.replace(log, tau=log.tau * 1000)
    for wrong, gain in ((motor, 25.0), (thousand, 1e-3)):
        (told,) = re.findall(r"--gains ([0-9.e-]+)", only(robot, wrong, "unit"))
        assert float(told) == pytest.approx(gain, rel=0.01)
    kt = np.linspace(8, 14, log.tau.shape[1])
    amperes = dataclasses.replace(log, tau=(log.tau + friction(log, 0.1)) / kt)
    assert "--tau-unit A" in only(robot, amperes, "unit")
    named = dataclasses.replace(motor, tau_unit="unknown", tau_unit_text="motor")
    assert against_model(named.with_torque_gains(25.0), robot) == ()


def test_signs_and_order(arm):
    _, robot, log = arm
    assert "every joint" in only(robot, dataclasses.replace(log, tau=-log.tau), "sign")
    one = np.where(np.arange(log.tau.shape[1]) == 1, -1.0, 1.0)
    assert "j1 is minus" in only(robot, dataclasses.replace(log, tau=one * log.tau), "sign")
    swapped = np.asarray(log.tau)[:, [0, 2, 1, *range(3, log.tau.shape[1])]]
    assert "'j2'" in only(robot, dataclasses.replace(log, tau=swapped), "order")


@pytest.mark.parametrize("joints", [2, 5])
@pytest.mark.parametrize("kind", ["tau", "qpos", "names"])
def test_columns_in_another_order_beside_a_load(tmp_path, joints, kind):
    """Two columns exchanged, half the robot's end again in the hand: named, and undone by what the message says."""
    xml = arm_xml(SMALL[0][1:], SMALL[1][1:]) if joints == 2 else ARMS["large"]
    robot = ji.load_model(mujoco.MjModel.from_xml_string(xml))
    log = log_of(xml, load=0.5 * float(robot.pi[-1, 0]), noise=0.01)
    order = [1, 0] if joints == 2 else [0, 2, 1, 3, 4]
    wrong = {
        "tau": lambda: dataclasses.replace(log, tau=log.tau[:, order]),
        "qpos": lambda: dataclasses.replace(log, qpos=log.qpos[:, order]),
        "names": lambda: dataclasses.replace(
            log, joint_names=tuple(log.joint_names[j] for j in order)
        ),
    }[kind]()
    message = only(robot, wrong, "order")
    path, mended = tmp_path / "log.csv", tmp_path / "mended.csv"
    ji.write_log(wrong, path)
    options = re.findall(r"--(?:column|rename) \S+", message)
    assert len(options) == 2, message
    assert main(["convert", str(path), str(mended), *" ".join(options).split()]) == 0
    assert against_model(ji.read_log(mended), robot) == ()


def test_degrees_axes_and_zeros(arm):
    xml, robot, log = arm
    loaded = log_of(xml, load=float(robot.pi[-1, 0]))
    for one in (log, loaded):
        inside = dataclasses.replace(one, qpos=np.degrees(one.qpos))
        assert "--degrees" in only(robot, inside, "degrees")
    one = np.where(np.arange(log.tau.shape[1]) == 1, -1.0, 1.0)
    turned = dataclasses.replace(log, qpos=one * log.qpos, tau=one * log.tau)
    assert "'j1' runs the other way" in only(robot, turned, "axis")
    for turn, text in ((np.pi, "180"), (0.5 * np.pi, "90")):
        sag = np.where(np.arange(log.tau.shape[1]) == 2, turn, 0.0)
        message = only(robot, log_of(xml, sag=sag), "zero")
        assert text in message
        assert "j2" in message


def test_late_channels(arm):
    _, robot, log = arm
    for late in (0.15, -0.1):
        moved = with_later_torque(log, late)
        message = only(robot, moved, "late")
        (told,) = re.findall(r"runs ([0-9]+) ms", message)
        assert float(told) == pytest.approx(1e3 * abs(late), abs=4)
        assert ("behind" if late > 0 else "ahead") in message
        shift = float(message.rsplit(maxsplit=1)[-1])
        assert shift == pytest.approx(-late, abs=0.004)
        assert against_model(with_later_torque(moved, shift), robot) == ()


@pytest.mark.parametrize("angles", [(180.0, 0.0), (-90.0, 0.0), (20.0, 35.0)])
def test_a_turned_mount(arm, angles):
    xml, robot, _ = arm
    gravity = np.asarray(mounted(robot, angles).gravity)
    log = log_of(xml.replace("0 0 -9.81", " ".join(map(str, gravity))), noise=0.01)
    message = only(robot, log, "mount")
    told = [float(x) for x in message.rsplit("--mount", 1)[-1].strip(" =").split(",")]
    assert against_model(log, mounted(robot, told)) == ()


@pytest.mark.parametrize("direction", [(1.2, 0.0, 0.0), (1.6, 0.2, 0.6)])
def test_a_constant_force_is_no_turned_mount(arm, direction):
    """Torque by MuJoCo's own Jacobian of a body's centre of mass; the force is some of the weight that it carries."""
    xml, robot, log = arm
    model = mujoco.MjModel.from_xml_string(xml)
    data, body, held = mujoco.MjData(model), 3, np.zeros_like(log.tau)
    force = 9.81 * model.body_subtreemass[body] * np.array(direction)
    for k, q in enumerate(log.qpos):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
        held[k] = jacobian.T @ force
    pulled = dataclasses.replace(log, tau=log.tau - held)
    assert "mount" not in [finding.check for finding in against_model(pulled, robot)]


def test_a_tilt_that_a_constant_force_resembles_is_left_to_the_diagnosis(arm):
    xml, robot, _ = arm
    gravity = np.asarray(mounted(robot, (10.0, 15.0)).gravity)
    log = log_of(xml.replace("0 0 -9.81", " ".join(map(str, gravity))), noise=0.01)
    assert "mount" not in [finding.check for finding in against_model(log, robot)]


def test_a_differential_pair(arm):
    """Shoulder and elbow driven by two motors, each by the sum of both or by their difference."""
    _, robot, log = arm
    tau = np.array(log.tau)
    tau[:, 1] = 0.5 * (log.tau[:, 1] + log.tau[:, 2])
    tau[:, 2] = 0.5 * (log.tau[:, 1] - log.tau[:, 2])
    message = only(robot, dataclasses.replace(log, tau=tau), "coupled")
    told = re.findall(r"j(.) = ([0-9.]+) tau\[j1\] (.) ([0-9.]+) tau\[j2\]", message)
    assert [(joint, sign) for joint, _, sign, _ in told] == [("1", "+"), ("2", "-")]
    assert [float(x) for _, a, _, b in told for x in (a, b)] == pytest.approx([1.0] * 4, abs=0.05)


def test_inertia_in_other_units():
    xml = ARMS["large"]
    robot = ji.load_model(mujoco.MjModel.from_xml_string(xml))
    absurd = robot.with_pi((2,), robot.pi[2:3].at[:, 4:].multiply(1e6))
    found = against_model(log_of(xml), absurd)
    assert [f.check for f in found] == ["inertia_unit"]
    assert "link2" in found[0].message


def test_a_model_without_friction(arm):
    _, robot, log = arm
    rubs = dataclasses.replace(log, tau=log.tau + friction(log, 0.1))
    (found,) = against_model(rubs, robot)
    assert (found.check, found.severity) == ("no_friction", Severity.WARNING)
    knows = dataclasses.replace(robot, damping=robot.damping + 0.01)
    assert against_model(rubs, knows) == ()


def test_preflight_says_it(arm):
    _, robot, log = arm
    found = preflight(dataclasses.replace(log, tau=-log.tau), robot)
    assert [f.check for f in found.findings if f.severity is Severity.ERROR] == ["sign"]


def test_held_joints_are_no_joints():
    """A wrist that stands still in the log, and is held in the model."""
    xml = ARMS["large"]
    robot, log = ji.load_model(mujoco.MjModel.from_xml_string(xml)), log_of(xml)
    fewer = log.select(log.joint_names[:-1])
    assert not preflight(fewer, robot).ok
    held = locked(robot, {"j4": 0.0})
    assert preflight(fewer, held).ok
