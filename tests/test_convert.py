"""`jax-inertia convert`: what comes out, what it says, and what it refuses."""

import mujoco
import numpy as np
import pytest
from log_files import JOINTS, Maker, arrays, columns, joint_messages, write_bag, write_csv
from schemas import validated

import jax_inertia as ji
from jax_inertia.cli.console import folder_for
from jax_inertia.cli.main import main
from jax_inertia.logs.log import Log, TorqueUnit
from jax_inertia.logs.log_files import read_log, write_log
from jax_inertia.signals.wrench_axes import wrenches_in_world

MODEL = """<mujoco><worldbody><body name="thigh" pos="0 0 1"><joint name="hip" axis="0 1 0"/>
  <inertial pos="0 0 -0.2" mass="3" diaginertia="0.1 0.1 0.1"/>
  <body name="shank" pos="0 0 -0.4"><joint name="knee" axis="1 0 0"/>
  <inertial pos="0 0 -0.2" mass="2" diaginertia="0.1 0.1 0.1"/></body></body></worldbody></mujoco>"""


@pytest.fixture
def model(tmp_path):
    (tmp_path / "leg.xml").write_text(MODEL)
    return tmp_path / "leg.xml"


def convert(*arguments) -> int:
    return main(["convert", *map(str, arguments)])


def refusal(capsys, *arguments) -> str:
    try:
        status = convert(*arguments)
    except SystemExit as left:
        status = left.code
    out, err = capsys.readouterr()
    assert status == 2
    assert out == ""
    assert err.startswith("jax-inertia: error: ")
    assert err.count("\n") == 1
    return err


def test_a_table_of_its_own_becomes_a_log(tmp_path, model, capsys):
    table = {k.replace("qpos.", "q_").replace("tau.", "i_"): v for k, v in columns().items()}
    table |= {"q_hip": np.rad2deg(table["q_hip"]), "q_knee": np.rad2deg(table["q_knee"])}
    table = {k.replace("qvel", "speed"): v for k, v in table.items()}
    path = write_csv(tmp_path / "run.csv", table)
    given = [
        "--column",
        "qpos.*=q_*",
        "--column",
        "tau.*=i_*",
        "--tau-unit",
        "A",
        "--tau-kind",
        "current",
    ]
    out = tmp_path / "run.npz"
    assert convert(path, out, *given, "--degrees", "--model", model, "--json") == 0
    printed = capsys.readouterr()
    told = validated("convert", printed.out)
    assert (told["samples"], told["joints"], told["tau_unit"]) == (60, list(JOINTS), "A")
    assert "not N m" in printed.err
    log = read_log(out)
    np.testing.assert_allclose(log.qpos, arrays()["qpos"], atol=1e-12)
    assert log.tau_unit is TorqueUnit.AMPERE


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".parquet"])
def test_everything_a_log_holds_survives_every_form(tmp_path, suffix, capsys):
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    rng, data = np.random.default_rng(3), arrays()
    base = {"base_pos": 3, "base_quat": 4, "base_linvel": 3, "base_angvel": 3}
    log = Log(
        joint_names=JOINTS,
        **data,
        tau_command=rng.normal(size=(60, 2)),
        qpos_target=rng.normal(size=(60, 2)),
        sigma_qpos=np.array([1e-4, 2e-4]),
        sigma_tau=np.array([0.1, 0.2]),
        **{name: rng.normal(size=(60, size)) for name, size in base.items()},
        contact_wrench=rng.normal(size=(60, 2, 6)),
        contact_bodies=("l foot", "r.foot"),
        tau_unit=TorqueUnit.MILLIAMPERE,
        tau_unit_text="mA (measured)",
    )
    write_log(log, tmp_path / "log.npz")
    # Random numbers are no motion of a robot, which is said, and for a model to refuse.
    assert convert(tmp_path / "log.npz", tmp_path / f"out{suffix}") == 0
    assert "warning" in capsys.readouterr().err
    back = read_log(tmp_path / f"out{suffix}")
    for name, value in vars(log).items():
        if name != "notes":
            np.testing.assert_array_equal(getattr(back, name), value, err_msg=name)


