"""The log and its reader: round trips, what the contract refuses, and files made to hurt."""

import io
import os
import struct
import tracemalloc
import zipfile
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from jax_inertia.logs.log import Log, LogError, TorqueKind, TorqueUnit
from jax_inertia.logs.log_files import read_log, write_log

SHARED = Path(__file__).parents[2] / "shared" / "data"
FUZZ = settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def arrays(samples=50, joints=("hip", "knee")) -> dict:
    """A sound log in the contract's own terms."""
    rng = np.random.default_rng(0)
    n = len(joints)
    return {
        "time": np.arange(samples) * 0.01,
        "joint_names": np.array(joints),
        "qpos": rng.normal(size=(samples, n)),
        "qvel": rng.normal(size=(samples, n)),
        "tau": rng.normal(size=(samples, n)),
        "tau_kind": np.array("sensor"),
        "tau_unit": np.array("N m"),
        "sigma_qpos": np.array(1e-4),
        "sigma_tau": np.full(n, 0.1),
        "base_pos": rng.normal(size=(samples, 3)),
        "base_quat": np.tile([1.0, 0.0, 0.0, 0.0], (samples, 1)),
        "base_linvel": rng.normal(size=(samples, 3)),
        "base_angvel": rng.normal(size=(samples, 3)),
        "contact_wrench": rng.normal(size=(samples, 1, 6)),
        "contact_bodies": np.array(["foot"]),
    }


def saved(path: Path, **changes) -> Path:
    """Write the sound log with arrays changed, or left out where None."""
    content = {k: v for k, v in (arrays() | changes).items() if v is not None}
    np.savez(path / "log.npz", **content)
    return path / "log.npz"


def refusal(path: Path) -> str:
    with pytest.raises(LogError) as caught:
        read_log(path)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(path))
    return message


def test_reads_what_the_contract_holds(tmp_path):
    log = read_log(saved(tmp_path))
    for name, value in arrays().items():
        if name in ("joint_names", "contact_bodies"):
            assert getattr(log, name) == tuple(value)
        elif name == "sigma_qpos":
            np.testing.assert_array_equal(log.sigma_qpos, [1e-4, 1e-4])
        elif not name.startswith("tau_"):
            np.testing.assert_array_equal(getattr(log, name), value)
    assert (log.tau_kind, log.tau_unit) == (TorqueKind.SENSOR, TorqueUnit.NEWTON_METRE)
    assert log.notes == ()
    assert "0.49 s at 100 Hz, 50 samples; joints hip, knee" in repr(log)


def test_reads_the_shortest_log_and_says_what_it_assumed(tmp_path):
    optional = set(arrays()) - {"time", "joint_names", "qpos", "tau"}
    log = read_log(saved(tmp_path, **dict.fromkeys(optional)))
    assert log.qvel is None
    assert log.tau_kind is TorqueKind.UNKNOWN
    assert any("tau_unit" in note for note in log.notes)


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", ["<f8", ">f8", "<f4", "<f2", "<i4", ">i8", "|u1"])
def test_reads_numbers_of_other_kinds_as_float64(tmp_path, dtype, order):
    whole = np.asarray(np.arange(100).reshape(50, 2), dtype=dtype, order=order)
    log = read_log(saved(tmp_path, qpos=whole))
    assert log.qpos.dtype == np.float64
    np.testing.assert_array_equal(log.qpos, np.arange(100.0).reshape(50, 2))


def test_reads_names_stored_as_bytes(tmp_path):
    assert read_log(saved(tmp_path, joint_names=np.array([b"hip", b"knee"]))).joint_names == (
        "hip",
        "knee",
    )


def test_unknown_arrays_are_noted_and_never_loaded(tmp_path):
    objects = np.array([{}], dtype=object)
    log = read_log(saved(tmp_path, tau_cmd=np.zeros((50, 2)), q_goal=objects))
    assert log.tau_command is None
    assert "'tau_cmd', 'q_goal'" in log.notes[0]


def test_samples_may_be_nan_and_empty_contacts_mean_none(tmp_path):
    tau = arrays()["tau"]
    tau[3, 1] = np.nan
    nobody = {"contact_wrench": np.zeros((50, 0, 6)), "contact_bodies": np.zeros(0, "<U1")}
    log = read_log(saved(tmp_path, tau=tau, **nobody))
    assert np.isnan(log.tau[3, 1])
    assert log.contact_wrench is None


