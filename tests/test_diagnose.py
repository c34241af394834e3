"""The command `diagnose`: the contract of its files, what it says of bad input, and that its model closes the gap."""

import contextlib
import html
import io
import json
import re

import jsonschema
import mujoco
import numpy as np
import pytest

from jax_inertia import load_model
from jax_inertia.cli.main import main
from jax_inertia.diagnosis.effects.identified import effects_in
from jax_inertia.diagnosis.effects.registry import NAMES, known
from jax_inertia.diagnosis.simulate.step_law import callback
from jax_inertia.logs.log import Log, TorqueKind, TorqueUnit
from jax_inertia.logs.log_files import read_log, write_log
from jax_inertia.model.load import compile_spec, load_spec
from jax_inertia.preflight.drive_gains import drive_gains, in_newton_metres

# A name that would run, be mathematics, and end a CDATA section, if anything let it.
HOSTILE = "elbow <script>alert('x')</script> $\\frac{1}$ ]]> & \"q\""
ESCAPED = (
    HOSTILE.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace('"', "&quot;")
)
ARM = f"""
<mujoco><option gravity="0 0 -9.81" timestep="0.0005" integrator="RK4"/>
<worldbody><body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.3" armature="0.05"/>
<inertial mass="2.0" pos="0 0 -0.2" fullinertia="0.02 0.02 0.004 0 0.001 0"/>
<body name="lower" pos="0 0 -0.4"><joint name="{ESCAPED}" axis="0 1 0.3" damping="0.2" armature="0.03"/>
<inertial mass="1.2" pos="0.02 0 -0.15" fullinertia="0.01 0.01 0.002 0 0 0.0005"/></body></body></worldbody></mujoco>
"""
# The same arm as a URDF: what a description package holds, whose meshes are elsewhere.
URDF = f"""<?xml version="1.0"?>
<robot name="arm"><!-- kept as it is --><link name="base"/>
  <link name="upper">
    <visual><geometry><mesh filename="package://arm_description/meshes/upper.dae"/></geometry></visual>
    <collision><geometry><mesh filename="package://arm_description/meshes/upper.stl"/></geometry></collision>
    <inertial><origin xyz="0 0 -0.2"/><mass value="2.0"/>
      <inertia ixx="0.02" ixy="0" ixz="0.001" iyy="0.02" iyz="0" izz="0.004"/></inertial></link>
  <link name="lower">
    <inertial><origin xyz="0.02 0 -0.15"/><mass value="1.2"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0.0005" izz="0.002"/></inertial></link>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <dynamics damping="0.3"/></joint>
  <joint name="{ESCAPED}" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="0 0 -0.4"/>
    <axis xyz="0 1 0.3"/><dynamics damping="0.2"/></joint>
</robot>
"""
NAMED = ("shoulder", HOSTILE)
DAMPING, LOAD = 0.15, 0.8


