"""Tables by headings of their own: the one line that is suggested names every column, and works as it is printed."""

import argparse
import re
import shlex
import time

import numpy as np
import pytest

from jax_inertia.cli.conversion.options import add_options, stated
from jax_inertia.logs.log import LogError
from jax_inertia.logs.log_files import read_log

# Headings of time, positions, torques, and where there are any of velocities and targets; as recorders write them.
STYLES = {
    "letters": ("t", "q{}", "tau{}", "dq{}", ""),
    "suffixes": ("t_s", "j{}_pos", "j{}_trq", "", ""),
    "UR's RTDE": ("timestamp", "actual_q_{}", "actual_current_{}", "actual_qd_{}", "target_q_{}"),
    "spreadsheet": ("Time", "J{} Angle [rad]", "J{} Torque [Nm]", "", ""),
    "Dynamixel": ("time", "present_position_{}", "present_current_{}", "", "goal_position_{}"),
    "PlotJuggler": ("__time", "/js/j{}/position", "/js/j{}/effort", "/js/j{}/velocity", ""),
    "in between": ("stamp", "joint_{}_position", "joint_{}_effort", "joint_{}_velocity", ""),
    "camel case": ("time", "jointPosition{}", "jointTorque{}", "", ""),
    "ODrive": ("time", "axis{}.encoder.pos_estimate", "axis{}.motor.Iq_measured", "", ""),
    "moteus": ("timestamp", "id{}_position", "id{}_torque", "id{}_velocity", ""),
    "libfranka": ("time", "q_{}", "tau_J_{}", "dq_{}", "q_d_{}"),
    "no words": ("time", "joint{}", "effort{}", "", ""),
    "KUKA": ("Zeit", "AxisActMeas.A{}", "AxisTorque.A{}", "", ""),
    "other numbers": ("time", "q{}", "current_J{}", "", ""),
    "targets alone": ("time", "pos_{}", "", "", "cmd_pos_{}"),
}
OTHERS = {"libfranka": ["tau_J_d_{}", "O_T_EE_{}"], "UR's RTDE": ["target_moment_{}", "tcp_{}"]}
FIELDS = ("qpos", "tau", "qvel", "qpos_target")


def table(style: str, path) -> dict[str, np.ndarray]:
    """Write a table of three joints; the columns by the contract's names."""
    rng, (time, *forms) = np.random.default_rng(0), STYLES[style]
    t = np.arange(50) * 0.01
    columns, arrays = {time: t}, {}
    for array, form in zip(FIELDS, forms, strict=True):
        if form:
            phase = rng.uniform(0, 6, 3)
            # Velocities are those of the positions: the reader looks at both.
            x = (
                3.0 * np.cos(3.0 * t[:, None] + arrays["phase"])
                if array == "qvel"
                else np.sin(3 * t[:, None] + phase)
            )
            arrays.setdefault("phase", phase)
            arrays[array] = x
            columns |= {form.format(k): x[:, k - 1] for k in (1, 2, 3)}
    for form in OTHERS.get(style, ()):
        columns |= {form.format(k): rng.normal(size=50) for k in (1, 2, 3)}
    text = ",".join(columns) + "\n"
    text += "".join(
        ",".join(map(repr, map(float, row))) + "\n" for row in zip(*columns.values(), strict=True)
    )
    path.write_text(text)
    del arrays["phase"]
    return arrays


def suggested(path) -> list[str]:
    with pytest.raises(LogError) as refused:
        read_log(path)
    line = str(refused.value)
    assert line.isprintable()
    (command,) = re.findall(r"\(jax-inertia convert IN OUT (.*?)\); it has", line)
    return shlex.split(command)


def options(words: list[str]):
    parser = argparse.ArgumentParser()
    add_options(parser)
    return stated(parser.parse_args(["in.csv", "out.npz", *words]))


@pytest.mark.parametrize("style", STYLES)
def test_the_suggested_line_reads_every_column(tmp_path, style):
    arrays = table(style, tmp_path / "log.csv")
    words = suggested(tmp_path / "log.csv")
    log = read_log(tmp_path / "log.csv", options=options(words))
    assert len(log.joint_names) == 3
    for array in FIELDS:
        found = getattr(log, array)
        if array not in arrays:
            assert found is None
        else:
            np.testing.assert_allclose(found, arrays[array])
    currents = "current" in str(STYLES[style][2]).lower() or "Iq" in STYLES[style][2]
    assert ("--tau-unit" in words) == currents == (log.tau is not None and log.tau_unit_text == "A")


def test_what_a_star_hits_besides_is_left_out(tmp_path):
    table("libfranka", tmp_path / "log.csv")
    words = ["time=time", "qpos_target.*=q_d_*", "qpos.*=q_*", "tau.*=tau_J_*"]
    given = options([part for word in words for part in ("--column", word)])
    log = read_log(tmp_path / "log.csv", options=given)
    assert log.joint_names == ("1", "2", "3")
    assert log.qpos_target is not None
    # Where nothing that it hits has a position, it is misspelt.
    given = options(["--column", "time=time", "--column", "qpos.*=q_*", "--column", "tau.*=tau_*"])
    with pytest.raises(LogError, match=r"tau\.J_1 has no qpos\.J_1"):
        read_log(tmp_path / "log.csv", options=given)


def test_where_nothing_is_known_a_place_is_held_for_each(tmp_path):
    (tmp_path / "log.csv").write_text("a,b,c\n1,2,3\n")
    assert suggested(tmp_path / "log.csv") == [
        *("--column", "time=NAME", "--column", "qpos.*=PREFIX*", "--column", "tau.*=PREFIX*")
    ]


@pytest.mark.parametrize("part", ["[", "(", "a_", "Aa", "1", " "])
def test_a_long_heading_takes_no_longer_than_others(tmp_path, part):
    """A file may hold any: what is quadratic in its length would never end."""
    (tmp_path / "log.csv").write_text(f"t,q1,q2,{part * 100_000}x\n1,2,3,4\n")
    begin = time.process_time()
    with pytest.raises(LogError):
        read_log(tmp_path / "log.csv")
    assert time.process_time() - begin < 5.0