def swapped_time():
    time = arrays()["time"]
    time[[4, 5]] = time[[5, 4]]
    return time


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"time": None}, "'time' is missing"),
        ({"joint_names": None}, "'joint_names' is missing"),
        ({"tau": None, "contact_wrench": None, "contact_bodies": None}, "'tau' is missing"),
        ({"joint_names": np.array(["hip", "hip"])}, "'hip' 2 times"),
        ({"joint_names": np.array(["hip", ""])}, "joint_names[1] is ''"),
        ({"joint_names": np.array(["hip", "kn\nee"])}, "joint_names[1] is 'kn\\nee'"),
        ({"joint_names": np.array([1.0, 2.0])}, "holds numbers; expected text"),
        ({"joint_names": np.array([["hip", "knee"]])}, "one dimension"),
        ({"joint_names": np.array(["a", "b", "c"])}, "qpos has shape (50, 2); expected"),
        ({"joint_names": np.zeros(0, "<U1")}, "joint_names is empty"),
        ({"joint_names": np.array(["hip", "knee"], dtype=object)}, "pickles"),
        ({"joint_names": np.array([b"hip", b"\xff"])}, "not text"),
        ({"qpos": np.array([["1", "2"]] * 50)}, "'qpos' holds text; expected numbers"),
        ({"qpos": np.zeros((50, 2), complex)}, "'qpos' holds dtype 'c16'"),
        ({"qpos": np.zeros((50, 2), bool)}, "'qpos' holds dtype 'b1'"),
        ({"qpos": np.zeros((50, 2), object)}, "'qpos' holds Python objects"),
        ({"qpos": np.zeros(50, [("a", "f8")])}, "structured dtype"),
        ({"qpos": np.zeros((49, 2))}, "qpos has shape (49, 2)"),
        ({"tau": np.zeros(50)}, "tau has shape (50,)"),
        ({"base_quat": np.zeros((50, 3))}, "base_quat has shape (50, 3)"),
        ({"contact_wrench": np.zeros((50, 2, 6))}, "contact_wrench has shape (50, 2, 6)"),
        ({"contact_bodies": None}, "comes without contact_bodies"),
        ({"sigma_tau": np.ones(3)}, "sigma_tau has shape (3,)"),
        ({"sigma_tau": np.array([0.1, np.nan])}, "sigma_tau holds nan"),
        ({"sigma_qpos": np.array(-1.0)}, "sigma_qpos holds -1.0"),
        ({"time": np.zeros(())}, "time has shape ()"),
        ({"time": np.zeros(1)}, "time has shape (1,)"),
        ({"time": np.where(np.arange(50) == 7, np.nan, arrays()["time"])}, "time[7] is nan"),
        ({"time": 1.7e18 + 1e7 * np.arange(50)}, "expected seconds"),
        ({"time": swapped_time()}, "does not come after time[4]"),
        ({"time": np.where(np.arange(50) > 20, 1.0, arrays()["time"])}, "strictly increase"),
        ({"tau_kind": np.array("guess")}, "tau_kind is 'guess'; expected commanded"),
        ({"tau_unit": np.array(["N m", "A"])}, "tau_unit has shape (2,)"),
    ],
)
def test_refuses_in_one_line_what_the_contract_forbids(tmp_path, changes, said):
    assert said in refusal(saved(tmp_path, **changes))


@pytest.mark.parametrize("content", [b"", b"PK", b"\x93NUMPY\x01\x00", b"time,qpos\n0,1\n" * 9])
def test_refuses_what_is_no_zip(tmp_path, content):
    path = tmp_path / "log.npz"
    path.write_bytes(content)
    assert "zip" in refusal(path)


def test_refuses_what_is_no_log_file(tmp_path):
    assert "no such file" in refusal(tmp_path / "absent.npz")
    (tmp_path / "folder.npz").mkdir()
    assert "no such file" in refusal(tmp_path / "folder.npz")
    (tmp_path / "log.dat").write_bytes(b"")
    assert "unknown kind of log '.dat'; expected .npz" in refusal(tmp_path / "log.dat")


def npy(shape: str, data: bytes = b"", descr: str = "<f8") -> bytes:
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def with_member(path: Path, name: str, content: bytes, compression=zipfile.ZIP_DEFLATED) -> Path:
    target = saved(path, **{name: None})
    with zipfile.ZipFile(target, "a", compression) as archive:
        archive.writestr(f"{name}.npy", content)
    return target


@pytest.mark.parametrize("compression", [zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED])
def test_a_gigantic_claim_costs_no_memory(tmp_path, compression):
    path = with_member(tmp_path, "qpos", npy("(1000000000000, 2)", bytes(800)), compression)
    tracemalloc.start()
    try:
        assert "declares 1000000000000 x 2 values" in refusal(path)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


