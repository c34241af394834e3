"""Position-controlled robots: replays against closed forms and MuJoCo's own steps, and what is found of them."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from schemas import validated

import jax_inertia as ji
from jax_inertia.cli import command_page, replay_run
from jax_inertia.cli.main import main
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.logs.log import Log, LogError
from jax_inertia.maths.sample_weight import autocorrelation_time
from jax_inertia.replay import checks, command
from jax_inertia.replay.loop import Parameter, position_loop
from jax_inertia.replay.output.policy import policy
from jax_inertia.replay.pipeline import diagnose
from jax_inertia.replay.record import SETTLING, record_of, step_means
from jax_inertia.replay.result import Effect, Size
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import replay
from jax_inertia.replay.step_law import StepLaw
from jax_inertia.text.report_page import with_section

CASES = Path(__file__).parents[2] / "shared" / "cases" / "position_controlled"
# A rotor of 0.05 kg m² without weight: its loop has a closed form.
ROTOR = """
<mujoco><option gravity="0 0 0"/><worldbody><body name="rotor"><joint name="hinge" axis="0 0 1"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.05 0.05 0.05"/></body></worldbody>{}</mujoco>"""
SERVO = '<actuator><position name="servo" joint="hinge" kp="5" kv="0.4"/></actuator>'
ARM = """
<mujoco><worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0" armature="0.02" damping="0.05" frictionloss="0.1"/>
<inertial pos="0 0 -0.12" mass="1" diaginertia="0.006 0.006 0.001"/>
<body name="lower" pos="0 0 -0.25"><joint name="elbow" axis="0 1 0" armature="0.01" damping="0.05" frictionloss="0.1"/>
<inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.002 0.002 0.0004"/></body></body></worldbody>
<actuator><position joint="shoulder" kp="40" kv="1.5" forcerange="-30 30"/>
<position joint="elbow" kp="25" kv="0.8" forcerange="-30 30"/></actuator></mujoco>"""
NAMES = ("shoulder", "elbow")


def arm():
    return mujoco.MjSpec.from_string(ARM)


def rotor(text: str = SERVO):
    return mujoco.MjSpec.from_string(ROTOR.format(text))