def test_wrenches_in_a_sensor_s_axes_are_turned_into_the_world_s(tmp_path, model, capsys):
    pytest.importorskip("rosbags")
    pytest.importorskip("mcap")
    maker, messages = Maker(), joint_messages()
    for _, _, stamp in joint_messages():
        at = stamp - 2_000_000
        messages.append(("/ft", maker.wrench(at, (1, 2, 3), (4, 5, 6), "ft_sensor"), at))
    bag, out = write_bag(tmp_path / "bag", messages, "mcap"), tmp_path / "out.npz"
    asked = ["--topic-wrench", "shank=/ft", "--wrench-axes", "body"]
    assert convert(bag, out, "--model", model, *asked) == 0
    assert "turned from the axes of their bodies" in capsys.readouterr().out
    log, compiled = read_log(out), mujoco.MjModel.from_xml_string(MODEL)
    state = mujoco.MjData(compiled)
    for row in (0, 31):
        state.qpos[:] = log.qpos[row]
        mujoco.mj_kinematics(compiled, state)
        turn = state.body("shank").xmat.reshape(3, 3)
        wanted = np.concatenate([turn @ [1, 2, 3], turn @ [4, 5, 6]])
        np.testing.assert_allclose(log.contact_wrench[row, 0], wanted, atol=1e-9)
    assert "needs --model" in refusal(capsys, bag, out, *asked)
    asked[1] = "shin=/ft"
    assert "no body 'shin'" in refusal(capsys, bag, out, "--model", model, *asked)
    plain = read_log(bag)
    assert wrenches_in_world(plain, ji.load_model(model)) is plain


def test_what_the_model_says_is_checked(tmp_path, model, capsys):
    def with_names(**names):
        table = columns()
        for old, new in names.items():
            table = {k.replace(old, new): v for k, v in table.items()}
        return write_csv(tmp_path / "run.csv", table)

    out = tmp_path / "run.npz"
    message = refusal(capsys, with_names(knee="kneee"), out, "--model", model)
    assert "the model has no hinge or slide 'kneee'; did you mean 'knee'?" in message
    assert not out.exists()
    assert convert(with_names(knee="kneee"), out, "--model", model, "--rename", "kneee=knee") == 0
    assert read_log(out).joint_names == JOINTS
    table = {k: np.rad2deg(v) if k.startswith("q") else v for k, v in columns().items()}
    write_csv(tmp_path / "deg.csv", table)
    assert convert(tmp_path / "deg.csv", out, "--model", model) == 0
    assert "these look like degrees" in capsys.readouterr().err


def test_bad_arguments_are_one_line(tmp_path, model, capsys):
    path = write_csv(tmp_path / "run.csv", columns())
    out = tmp_path / "run.npz"
    assert "written as .npz" in refusal(capsys, path, tmp_path / "run.mat")
    assert "no such file" in refusal(capsys, tmp_path / "absent.csv", out)
    assert "no pair NAME=VALUE" in refusal(capsys, path, out, "--column", "time")
    assert "one of them twice" in refusal(capsys, path, out, "--rename", "a=b", "--rename", "a=c")
    assert "no such model file" in refusal(capsys, path, out, "--model", tmp_path / "absent.xml")
    absent = tmp_path / "absent"
    assert f"there is no folder {absent};" in refusal(capsys, path, absent / "run.npz")
    before = path.read_bytes()
    assert "it is the log to be read" in refusal(capsys, path, tmp_path / "." / "run.csv")
    assert path.read_bytes() == before
    assert "(see jax-inertia convert --help)" in refusal(capsys, path, out, "--modell", "x")
    assert "topic_base does not apply to a CSV file" in refusal(
        capsys, path, out, "--topic-base", "/odom"
    )
    assert [p.name for p in tmp_path.iterdir() if p.suffix == ".npz"] == []


@pytest.mark.parametrize("name", ["...npz", "..npz", ".", "..", "a/.../..npz"])
def test_a_log_s_name_never_leads_above_the_output_folder(name, tmp_path):
    folder = folder_for(tmp_path / name)
    assert folder.parts[0] == "out"
    assert len(folder.parts) == 2
    assert ".." not in folder.parts