def wanted(t: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity of a smooth wide motion."""
    rng = np.random.default_rng(seed)
    rate, phase = 2 * np.pi * rng.uniform(0.15, 0.9, (4, 2)), rng.uniform(0, 6.28, (4, 2))
    size = np.array([1.2, 1.8]) / (1 + rate / np.pi)
    angle = rate * t + phase
    return np.sum(size * np.sin(angle), 0), np.sum(size * rate * np.cos(angle), 0)


def with_friction(damping: float) -> mujoco.MjModel:
    """The arm with more friction at its elbow than the model has."""
    model = mujoco.MjModel.from_xml_string(ARM)
    model.dof_damping[1] += damping
    return model


def record(model: mujoco.MjModel, seed: int = 0, seconds: float = 7.0) -> Log:
    """An arm under feedback."""
    data, rng = mujoco.MjData(model), np.random.default_rng(seed + 50)
    data.qpos[:], data.qvel[:] = wanted(0.0, seed)
    noise, rows = np.array([0.03, 0.01]), []
    for _ in range(round(seconds * 500)):
        q, v = wanted(data.time, seed)
        u = np.array([60.0, 40.0]) * (q - data.qpos) + np.array([6.0, 3.0]) * (v - data.qvel)
        shown = data.qpos + 2e-5 * rng.normal(size=2)
        rows.append((data.time, shown, u + noise * rng.normal(size=2)))
        data.qfrc_applied[:] = u
        mujoco.mj_step(model, data, nstep=4)
    time, qpos, tau = (np.array(x) for x in zip(*rows, strict=True))
    return Log(
        time=time,
        joint_names=NAMED,
        qpos=qpos,
        tau=tau,
        tau_kind=TorqueKind.COMMANDED,
        sigma_qpos=np.full(2, 2e-5),
        sigma_tau=noise,
    )


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """A folder with the model, two logs of the robot with friction, and one of the robot as modelled."""
    folder = tmp_path_factory.mktemp("diagnose")
    (folder / "arm.xml").write_text(ARM)
    write_log(record(with_friction(DAMPING)), folder / "log.npz")
    write_log(record(with_friction(DAMPING), seed=7, seconds=5.0), folder / "other.npz")
    write_log(record(with_friction(0.0), seed=3, seconds=5.0), folder / "sound.npz")
    return folder


@pytest.fixture(scope="session")
def diagnosed(data):
    """(exit status, folder, what was printed)."""
    out, text = data / "found", io.StringIO()
    with contextlib.redirect_stdout(text):
        status = main(
            [
                "diagnose",
                str(data / "log.npz"),
                *("--model", str(data / "arm.xml"), "--test-log", str(data / "other.npz")),
                *("--exclude", "friction_drift", "--max-effects", "2", "--json"),
                *("--mcap", "--out", str(out)),
            ]
        )
    return status, out, text.getvalue()


@pytest.fixture(scope="session")
def report(diagnosed):
    return json.loads((diagnosed[1] / "report.json").read_text(), parse_constant=refuse)


def refuse(constant: str):
    raise AssertionError(f"{constant} is no JSON")


def test_writes_three_files_and_prints_the_report(diagnosed, report):
    status, out, printed = diagnosed
    assert status == 0
    names = ["corrected.xml", "diagnosis.mcap", "report.html", "report.json"]
    assert sorted(p.name for p in out.iterdir()) == names
    assert json.loads(printed, parse_constant=refuse) == report


def test_the_recording_holds_what_was_measured_and_what_remains(data, diagnosed, report):
    """Read by the package mcap: topics, schemas that validate each message, stamps, and numbers of the run itself."""
    reader = pytest.importorskip("mcap.reader")
    lines, schemas = {}, {}
    with open(diagnosed[1] / "diagnosis.mcap", "rb") as file:
        for schema, channel, message in reader.make_reader(file).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            schemas.setdefault(channel.topic, json.loads(schema.data))
            content = json.loads(message.data, parse_constant=refuse)
            jsonschema.validate(content, schemas[channel.topic])
            lines.setdefault(channel.topic, []).append((message.log_time, content))
    assert set(lines) == {
        *(f"/torque/{x}" for x in ("measured", "nominal", "corrected", "residual")), "/events",
    }  # fmt: skip
    assert report["headline"] in [content["message"] for _, content in lines["/events"]]
    log, left, gap = read_log(data / "other.npz"), 0.0, 0.0
    for name in NAMED:
        time = np.array([stamp for stamp, _ in lines["/torque/measured"]]) * 1e-9
        parts = {
            topic: np.array([content[name] for _, content in rows])
            for topic, rows in lines.items() if topic != "/events"
        }  # fmt: skip
        tau = np.interp(time, log.time, np.asarray(log.tau)[:, log.joint_names.index(name)])
        off = parts["/torque/measured"] - tau
        assert np.sqrt(np.mean(off**2)) < 0.1 * np.std(tau)
        np.testing.assert_allclose(
            parts["/torque/residual"],
            parts["/torque/corrected"] - parts["/torque/measured"],
            atol=1e-9,
        )
        left += np.var(parts["/torque/residual"])
        gap += np.var(parts["/torque/nominal"] - parts["/torque/measured"])
    assert left < gap


def is_number(x) -> bool:
    return isinstance(x, float | int) and not isinstance(x, bool)


def check_place(location):
    assert set(location) - {"other"} == {"kind", "name"}
    assert location["kind"] in ("joint", "body", "contact", "global")
    assert isinstance(location["name"], str)


def check_contract(report):
    """Keys and types of the contract, schema 1."""
    assert report["schema"] == 1
    assert report["verdict"] in ("explained", "partly", "unknown", "no_gap")
    assert 0 <= report["confidence"] <= 1
    gap = report["gap"]
    assert is_number(gap["chi2"])
    assert is_number(gap["noise_floor"])
    for key in ("per_joint_rms", "share"):
        assert set(gap[key]) == set(NAMED)
        assert all(map(is_number, gap[key].values()))
    for effect in report["effects"]:
        assert effect["family"] in NAMES
        check_place(effect["location"])
        for p in effect["parameters"].values():
            assert set(p) >= {"value", "ci95", "unit"}
            low, high = p["ci95"]
            assert low <= p["value"] <= high
            assert isinstance(p["unit"], str)
        assert is_number(effect["explained_heldout"])
        assert 0 <= effect["probability"] <= 1
        for tie in effect["equivalent"]:
            assert tie["family"] in NAMES
            check_place(tie["location"])
            assert tie["kind"] in ("exact", "motion_limited")
    shrink = report["shrink"]
    assert set(shrink) == {"heldout", "validation_log", "test_log", "rollout"}
    assert {"before", "after", "noise", "unit"} <= set(shrink["heldout"])
    assert {"horizon_s", "before", "after", "floor", "unit"} <= set(shrink["rollout"])
    assert shrink["rollout"]["horizon_s"] == 0.25
    assert shrink["rollout"]["unit"] == "rad"
    assert all(start < stop for start, stop in report["when"])
    for one in report["undetectable_below"]:
        assert set(one) == {"family", "location", "value", "unit"}
        check_place(one["location"])
    assert isinstance(report["suggested_motion"], dict)


def test_report_keeps_the_contract(report):
    check_contract(report)


def test_finds_the_friction_and_says_how_far_it_goes(report):
    effect = report["effects"][0]
    assert report["verdict"] == "explained"
    assert (effect["family"], effect["location"]["name"]) == ("viscous_friction", HOSTILE)
    assert effect["parameters"]["damping"]["value"] == pytest.approx(DAMPING, rel=0.1)
    assert effect["parameters"]["damping"]["unit"] == "N m s/rad"
    held, other, rolled = (report["shrink"][k] for k in ("heldout", "test_log", "rollout"))
    assert held["after"] < 0.3 * held["before"]
    low, high = held["ci95"]
    assert 0.7 < low < high <= 1
    assert other["after"] < 0.3 * other["before"]
    assert rolled["after"] < 0.2 * rolled["before"]
    assert 0 < rolled["floor"] < 0.2 * rolled["before"]
    assert report["where"]["rows"]["joints"] == pytest.approx(1.0)
    by_signal = {r["signal"]: r["share"] for r in report["where"]["regions"]}
    # Friction shows at speed, either way.
    assert by_signal["v"][0] + by_signal["v"][4] > 0.6


def test_corrected_model_closes_the_gap_when_simulated_again(data, diagnosed, report):
    """Half a second of the true arm under a torque of its own, without feedback, against both models."""
    truth = end_of(with_friction(DAMPING))
    nominal = end_of(mujoco.MjModel.from_xml_path(str(data / "arm.xml")))
    corrected = end_of(
        mujoco.MjModel.from_xml_path(str(diagnosed[1] / "corrected.xml")), effects_in(report)
    )
    gap, left = (np.linalg.norm(end - truth) for end in (nominal, corrected))
    assert gap > 0.01
    assert left < 0.15 * gap


def end_of(model: mujoco.MjModel, effects=()) -> np.ndarray:
    """Where half a second of the same torques takes an arm."""
    model.opt.timestep, model.opt.integrator = 0.0005, mujoco.mjtIntegrator.mjINT_RK4
    correct, state = callback(model, effects), mujoco.MjData(model)
    for k in range(1000):
        state.qfrc_applied[:] = np.array([2.0, 1.0]) * np.sin(0.01 * k)
        correct(model, state)
        mujoco.mj_step(model, state)
    return state.qpos.copy()


# --- a URDF ------------------------------------------------------------------------------------------------------


def test_a_urdf_comes_back_as_mjcf_and_as_urdf(data, tmp_path):
    """A load that the model lacks; its bodies and joints are the MJCF's, so that no function is compiled anew."""
    source, out = tmp_path / "arm.urdf", tmp_path / "out"
    source.write_text(URDF)
    loaded = compile_spec(load_spec(source))
    loaded.opt.timestep, loaded.opt.integrator = 0.0005, mujoco.mjtIntegrator.mjINT_RK4
    row = loaded.body("lower").id
    loaded.body_mass[row] += LOAD
    mujoco.mj_setConst(loaded, mujoco.MjData(loaded))
    write_log(record(loaded), tmp_path / "log.npz")
    command = ["diagnose", str(tmp_path / "log.npz"), "--model", str(source), "--max-effects", "2"]
    assert main([*command, "--exclude", "friction_drift", "--out", str(out)]) == 0
    report = json.loads((out / "report.json").read_text())
    names = ["corrected.urdf", "corrected.xml", "report.html", "report.json"]
    assert sorted(p.name for p in out.iterdir()) == names
    ends = [
        end_of(model, effects)
        for model, effects in (
            (loaded, ()),
            (compile_spec(load_spec(source)), ()),
            (mujoco.MjModel.from_xml_path(str(out / "corrected.xml")), effects_in(report)),
            (compile_spec(load_spec(out / "corrected.urdf")), ()),
        )
    ]
    gap, *left = (np.linalg.norm(end - ends[0]) for end in ends[1:])
    assert gap > 0.01
    assert max(left) < 0.05 * gap
    # Only inertials are changed in it, of the load and within tolerances, and its joints' friction, as in the MJCF.
    changed = r"<inertial>.*?</inertial>|<dynamics [^>]*/>"
    before, after = (
        re.sub(changed, "", path.read_text(), flags=re.DOTALL)
        for path in (source, out / "corrected.urdf")
    )
    assert after == before
    made, urdf = (compile_spec(load_spec(out / f"corrected.{kind}")) for kind in ("xml", "urdf"))
    np.testing.assert_allclose(urdf.dof_damping, made.dof_damping, rtol=1e-5)
    np.testing.assert_allclose(urdf.dof_frictionloss, made.dof_frictionloss, atol=1e-6)


def test_page_fetches_nothing_and_runs_nothing(diagnosed):
    page = (diagnosed[1] / "report.html").read_text()
    assert "<script" not in page.lower()
    assert "&lt;script&gt;" in page
    friction = known("viscous_friction")
    assert friction is not None
    assert html.escape(friction.equation) in page
    sources = re.findall(r"""(?:src|href|srcset|data|action)\s*=\s*["']([^"']*)""", page)
    assert len(sources) >= 4
    assert all(s.startswith("data:image/svg+xml;base64,") for s in sources)
    assert not re.search(r"url\(|@import|https?://|//\w+\.", page)
    assert len(page) < 3_000_000


def test_a_sound_model_has_no_gap_and_the_table_says_so(data, tmp_path, capsys):
    log, model = str(data / "sound.npz"), str(data / "arm.xml")
    assert main(["diagnose", log, "--model", model, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "no gap" in printed
    assert str(tmp_path / "report.html").replace("\n", "") in printed.replace("\n", "")
    found = json.loads((tmp_path / "report.json").read_text())
    check_contract(found)
    assert found["verdict"] == "no_gap"
    assert found["effects"] == []
    assert found["shrink"]["test_log"] is None
    assert "No gap" in (tmp_path / "report.html").read_text()
    mujoco.MjModel.from_xml_path(str(tmp_path / "corrected.xml"))


def test_currents_take_their_gains_from_the_log(data):
    log, robot = read_log(data / "sound.npz"), load_model(data / "arm.xml")
    gains = np.array([4.0, 0.5])
    amperes = Log(
        time=log.time,
        joint_names=log.joint_names,
        qpos=log.qpos,
        tau=log.tau / gains,
        tau_kind=TorqueKind.CURRENT,
        tau_unit=TorqueUnit.AMPERE,
        tau_unit_text="A",
    )
    found, findings = drive_gains(amperes, robot)
    np.testing.assert_allclose(found, gains, rtol=0.02)
    assert findings[0].check == "drive_gain"
    back = in_newton_metres(amperes, found)
    np.testing.assert_allclose(np.std(back.tau, axis=0), np.std(log.tau, axis=0), rtol=0.02)
    assert drive_gains(log, robot) == ([], ())
    assert in_newton_metres(log, []) is log


# --- bad input ---------------------------------------------------------------------------------------------------


def broken(kind: str, folder, tmp_path):
    """Arguments that cannot be used."""
    log, model, more = folder / "log.npz", folder / "arm.xml", []
    sound = read_log(log)
    fields = {k: v for k, v in vars(sound).items() if v is not None}
    path = tmp_path / "bad.npz"
    match kind:
        case "no file":
            log = tmp_path / "none.npz"
        case "corrupt":
            path.write_bytes((folder / "log.npz").read_bytes()[:3000])
            log = path
        case "not a log":
            path.write_bytes(b"PK\x03\x04 nothing")
            log = path
        case "names":
            write_log(Log(**{**fields, "joint_names": ("shoulder", "wrist")}), path)
            log = path
        case "nan":
            write_log(Log(**{**fields, "qpos": np.full_like(sound.qpos, np.nan)}), path)
            log = path
        case "nan torque":
            write_log(Log(**{**fields, "tau": np.full_like(sound.tau, np.nan)}), path)
            log = path
        case "short":
            write_log(sound.between(0.0, 1.2), path)
            log = path
        case "still":
            still = np.tile(sound.qpos[:1], (len(sound.time), 1))
            write_log(Log(**{**fields, "qpos": still}), path)
            log = path
        case "family":
            more = ["--exclude", "viscous_friction", "gremlins"]
        case "count":
            more = ["--max-effects", "0"]
        case "model":
            model = tmp_path / "model.xml"
            model.write_text("<mujoco><worldbody><body></mujoco>")
        case "no model":
            model = tmp_path / "none.xml"
        case "test log":
            write_log(Log(**{**fields, "joint_names": ("shoulder", "wrist")}), path)
            more = ["--test-log", str(path)]
    return ["diagnose", str(log), "--model", str(model), "--out", str(tmp_path / "out"), *more]


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("no file", "no such file"),
        ("corrupt", "npz"),
        ("not a log", "npz"),
        ("names", "wrist"),
        ("nan", "NaN"),
        ("nan torque", "NaN"),
        ("short", "s of log"),
        ("still", "no joint moves"),
        ("family", "gremlins"),
        ("count", "whole number"),
        ("model", "model.xml"),
        ("no model", "no such model"),
        ("test log", "wrist"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(kind, said, data, tmp_path, capsys):
    arguments = broken(kind, data, tmp_path)
    try:
        status = main(arguments)
    except SystemExit as end:
        status = end.code
    captured = capsys.readouterr()
    said_on_stderr = captured.err.splitlines()
    errors = [x for x in said_on_stderr if x.startswith("jax-inertia: error: ")]
    assert status == 2
    assert len(errors) == 1
    assert said in errors[0]
    assert all(x.startswith("jax-inertia: ") for x in said_on_stderr)
    assert not (tmp_path / "out").exists()