def test_a_true_bomb_is_refused_before_it_unfolds(tmp_path):
    path = with_member(tmp_path, "qpos", npy("(2000000, 2)", bytes(32_000_000)))
    assert path.stat().st_size < 200_000
    tracemalloc.start()
    try:
        with pytest.raises(LogError, match="above the limit of 1000000"):
            read_log(path, max_bytes=1_000_000)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


def test_small_numbers_count_as_what_they_become(tmp_path):
    path = with_member(tmp_path, "qpos", npy("(2000, 2)", bytes(4000), "|u1"))
    with pytest.raises(LogError, match="above the limit"):
        read_log(path, max_bytes=20_000)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (npy("(50, 2)", bytes(799)), "declares"),
        (npy("(50, 2)", bytes(801)), "truncated or forged"),
        (npy("(50, -2)", bytes(800)), "unreadable header"),
        (npy("(50, 2", bytes(800)), "unreadable header"),
        (npy("(" * 3000, bytes(800)), "unreadable header"),
        (npy("(" + "9" * 3900 + ",)"), "declares"),
        (npy("(50, 2)" + " " * 60000, bytes(800)), "header of"),
        (npy("(50, 2)", bytes(800), "<f16"), "dtype 'f16'"),
        (npy("(50, 2)", bytes(800), "|O"), "pickles"),
        (npy("(300000,)", bytes(1200000), "<U1"), "of text"),
        (b"\x93NUMPY\x09\x00" + bytes(100), "not in .npy format"),
        (b"", "not in .npy format"),
    ],
)
def test_refuses_forged_members(tmp_path, content, said):
    assert said in refusal(with_member(tmp_path, "qpos", content))


def test_refuses_text_that_is_no_text(tmp_path):
    word = struct.pack("<I", 0x7FFFFFFF)
    assert "not text" in refusal(with_member(tmp_path, "tau_unit", npy("()", word, "<U1")))


def test_refuses_a_pickle_in_place_of_an_array(tmp_path):
    marker = tmp_path / "ran"

    class Evil:
        def __reduce__(self):
            return (open, (str(marker), "w"))

    path = saved(tmp_path, joint_names=np.array([Evil()], dtype=object))
    assert "pickles" in refusal(path)
    assert not marker.exists()


def test_refuses_an_array_stored_twice(tmp_path):
    path = saved(tmp_path)
    with pytest.warns(UserWarning, match="Duplicate"), zipfile.ZipFile(path, "a") as archive:
        archive.writestr("qpos.npy", npy("(50, 2)", bytes(800)))
    assert "'qpos' is stored twice" in refusal(path)


def log_bytes() -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays())
    return buffer.getvalue()


def outcome(tmp_path: Path, content: bytes) -> None:
    """Either a log that keeps its promises, or one line."""
    path = tmp_path / "log.npz"
    path.write_bytes(content)
    try:
        log = read_log(path, max_bytes=1 << 24)
    except LogError as error:
        message = str(error)
    else:
        message = ""
        assert log.qpos.shape == log.tau.shape == (len(log.time), len(log.joint_names))
        assert np.all(np.diff(log.time) > 0)
    assert "\n" not in message