def run(*, delay=0.0, kp=(1.0, 1.0), dry=(0.0, 0.0), damping=0.0, seed=0, seconds=8.0) -> Log:
    """The arm by MuJoCo C at 0.5 ms: a 1 kHz loop, targets held at 50 Hz, encoders of 14 bit, a log of 200 Hz."""
    spec = arm()
    for a in list(spec.actuators):
        spec.delete(a)
    m = spec.compile()
    m.opt.timestep = 5e-4
    m.dof_frictionloss[:] += dry
    m.dof_damping[:] += damping
    d, rng = mujoco.MjData(m), np.random.default_rng(seed)
    gains, damps = np.array([40.0, 25.0]) * kp, np.array([1.5, 0.8])
    at = np.arange(0, seconds, 0.02)
    told = 0.5 * np.sin(2 * np.pi * np.outer(at, rng.uniform(0.3, 0.9, 2)))
    told += 0.3 * np.sin(2 * np.pi * np.outer(at, rng.uniform(1.0, 1.8, 2)))
    jumps = rng.normal(size=(len(at) // 50 + 1, 2)) * 0.15
    told += np.repeat(jumps, 50, axis=0)[: len(at)]
    d.qpos[:] = told[0]
    rows = []
    for k in range(int(seconds / m.opt.timestep) - 1):
        t = k * m.opt.timestep
        if k % 2 == 0:
            now = told[max(int((t - delay + 1e-9) / 0.02), 0)]
            d.qfrc_applied[:] = gains * (now - d.qpos) - damps * d.qvel
        if k % 10 == 0:
            rows.append((t, *d.qpos, *told[int((t + 1e-9) / 0.02)], *d.qfrc_applied))
        mujoco.mj_step(m, d)
    x = np.array(rows)
    count = 2 * np.pi / 2**14
    return Log(
        time=x[:, 0],
        joint_names=NAMES,
        qpos=np.round(x[:, 1:3] / count) * count,
        tau=x[:, 5:7],
        qpos_target=x[:, 3:5],
    )


def without_torque(log: Log) -> Log:
    return Log(
        time=log.time, joint_names=log.joint_names, qpos=log.qpos, qpos_target=log.qpos_target
    )


def step_log(period: float = 0.01) -> Log:
    time = np.arange(0, 3.0, period)
    target = np.where(time >= 0.5, 1.0, 0.0)[:, None]
    return Log(time=time, joint_names=("hinge",), qpos=np.zeros_like(target), qpos_target=target)


@pytest.mark.parametrize("late", [0.0, 0.0137])
def test_a_step_is_answered_as_a_damped_oscillator_does(late):
    log = step_log()
    spec = rotor()
    plant = Plant(spec, log.joint_names, position_loop(log, spec.compile()))
    # What the model's own steps of 2 ms do is undone: they act half of one too early, and take from the inertia.
    table = tuple(Parameter(f, -1, 0.0, 1.0, -1.0, 1.0) for f in ("target_delay", "own_steps"))
    whole = np.array([[late + 0.001, 0.001]])
    path = replay(plant, table, whole, record_of(log))[0, :, 0]
    omega, half = np.sqrt(5 / 0.05), 0.4 / 0.05 / 2
    fast = np.sqrt(omega**2 - half**2)
    t = np.maximum(log.time - 0.5 - late, 0.0)
    right = 1 - np.exp(-half * t) * (np.cos(fast * t) + half / fast * np.sin(fast * t))
    np.testing.assert_allclose(path, right, atol=2e-3)


def test_a_stretch_starts_at_the_speed_that_it_has():
    """Of 0.9 Hz, which jerks: a parabola through what follows errs by 30 mrad/s."""
    time = np.arange(0.0, 3.0, 0.002)
    log = Log(
        time=time, joint_names=("hinge",), qpos=np.sin(5.65 * time)[:, None], qpos_target=0 * time[:, None]
    )  # fmt: skip
    stretch = record_of(log).between(700, 1400).between(0, 500)
    assert stretch.start[0] == pytest.approx(5.65 * np.cos(5.65 * time[700]), abs=1e-3)


def test_controls_are_means_of_held_targets():
    record = record_of(step_log(0.02))
    told = record.commanded
    out = step_means(told.time, told.position, 0.002, 1000, np.array([0.0005]), np.zeros(1))
    # The step of 0.5 s comes a quarter of a step into [0.5, 0.502).
    np.testing.assert_allclose(out[248:252, 0], [0.0, 0.0, 0.75, 1.0], atol=1e-9)
    later = record.between(30, 100)
    assert later.target[0] == 1.0
    told = later.commanded
    out = step_means(told.time, told.position, 0.002, 100, np.array([0.2]), np.zeros(1))
    # What was told before the stretch began arrives in it.
    np.testing.assert_allclose(out[[0, 49, 51], 0], [0.0, 0.0, 1.0], atol=1e-9)


def test_a_lag_is_a_first_order_one():
    told = record_of(step_log(0.02)).commanded
    out = step_means(told.time, told.position, 1e-3, 2500, np.zeros(1), np.array([0.1]))
    assert out[600, 0] == pytest.approx(1 - np.exp(-0.1 / 0.1), abs=0.01)


def test_a_loop_is_of_the_option_the_log_or_the_model():
    log, model = step_log(), rotor().compile()
    assert position_loop(log, model).source == "model"
    said = Log(**{**vars(log), "kp": np.array([7.0]), "kd": np.array([0.1])})
    loop = position_loop(said, model)
    assert (loop.kp[0], loop.kd[0], loop.source) == (7.0, 0.1, "log")
    assert position_loop(said, model, model_first=True).kp[0] == 5.0
    assert position_loop(said, model, [9.0]).kp[0] == 9.0
    with pytest.raises(LogError, match=r"kp of hinge is not known: .* give --kp"):
        position_loop(log, rotor("").compile())
    with pytest.raises(ValueError, match=r"--kp has 2 values; expected one"):
        position_loop(log, model, [1.0, 2.0])


def test_what_signs_and_zeros_look_like():
    time = np.arange(0, 5, 0.01)
    target = 0.4 * np.sin(2 * time)[:, None]

    def said(q):
        log = Log(time=time, joint_names=("hinge",), qpos=q, qpos_target=target)
        return " ".join(checks.objections(record_of(log), log.joint_names))

    assert said(target) == ""
    assert "against its targets" in said(-target)
    assert "same zero" in said(target + 0.7)


def test_noise_of_encoders_is_that_of_their_counts():
    time = np.arange(0, 20, 0.005)
    smooth = np.sin(time)[:, None] * [1.0, 1.0]
    rng = np.random.default_rng(0)
    counts = np.round(smooth[:, 0] / 1.5e-3) * 1.5e-3
    q = np.stack([counts, smooth[:, 1] + 1e-3 * rng.normal(size=len(time))], axis=1)
    np.testing.assert_allclose(checks.encoder_noise(q), [1.5e-3 / np.sqrt(12), 1e-3], rtol=0.1)


def test_autocorrelation_time_of_a_first_order_process():
    rng, rho = np.random.default_rng(0), 0.9
    x = np.zeros(40_000)
    for k in range(1, len(x)):
        x[k] = rho * x[k - 1] + rng.normal()
    assert autocorrelation_time(x) == pytest.approx((1 + rho) / (1 - rho), rel=0.2)
    assert autocorrelation_time(rng.normal(size=40_000)) == pytest.approx(1.0, abs=0.2)


def test_a_sound_robot_has_no_gap():
    found = diagnose([without_torque(run())], arm)
    assert found.verdict is Verdict.NO_GAP
    assert found.effects == ()
    # Its loop runs at 1 kHz and the model in steps of 2 ms: that is a clock, and no gap.
    assert {name for name, _ in found.clock} >= {"own_steps"}
    assert np.all(found.replayed.after <= 1.3 * found.replayed.floor)
    assert np.all(found.replayed.before > 5 * found.replayed.floor)
    model = mujoco.MjModel.from_xml_string(found.text)
    np.testing.assert_array_equal(model.actuator_gainprm[:, 0], [40.0, 25.0])


@pytest.mark.parametrize(
    ("effects", "family", "place", "size", "tolerance"),
    [
        ({"delay": 0.02}, "target_delay", "global", 0.02, 2e-3),
        pytest.param({"kp": (1.0, 0.7)}, "kp_scale", "elbow", 0.7, 0.03, marks=pytest.mark.slow),
        pytest.param(
            {"dry": (0.6, 0.0)}, "coulomb_friction", "shoulder", 0.6, 0.06, marks=pytest.mark.slow
        ),
    ],
)
def test_what_is_wrong_is_found_and_its_replay_proves_it(effects, family, place, size, tolerance):
    log, other = (without_torque(run(**effects, seed=k)) for k in (0, 1))
    found = diagnose([log], arm, test_log=other)
    assert found.verdict is Verdict.EXPLAINED
    first = found.effects[0]
    assert (first.family, first.name) == (family, place)
    assert first.size.value == pytest.approx(size, abs=tolerance)
    assert first.size.low < size < first.size.high
    assert sum(found.replayed.after**2) < 0.1**2 * sum(found.replayed.before**2)
    assert found.worse == ()
    # corrected.xml replays in MuJoCo, stepped by nobody else, as was promised: its own delay and all.
    model = mujoco.MjModel.from_xml_string(found.text)
    r = found.replayed.records[0]
    h = model.opt.timestep
    assert h == 2e-3
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = r.q[0], r.start
    error = []
    for k in range(int(r.time[-1] / h)):
        row = int((k * h + 1e-9) / r.period)
        data.ctrl[:] = r.target[min(row, len(r.time) - 1)]
        if k * h > 1.0 and k % 5 == 0 and row * r.period == pytest.approx(k * h):
            error.append(data.qpos - r.q[row])
        mujoco.mj_step(model, data)
    rms = np.sqrt(np.mean(np.square(error), axis=0))
    assert np.all(rms < found.replayed.after + found.replayed.floor)
    told = policy(found)
    low, high = told["all_joints"]["delay"]["range"] if place == "global" else [0.0, 1.0]
    assert low <= high
    json.dumps(told, allow_nan=False)


def test_targets_and_torque_show_the_loop():
    log = run(delay=0.02, kp=(1.0, 0.75))
    halves = command.command_half(log)
    assert [h.joint for h in halves] == list(NAMES)
    np.testing.assert_allclose([h.kp for h in halves], [40.0, 25.0 * 0.75], rtol=0.02)
    np.testing.assert_allclose([h.kd for h in halves], [1.5, 0.8], rtol=0.1)
    np.testing.assert_allclose([h.delay for h in halves], 0.02, atol=2e-3)
    found = command.findings(halves, np.array([40.0, 25.0]), np.array([1.5, 0.8]), NAMES)
    assert {(e["family"], e["location"]["name"]) for e in found} == {
        ("target_delay", "global"),
        ("kp_scale", "elbow"),
    }
    assert (
        command.findings(
            command.command_half(run()), np.array([40.0, 25.0]), np.array([1.5, 0.8]), NAMES
        )
        == []
    )
    assert command.command_half(without_torque(log)) == ()


def test_the_loop_is_drawn_with_the_line_of_its_kp():
    log = run(kp=(1.0, 0.75), seconds=4.0)
    loop = position_loop(log, arm().compile())
    halves = command.command_half(log, loop)
    miss, torque = command_page.spring(command.rows_of(log, loop)[1], halves[1])
    assert np.polyfit(miss, torque, 1)[0] == pytest.approx(25.0 * 0.75, rel=0.02)
    effects = command.findings(halves, loop.kp, loop.kd, NAMES)
    page = with_section(
        '<main><p class="soft">jax-inertia</p></main>',
        command_page.part(halves, log, loop, effects),
    )
    assert page.startswith("<main><section")
    assert page.endswith('</section>\n<p class="soft">jax-inertia</p></main>')
    assert "kp scale at elbow" in page


def test_every_number_of_an_effect_is_in_the_table():
    numbers = (
        ("stall", Size(3.0, 2.9, 3.1, "N m")),
        ("no_load_speed", Size(9.0, 8.0, 10.0, "rad/s")),
    )
    effect = Effect("torque_speed", "joint", "elbow", numbers, 0.0, 0.5, 0.9, False, ())
    said = replay_run.sizes(effect)
    assert "stall 3 [2.9, 3.1] N m" in said
    assert "no load speed 9 [8, 10] rad/s" in said


def test_targets_on_their_way_are_the_first_ones_at_a_start():
    """A joint at its target stays there, its delay notwithstanding; without `start` it is pulled to 0 first."""
    spec = rotor()
    spec.joint("hinge").ref = 0.0
    spec.actuators[0].delay, spec.actuators[0].nsample = 0.05, 60
    model = spec.compile()
    ends = []
    for begins in (lambda d: StepLaw(model).start(d, np.array([0.7])), lambda d: None):
        data = mujoco.MjData(model)
        data.qpos[:] = 0.7
        begins(data)
        for _ in range(20):
            data.ctrl[:] = 0.7
            mujoco.mj_step(model, data)
        ends.append(data.qpos[0])
    assert ends[0] == pytest.approx(0.7, abs=1e-9)
    assert ends[1] < 0.69


def test_a_torque_that_is_cut_off_shows_its_limit():
    time = np.arange(0, 10, 0.002)
    target = 0.8 * np.sign(np.sin(2 * np.pi * 0.5 * time))[:, None]
    q = 0.5 * np.sin(2 * np.pi * 0.5 * time - 0.5)[:, None]
    v = np.gradient(q[:, 0], time)[:, None]
    tau = np.clip(30 * (target - q) - 0.5 * v, -20, 20)
    log = Log(time=time, joint_names=("hinge",), qpos=q, qvel=v, tau=tau, qpos_target=target)
    half = command.command_half(log)[0]
    assert half.limit == pytest.approx(20.0)
    assert half.kp == pytest.approx(30.0, rel=0.01)


def test_what_a_joint_passes_is_no_limit():
    """A torque that falls short at some jolts, as a foot's that is set down, of a joint that gives twice as much."""
    time = np.arange(0, 10, 0.002)
    target = 0.8 * np.sign(np.sin(2 * np.pi * 0.5 * time))[:, None]
    q = 0.5 * np.sin(2 * np.pi * 0.5 * time - 0.5)[:, None]
    v = np.gradient(q[:, 0], time)[:, None]
    tau = 30 * (target - q) - 0.5 * v
    jolts = (np.abs(tau) > 12.0) & (np.abs(tau) < 12.5)
    log = Log(
        time=time, joint_names=("hinge",), qpos=q, qvel=v, tau=tau - 4.0 * np.sign(tau) * jolts,
        qpos_target=target,
    )  # fmt: skip
    assert jolts.mean() > 0.02
    assert np.abs(tau).max() > 24.0
    half = command.command_half(log)[0]
    assert half.limit is None
    assert half.kp == pytest.approx(30.0, rel=0.05)


def test_the_commands(tmp_path, capsys):
    log, model = tmp_path / "run.npz", tmp_path / "arm.xml"
    ji.write_log(without_torque(run(kp=(0.7, 1.0))), log)
    model.write_text(ARM)
    out = tmp_path / "out"
    assert main(["replay", str(log), "--model", str(model), "--out", str(out), "--json"]) == 0
    before = validated("replay", capsys.readouterr().out)["error"]["rms"]
    assert (out / "replay.png").stat().st_size > 10_000
    assert main(["diagnose", str(log), "--model", str(model), "--out", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["verdict"] == "explained"
    assert report["effects"][0]["family"] == "kp_scale"
    assert report["shrink"]["replay"]["after"] < 0.2 * report["shrink"]["replay"]["before"]
    assert report["effects"][0]["equivalent"][0]["kind"] == "exact"
    page = (out / "report.html").read_text()
    assert "kp scale" in page
    assert "shoulder" in page
    assert "frictionloss" in json.loads((out / "policy.json").read_text())["joints"]["elbow"]
    mended = out / "corrected.xml"
    assert main(["replay", str(log), "--model", str(mended), "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["error"]["rms"] < 0.3 * before
    assert main(["estimate", str(log), "--model", str(model), "--bodies", "lower"]) == 2
    assert "the log has no torque" in capsys.readouterr().err
    floats = ARM.replace(
        '<body name="upper">', '<body name="base"><freejoint/><geom size="0.1"/><body name="upper">'
    )
    model.write_text(floats.replace("</worldbody>", "</body></worldbody>"))
    assert main(["replay", str(log), "--model", str(model), "--out", str(out)]) == 2
    assert "--fix-base" in capsys.readouterr().err
    assert (
        main(["replay", str(log), "--model", str(model), "--fix-base", "--out", str(out), "--json"])
        == 0
    )
    assert json.loads(capsys.readouterr().out)["error"]["rms"] == pytest.approx(before, rel=0.05)


@pytest.mark.slow
@pytest.mark.skipif(not CASES.is_dir(), reason="cases (../shared/cases) are not here")
@pytest.mark.parametrize(
    ("case", "wanted"),
    [
        ("leg_none_d", set()),
        ("leg_none_a50", set()),
        ("leg1k_none_a", set()),
        ("leg_action_delay_pd", {("target_delay", "global")}),
        ("leg_kp_low_a", {("kp_scale", "FR_calf_joint")}),
        (
            "leg_friction_all_pd",
            {("coulomb_friction", f"FR_{x}_joint") for x in ("hip", "thigh", "calf")},
        ),
    ],
)
def test_cases_from_targets_and_encoders_alone(case, wanted):
    log = without_torque(ji.read_log(CASES / case / "log.npz"))
    found = diagnose([log], lambda: mujoco.MjSpec.from_file(str(CASES / case / "nominal.xml")))
    assert (found.verdict is Verdict.NO_GAP) == (not wanted)
    loud = {(e.family, e.name) for e in found.effects if e.share > 0.05}
    assert loud == wanted


@pytest.mark.slow
@pytest.mark.skipif(not CASES.is_dir(), reason="cases (../shared/cases) are not here")
def test_a_lerobot_dataset_of_a_sound_leg_has_no_gap():
    model = CASES / "leg_none_d" / "nominal.xml"
    log = ji.read_log(CASES / "lerobot", names=ji.load_model(model))
    assert log.tau is None
    assert ji.diagnose(model, log).verdict is Verdict.NO_GAP


@pytest.mark.slow
@pytest.mark.skipif(not CASES.is_dir(), reason="cases (../shared/cases) are not here")
def test_a_late_loop_is_told_beside_a_sound_motion(tmp_path):
    """Torque and motion agree; between targets and torque there are 20 ms."""
    case, out = CASES / "leg_action_delay_a", tmp_path / "out"
    model = str(case / "nominal.xml")
    assert main(["diagnose", str(case / "log.npz"), "--model", model, "--out", str(out)]) == 0
    report = json.loads((out / "report.json").read_text())
    page = (out / "report.html").read_text()
    assert "From targets to torque" in page
    assert "target delay" in page
    assert report["verdict"] == "explained"
    late = [e for e in report["effects"] if e["family"] == "target_delay"]
    assert late[0]["half"] == "command"
    assert late[0]["parameters"]["delay"]["value"] == pytest.approx(0.02, abs=3e-3)


@pytest.mark.slow
@pytest.mark.skipif(not CASES.is_dir(), reason="cases (../shared/cases) are not here")
def test_a_torque_made_of_targets_that_are_late_later():
    case = CASES / "leg_action_delay_pd"
    found = ji.diagnose(case / "nominal.xml", ji.read_log(case / "log.npz"))
    assert found.verdict is Verdict.EXPLAINED
    assert [(e.family, e.name) for e in found.effects] == [("target_delay", "global")]
    assert found.effects[0].size.value == pytest.approx(0.02, abs=5e-4)
    assert any("commanded are made of the targets" in n for n in found.notes)


@pytest.mark.skipif(not CASES.is_dir(), reason="cases (../shared/cases) are not here")
def test_the_loop_of_cases_that_have_torque():
    kp, kd = np.full(3, 35.0), np.full(3, 0.8)
    wanted = {
        "leg_action_delay_a": {"target_delay"},
        "leg_kp_low_a": {"kp_scale"},
        "leg1k_none_a": set(),
        "leg_none_a50": set(),
    }
    for case, families in wanted.items():
        log = ji.read_log(CASES / case / "log.npz")
        found = command.findings(command.command_half(log), kp, kd, log.joint_names)
        assert {e["family"] for e in found} == families, case


def test_a_replay_counts_from_where_its_start_is_forgotten():
    """A first target jolts a joint from rest, where differences of positions say that it is fast already."""
    spec = mujoco.MjSpec.from_string(
        """<mujoco><option timestep="0.002"/><worldbody><body><joint name="a" axis="0 1 0" damping="0.15"/>
        <inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
        <actuator><position joint="a" kp="20"/></actuator></mujoco>"""
    )
    model, noise = spec.compile(), 2e-4
    data, rows, rng = mujoco.MjData(model), [], np.random.default_rng(0)
    for k in range(1000):
        data.ctrl[0] = 0.5 + 0.2 * np.sin(0.06 * k)
        rows.append((0.02 * k, data.qpos[0] + noise * rng.normal(), data.ctrl[0]))
        mujoco.mj_step(model, data, nstep=10)
    time, q, target = np.array(rows).T
    log = ji.Log(time, ("a",), q[:, None], qpos_target=target[:, None])
    loop = position_loop(log, model)
    plant, record = Plant(spec, log.joint_names, loop), record_of(log, loop)
    error = np.abs(replay(plant, (), np.zeros((1, 0)), record)[0] - record.q)
    assert error[record.settled].max() > 0.05
    (record,) = checks.settling(plant, [record])
    assert SETTLING < record.settles < 2.0
    assert error[record.settled].max() < 10 * noise
