"""Files that people report trouble with: HDF5, .mat, no stamps, no headings, pointers, two nodes on one topic."""

import importlib.util

import numpy as np
import pytest
from log_files import JOINTS, START, Maker, arrays, columns, write_bag, write_csv

from benchmarks.reported.__main__ import tried
from benchmarks.reported.kinds import KINDS
from jax_inertia.logs.log import LogError
from jax_inertia.logs.log_files import read_log
from jax_inertia.logs.readers import Options
from jax_inertia.model.load import ModelError, load_model

OWN = Options(columns={"time": "t", "qpos": "q", "tau": "trq"}, joints=JOINTS)


def mat(path, **extra):
    import scipy.io

    data = arrays()
    named = {"t": data["time"], "q": data["qpos"], "trq": data["tau"]}
    scipy.io.savemat(path, {**named, **extra})
    return path, data


def test_a_mat_file_is_read_by_the_names_of_its_arrays(tmp_path):
    path, data = mat(
        tmp_path / "run.mat",
        comment="text",
        cell=np.array([1, "a"], object),
        image=np.ones((4, 4, 4)),
    )
    with pytest.raises(
        LogError, match=r"--column 'time=t' --column 'qpos=q' --column 'tau=trq' --joints NAMES\)"
    ):
        read_log(path)
    with pytest.raises(LogError, match="name their joints with --joints"):
        read_log(path, options=Options(columns=OWN.columns))
    log = read_log(path, options=OWN)
    assert log.joint_names == JOINTS
    for array, name in (("time", "time"), ("qpos", "qpos"), ("tau", "tau")):
        np.testing.assert_array_equal(getattr(log, array), data[name])


@pytest.mark.parametrize(
    "damage", [b"", b"MATLAB 5.0 MAT-file" + bytes(200), b"\x89HDF\r\n\x1a\n" + bytes(600)]
)
@pytest.mark.parametrize("suffix", [".mat", ".h5", ".hdf5"])
def test_a_damaged_file_is_refused_in_one_line(tmp_path, suffix, damage):
    (tmp_path / f"run{suffix}").write_bytes(damage)
    with pytest.raises(LogError, match="run") as refused:
        read_log(tmp_path / f"run{suffix}", options=OWN)
    assert str(refused.value).isprintable()


@pytest.mark.skipif(
    importlib.util.find_spec("h5py") is None, reason="needs h5py, of the extra hdf5"
)
@pytest.mark.parametrize("suffix", [".hdf5", ".mat"])
def test_hdf5_is_read_by_paths_and_mat_since_7_3_is_it_turned(tmp_path, suffix):
    import h5py

    data, turned = arrays(), suffix == ".mat"
    path = tmp_path / f"episode{suffix}"
    with h5py.File(path, "w", userblock_size=512 if turned else 0) as file:
        for name, array in (("obs/q", "qpos"), ("obs/trq", "tau"), ("t", "time")):
            x = data[array][None] if turned and array == "time" else data[array]
            file[name] = x.T if turned else x
        file["obs/images"] = np.zeros((60, 4, 4, 3))
        file["elsewhere"] = h5py.ExternalLink("/etc/passwd", "/")
    with pytest.raises(
        LogError, match=r"--column 'qpos=obs/q' --column 'tau=obs/trq' --joints NAMES\)"
    ):
        read_log(path)
    own = Options(columns={"time": "t", "qpos": "obs/q", "tau": "obs/trq"}, joints=JOINTS)
    log = read_log(path, options=own)
    np.testing.assert_array_equal(log.qpos, data["qpos"])
    np.testing.assert_array_equal(log.tau, data["tau"])
    with pytest.raises(LogError, match="more than the limit"):
        read_log(path, options=own, max_bytes=1000)


def test_a_rate_stands_for_stamps(tmp_path):
    table = columns()
    del table["time"]
    path = write_csv(tmp_path / "log.csv", table)
    with pytest.raises(LogError, match="no stamps: --rate HZ"):
        read_log(path)
    log = read_log(path, options=Options(rate=200.0))
    np.testing.assert_allclose(log.time, np.arange(60) / 200.0)
    np.testing.assert_array_equal(log.tau, arrays()["tau"])
    with pytest.raises(LogError, match="expected samples a second"):
        read_log(path, options=Options(rate=0.0))
    whole = write_csv(tmp_path / "whole.csv", columns())
    with pytest.raises(LogError, match="stamps of its own"):
        read_log(whole, options=Options(rate=200.0))


def test_a_table_without_headings_is_told_from_one_with_others(tmp_path):
    (tmp_path / "log.csv").write_text("0.0,0.1,0.2,hip\n0.01,0.1,0.2,hip\n")
    with pytest.raises(
        LogError, match="the first line holds numbers, and names of columns are expected"
    ):
        read_log(tmp_path / "log.csv")


def test_a_heading_may_begin_with_a_per_cent_sign(tmp_path):
    path = write_csv(tmp_path / "log.csv", columns())
    path.write_text("%" + path.read_text())
    np.testing.assert_array_equal(read_log(path).tau, arrays()["tau"])


POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 99\n"


@pytest.mark.parametrize("name", ["log.npz", "log.mcap", "log.csv"])
def test_a_pointer_of_git_lfs_is_named(tmp_path, name):
    (tmp_path / name).write_text(POINTER)
    with pytest.raises(LogError, match="git lfs pull"):
        read_log(tmp_path / name)


@pytest.mark.parametrize("name", ["arm.xml", "arm.urdf"])
def test_a_model_that_is_a_pointer_is_named(tmp_path, name):
    (tmp_path / name).write_text(POINTER)
    with pytest.raises(ModelError, match="git lfs pull"):
        load_model(tmp_path / name)


def test_a_pickle_is_not_read_and_the_way_out_is_said(tmp_path):
    (tmp_path / "run.pkl").write_bytes(b"cos\nsystem\n(S'true'\ntR.")
    with pytest.raises(LogError, match=r"numpy\.savez"):
        read_log(tmp_path / "run.pkl")


@pytest.mark.parametrize("storage", ["db3", "bag"])
def test_of_two_nodes_on_one_topic_the_one_without_effort_is_left_out(tmp_path, storage):
    pytest.importorskip("rosbags")
    data, maker, sent = arrays(), Maker(storage == "bag"), []
    for k, time in enumerate(data["time"]):
        stamp = START + round(time * 1e9)
        real = maker.joints(stamp, JOINTS, data["qpos"][k], data["qvel"][k], data["tau"][k])
        idle = maker.joints(stamp + 3_000_000, JOINTS[::-1], np.zeros(2))
        sent += [("/joint_states", real, stamp), ("/joint_states", idle, stamp + 3_000_000)]
    path = tmp_path / ("log.bag" if storage == "bag" else "bag")
    log = read_log(write_bag(path, sent, storage))
    np.testing.assert_array_equal(log.qpos, data["qpos"])
    np.testing.assert_array_equal(log.tau, data["tau"])
    assert any("60 joint states on /joint_states are left out: no effort" in x for x in log.notes)


FAST = ("a gripper in per cent among joint states", "an integrated-velocity servo in the model")


@pytest.mark.parametrize(
    "kind",
    [pytest.param(x, marks=[pytest.mark.slow] * (x.what not in FAST)) for x in KINDS],
    ids=lambda kind: kind.what,
)
def test_what_people_report_has_an_answer(tmp_path, kind):
    if kind.needs and importlib.util.find_spec(kind.needs) is None:
        pytest.skip(f"needs {kind.needs}")
    assert tried(kind, tmp_path).right