@FUZZ
@given(data=st.data())
def test_flipped_bytes_give_a_log_or_one_line(tmp_path, data):
    content = bytearray(log_bytes())
    for _ in range(data.draw(st.integers(1, 8))):
        # Half of the hits go to the zip directory and its headers, where they hurt most.
        low = data.draw(st.sampled_from([0, len(content) * 2 // 3]))
        content[data.draw(st.integers(low, len(content) - 1))] = data.draw(st.integers(0, 255))
    outcome(tmp_path, bytes(content))


@FUZZ
@given(data=st.data())
def test_cut_and_spliced_files_give_a_log_or_one_line(tmp_path, data):
    content = log_bytes()
    cut = sorted(data.draw(st.lists(st.integers(0, len(content)), min_size=2, max_size=2)))
    outcome(tmp_path, content[: cut[0]] + data.draw(st.binary(max_size=40)) + content[cut[1] :])


@FUZZ
@given(
    name=st.sampled_from(sorted(arrays())),
    header=st.text(
        st.sampled_from("{}()[]',: -0123456789<>|=fiuUSOcbdescrfortran_ordershapeTrueFalse"),
        max_size=120,
    ),
    data=st.binary(max_size=200),
)
def test_arbitrary_headers_give_a_log_or_one_line(tmp_path, name, header, data):
    text = header.encode()
    member = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data
    outcome(tmp_path, with_member(tmp_path, name, member).read_bytes())


@FUZZ
@given(
    name=st.sampled_from(sorted(arrays())),
    shape=st.lists(st.integers(0, 60), max_size=4),
    descr=st.sampled_from(["<f8", ">f4", "<f2", "|i1", ">u8", "<U3", "|S2", "|b1", "<c8"]),
    data=st.data(),
)
def test_arbitrary_arrays_give_a_log_or_one_line(tmp_path, name, shape, descr, data):
    size = int(np.prod(shape, dtype=int)) * np.dtype(descr).itemsize
    content = data.draw(st.binary(max_size=64))
    content = (content * (size // max(len(content), 1) + 1))[:size].ljust(size, b"\0")
    spelled = "(" + "".join(f"{s}, " for s in shape) + ")"
    member = npy(spelled, content, descr)
    outcome(tmp_path, with_member(tmp_path, name, member).read_bytes())


@pytest.mark.parametrize(
    ("unit", "texts"),
    [
        (
            TorqueUnit.NEWTON_METRE,
            "N m|N·m|Nm|N.m|N*m|newton-metre|Newton metres|newton meter|[Nm]|(N m)|nm"
            "|Nm (joint torque sensor)|Nm (link-side joint torque sensor)|Nm, from PWM|N m: joint",
        ),
        (TorqueUnit.AMPERE, "A|A (motor current, measured)|amps|Ampere|A rms|A; not a torque"),
        (TorqueUnit.MILLIAMPERE, "mA|mA (measured)|milliamps"),
        (TorqueUnit.PWM, "PWM|PWM counts (of 885 = full duty); NOT a torque|% pwm|raw PWM"),
        (TorqueUnit.UNKNOWN, "|N|Nm/A|Nmm|N m s|kN m|mN m|A/V|As|volts|V (not PWM)|namely"),
    ],
)
def test_units_are_read_from_free_text(unit, texts):
    for text in texts.split("|"):
        assert TorqueUnit.parse(text) is unit, text


def example(**changes) -> Log:
    fields = arrays() | {"joint_names": ("hip", "knee"), "contact_bodies": ("foot",)}
    fields |= {"sigma_qpos": np.full(2, 1e-4), "tau_kind": TorqueKind.SENSOR}
    fields.pop("tau_unit")
    return Log(**(fields | changes))


def test_a_log_is_a_pytree_whose_names_are_static():
    log = example()
    doubled = jax.jit(lambda x: jax.tree.map(lambda leaf: 2 * leaf, x))(log)
    assert doubled.joint_names == log.joint_names
    np.testing.assert_allclose(doubled.tau, 2 * log.tau)
    assert jax.jit(lambda x: len(repr(x)))(log) > 0


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"joint_names": ("hip", "hip")}, "'hip' 2 times"),
        ({"joint_names": "ab"}, r"joint_names is the text 'ab'; expected a tuple: \('ab',\)"),
        ({"contact_bodies": "L"}, "contact_bodies is the text 'L'"),
        ({"tau_unit": "volts"}, "tau_unit is 'volts'; expected N m, A, mA, PWM, unknown"),
        ({"tau_unit": "A", "tau_unit_text": "Nm"}, "tau_unit is A, but .* 'Nm' says N m"),
        ({"tau_kind": "guess"}, "tau_kind is 'guess'; expected commanded"),
        ({"time": np.where(np.arange(50) == 7, np.nan, arrays()["time"])}, r"time\[7\] is nan"),
    ],
)
def test_a_log_built_in_memory_refuses_what_does_not_fit(changes, said):
    with pytest.raises(LogError, match=said):
        example(**changes)


def test_stamps_that_jump_back_are_for_preflight_and_have_no_rate():
    log = example(time=swapped_time())
    assert "50 samples" in repr(log)
    with pytest.raises(LogError, match=r"time\[5\] = 0.04 s does not come after time\[4\]"):
        _ = log.rate


def test_texts_are_taken_as_what_they_say():
    log = example(joint_names=["hip", "knee"], tau_unit="A", tau_kind="current")
    assert (log.joint_names, log.tau_kind) == (("hip", "knee"), TorqueKind.CURRENT)
    assert log.tau_unit is TorqueUnit.AMPERE
    assert "current in A" in repr(log)


@pytest.mark.parametrize("samples", [0, 1])
def test_a_log_of_next_to_nothing_can_be_shown(samples):
    short = {name: x[:samples] for name, x in arrays().items() if x.shape[:1] == (50,)}
    assert f"no duration, {samples} samples" in repr(example(**short))


def test_between_cuts_every_channel_and_select_every_joint():
    log = example()
    part = log.between(0.1, 0.2)
    np.testing.assert_allclose(part.time, np.arange(10, 21) * 0.01)
    np.testing.assert_array_equal(part.contact_wrench, log.contact_wrench[10:21])
    np.testing.assert_array_equal(part.sigma_tau, log.sigma_tau)
    with pytest.raises(ValueError, match="0 samples lie between"):
        log.between(7, 8)
    knee = log.select(["knee"])
    np.testing.assert_array_equal(knee.qvel, log.qvel[:, 1:])
    assert knee.sigma_tau.shape == (1,)
    np.testing.assert_array_equal(knee.base_pos, log.base_pos)
    with pytest.raises(ValueError, match=r"no joint \['elbow'\]; it has \['hip', 'knee'\]"):
        log.select(["elbow"])


def test_gains_turn_currents_into_torques_once():
    log = example(tau_unit=TorqueUnit.AMPERE, tau_unit_text="A (measured)")
    torque = log.with_torque_gains([2.0, -3.0])
    np.testing.assert_allclose(torque.tau, log.tau * [2.0, -3.0])
    np.testing.assert_allclose(torque.sigma_tau, [0.2, 0.3])
    assert torque.tau_unit is TorqueUnit.NEWTON_METRE
    assert TorqueUnit.parse(torque.tau_unit_text) is TorqueUnit.NEWTON_METRE
    with pytest.raises(ValueError, match="in N m already"):
        torque.with_torque_gains(2.0)
    with pytest.raises(ValueError, match=r"shape \(3,\); expected one for each"):
        log.with_torque_gains([1.0, 2.0, 3.0])


def test_written_logs_read_back_whole(tmp_path):
    log = example(tau_unit=TorqueUnit.MILLIAMPERE, tau_unit_text="mA (measured)")
    write_log(log, tmp_path / "log.npz")
    back = read_log(tmp_path / "log.npz")
    assert jax.tree.structure(back) == jax.tree.structure(log)
    jax.tree.map(np.testing.assert_array_equal, back, log)


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    write_log(example(), tmp_path / "log.npz")
    before = (tmp_path / "log.npz").read_bytes()

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="disk full"):
        write_log(example(), tmp_path / "log.npz")
    assert [p.name for p in tmp_path.iterdir()] == ["log.npz"]
    assert (tmp_path / "log.npz").read_bytes() == before
    with pytest.raises(ValueError, match=r"written as \.npz"):
        write_log(example(), tmp_path / "log.mat")
    with pytest.raises(ValueError, match=f"there is no folder {tmp_path / 'absent'}; make it"):
        write_log(example(), tmp_path / "absent" / "log.npz")


@pytest.mark.skipif(not SHARED.is_dir(), reason="real logs (../shared/data) are not here")
def test_reads_every_real_log():
    paths = sorted(SHARED.glob("*/*.npz"))
    assert paths
    for path in paths:
        log = read_log(path)
        if log.tau is None:
            assert log.qpos_target is not None, path
            continue
        expected = {"ur10e": TorqueUnit.AMPERE, "bam_x": TorqueUnit.PWM}
        assert log.tau_unit is expected.get(path.parent.name[:5], TorqueUnit.NEWTON_METRE), path
        assert log.qvel is not None


def test_a_robot_that_is_told_positions_has_a_log_without_torque(tmp_path):
    told = example(
        tau=None,
        sigma_tau=None,
        qpos_target=example().qpos + 0.1,
        kp=np.array([35.0, 20.0]),
        kd=np.array([0.8, 0.5]),
    )
    for name in ("log.npz", "log.csv", "log.parquet"):
        write_log(told, tmp_path / name)
        again = read_log(tmp_path / name)
        assert again.tau is None
        for field in ("qpos", "qpos_target", "kp", "kd"):
            np.testing.assert_array_equal(getattr(again, field), getattr(told, field))
    assert "no torque" in repr(told)
    arrays = dict(np.load(tmp_path / "log.npz"))
    np.savez(tmp_path / "gain.npz", **arrays | {"kp": np.array([35.0, -1.0])})
    with pytest.raises(LogError, match=r"kp holds -1.0; a gain is finite and not negative"):
        read_log(tmp_path / "gain.npz")
    for name in ("qpos_target", "contact_wrench", "contact_bodies"):
        arrays.pop(name, None)
    np.savez(tmp_path / "none.npz", **arrays)
    with pytest.raises(LogError, match=r"'tau' is missing; .* \(or qpos_target"):
        read_log(tmp_path / "none.npz")
