"""Several reports: what differs, what drifts; many logs at a time, where processes and workers die."""

import json
import math
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
from schemas import validated

from jax_inertia.cli import fleet as command
from jax_inertia.cli.main import main
from jax_inertia.fleet import jobs
from jax_inertia.fleet.drift import changing, drifts, heterogeneity, slope
from jax_inertia.fleet.jobs import Outcome, Task, run_here, run_on_dask
from jax_inertia.fleet.numbers import Interval, Quantity, errors, lacks, numbers
from jax_inertia.fleet.page import Column, page, to_json
from jax_inertia.fleet.report_file import read_report


def interval(value: float, sigma: float) -> Interval:
    return Interval(value, value - 1.959964 * sigma, value + 1.959964 * sigma)


def report(viscous: float, sigma: float = 0.02, verdict: str = "explained") -> dict:
    """In the form of a whole-robot diagnosis."""

    def number(value, unit):
        i = interval(value, sigma)
        return {"value": value, "ci95": [i.low, i.high], "unit": unit}

    def effect(family, kind, name, ordinary, **own):
        where = {"kind": kind, "name": name}
        return {"family": family, "location": where, "ordinary": ordinary, "parameters": own}

    drag = number(viscous, "N m s/rad")
    return {
        "schema": 1,
        "verdict": verdict,
        "confidence": 0.97,
        "joints": {
            "elbow": {"viscous_friction": drag, "presliding": {"value": 1e-3, "unit": "rad"}}
        },
        "effects": [
            effect("viscous_friction", "joint", "elbow", True, damping=drag),
            effect(
                "payload", "body", "<b>hand", False, mass=number(0.8, "kg"), com_x=number(0.1, "m")
            ),
        ],
        "shrink": {
            "heldout": {"before": 3.0, "after": 0.1, "noise": 0.05, "unit": "N m"},
            "test_log": None,
        },
    }


# --- numbers, and whether they differ ------------------------------------------------------------------------------


def test_numbers_of_a_report_each_once_with_unit_and_interval():
    found = numbers(report(0.5))
    assert list(found) == [
        Quantity("elbow", "viscous_friction", "", "N m s/rad"),
        Quantity("<b>hand", "payload", "mass", "kg"),
        Quantity("<b>hand", "payload", "com_x", "m"),
    ]
    assert found[Quantity("elbow", "viscous_friction", "", "N m s/rad")].sigma == pytest.approx(
        0.02
    )
    assert errors(report(0.5)) == (3.0, 0.1, 0.05, "N m")
    assert lacks(report(0.5)) == ["payload at <b>hand", "viscous friction at elbow"]


def test_the_same_number_twice_is_not_marked_and_another_one_is():
    q, other = Quantity("elbow", "armature", "", ""), Quantity("elbow", "offset", "", "")
    rng = np.random.default_rng(0)
    p = [heterogeneity([interval(x, 0.1) for x in rng.normal(1, 0.1, 4)]) for _ in range(2000)]
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.05, abs=0.015)
    apart, alike = [interval(1, 0.1), interval(1.7, 0.1)], [interval(1, 0.1), interval(1.2, 0.1)]
    assert changing({q: apart, other: alike}) == {q}
    # A bound has no width, and one number is nothing to compare.
    assert heterogeneity([Interval(0, 0, 0), interval(9, 0.1)]) == 1.0
    assert changing({q: [apart[0], None]}) == set()


def test_a_drift_is_the_weighted_line_s_slope_and_covers_the_truth():
    days, truth = np.array([0.0, 20.0, 50.0, 90.0]), 0.06
    rng, covered = np.random.default_rng(1), 0
    for _ in range(400):
        sigma = rng.uniform(0.05, 0.2, 4)
        x = 1.0 + truth * days / 30 + sigma * rng.normal(size=4)
        found = slope(days.tolist(), [interval(*one) for one in zip(x, sigma, strict=True)])
        fit = np.polyfit(days / 30, x, 1, w=1 / sigma)
        assert found.value == pytest.approx(fit[0])
        covered += found.low <= truth <= found.high
    # Birge's factor only widens.
    assert 0.94 <= covered / 400 <= 1.0
    assert slope([5.0, 5.0], [interval(1, 0.1), interval(2, 0.1)]) is None


def test_numbers_of_any_size_are_compared(tmp_path):
    """All that a report may hold, and what it may not: without a warning, and no probability that is none."""
    rng = np.random.default_rng(7)
    with np.errstate(all="raise", under="ignore"):
        for _ in range(2000):
            size, width = 10.0 ** rng.uniform(-99, 99, (2, 4))
            rows = [interval(x * rng.normal(), w) for x, w in zip(size, width, strict=True)]
            assert 0.0 <= heterogeneity(rows) <= 1.0
            rate = slope(rng.uniform(0, 1000, 4).tolist(), rows)
            assert rate is None or (rate.low <= rate.value <= rate.high and np.isfinite(rate).all())
    path = tmp_path / "report.json"
    for number in ("1e101", "-1e400", "9" * 400):
        path.write_text(f'{{"schema": {number}}}')
        with pytest.raises(ValueError, match="is no number"):
            read_report(path)


def test_weights_of_any_size_are_those_of_least_squares():
    """In units in which squares of numbers overflow a drift and its probability are what they are in others."""
    rng, days = np.random.default_rng(3), [0.0, 20.0, 50.0, 90.0]
    for _ in range(50):
        x, sigma = rng.normal(size=4), rng.uniform(0.1, 2.0, 4)
        plain = [interval(*one) for one in zip(x, sigma, strict=True)]
        huge = [Interval(*(1e95 * number for number in one)) for one in plain]
        assert heterogeneity(huge) == pytest.approx(heterogeneity(plain), rel=1e-6)
        np.testing.assert_allclose(
            slope(days, huge), 1e95 * np.array(slope(days, plain)), rtol=1e-6
        )


def test_only_what_drifts_stands_out():
    q, still = Quantity("a", "x", "", ""), Quantity("a", "y", "", "")
    days = [0, 30, 60]
    reports = [{q: interval(1 + 0.5 * k, 0.05), still: interval(1, 0.05)} for k in range(3)]
    first, second = drifts("left", days, reports)
    assert (first.quantity, first.stands_out) == (q, True)
    assert first.per_month.value == pytest.approx(0.5)
    assert (second.quantity, second.stands_out) == (still, False)


# --- compare -------------------------------------------------------------------------------------------------------


def folder_with(path: Path, content: dict) -> Path:
    path.mkdir(parents=True)
    (path / "report.json").write_text(json.dumps(content))
    return path


def test_compare_marks_what_differs_and_escapes_names(tmp_path, capsys):
    a = folder_with(tmp_path / "a", report(0.5))
    b = folder_with(tmp_path / "b", report(0.9, verdict="partly"))
    out = tmp_path / "out"
    names = ["<i>", "b"]
    assert (
        main(["compare", str(a), str(b / "report.json"), "--names", *names, "--out", str(out)]) == 0
    )
    said = capsys.readouterr().out
    assert "viscous friction [N m s/rad] at elbow differs: 0.5, 0.9" in said
    assert "payload, mass" not in said
    page = (out / "compare.html").read_text()
    assert "<i>" not in page
    assert "&lt;i&gt;" in page
    assert "<b>hand" not in page
    assert page.count("differs</td>") == 1
    told = validated("compare", (out / "compare.json").read_text())
    assert [row["changes"] for row in told["numbers"]] == [True, False, False]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "is no JSON"),
        ("[" * 10**5, "is no JSON"),
        ('{"schema": 1, "verdict": "no_gap", "confidence": NaN}', "NaN is no number"),
        ('{"schema": 1, "verdict": "no_gap", "notes": ["\\ud800"]}', "is no JSON"),
        ("\xff", "is no JSON"),
        ('{"bodies": {}}', "no report of a diagnosis .*'schema' is a required property"),
        ('{"schema": 1, "verdict": "fine"}', r"\$\.verdict: 'fine' is not one of"),
        (None, "No such file"),
    ],
)
def test_what_is_no_report_is_one_line(tmp_path, content, words):
    if content is not None:
        (tmp_path / "report.json").write_bytes(content.encode("latin-1"))
    with pytest.raises(ValueError, match=words) as caught:
        read_report(tmp_path / "report.json")
    assert str(tmp_path / "report.json") in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_file_is_one_line(tmp_path):
    os.mkfifo(tmp_path / "report.json")
    for path in (tmp_path, tmp_path / "report.json", Path("/dev/zero")):
        with pytest.raises(ValueError, match="a pipe or device, not a file"):
            read_report(path)


# What somebody may put in a number's, a text's or a list's place.
ELSE = (
    None,
    True,
    -1,
    0,
    1e300,
    10**400,
    "",
    "<script>",
    [],
    [None],
    [0.0],
    {},
    {"a": {}},
    "x" * 10**5,
)


def places(value, path=()):
    """The way to every entry of a report."""
    yield path
    inner = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    for key, one in inner:
        yield from places(one, (*path, key))


def with_else(report: dict, path: tuple, other) -> dict:
    """The report with something else in one place."""
    out = json.loads(json.dumps(report))
    if not path:
        return other
    at = out
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = other
    return out


def test_a_report_that_was_changed_anywhere_is_a_page_or_one_line(tmp_path):
    """Every entry replaced by everything: what the schema lets through, the page and its JSON can take."""
    sound = report(0.5)
    (tmp_path / "report.json").write_text(json.dumps(sound))
    whole, refused, taken = Column("a", read_report(tmp_path)), [], 0
    for path in places(sound):
        for other in ELSE:
            (tmp_path / "report.json").write_text(json.dumps(with_else(sound, path, other)))
            try:
                column = Column("b", read_report(tmp_path))
            except ValueError as error:
                refused.append(str(error))
                continue
            taken += 1
            assert page("", [whole, column])
            json.dumps(to_json([whole, column]), allow_nan=False)
    assert all("\n" not in line and len(line) < 1000 for line in refused)
    assert len(refused) > 500
    assert taken > 50


def test_one_report_that_is_not_sound_does_not_cost_the_page(tmp_path, capsys):
    good = [str(folder_with(tmp_path / name, report(0.5))) for name in "ab"]
    bad = tmp_path / "c"
    folder_with(bad, report(0.5) | {"joints": [1]})
    out = tmp_path / "out"
    assert main(["compare", *good, str(bad), "--out", str(out)]) == 0
    assert (
        "c/report.json is no sound report: $.joints: [1.0] is not of type 'object'"
        in capsys.readouterr().err
    )
    told = json.loads((out / "compare.json").read_text())
    assert len(told["reports"]) == 2
    assert "$.joints" in told["refused"][0]["reason"]
    assert main(["compare", good[0], str(bad), "--out", str(out)]) == 2


def test_one_report_is_nothing_to_compare(tmp_path, capsys):
    a = folder_with(tmp_path / "a", report(0.5))
    assert main(["compare", str(a), "--out", str(tmp_path / "out")]) == 2
    assert "two or more" in capsys.readouterr().err


# --- robots and dates ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("logs/arm3_2026-11-05.npz", ("arm3", "2026-11-05")),
        ("logs/arm3/2026-11-05.npz", ("arm3", "2026-11-05")),
        ("logs/arm-3-20261105.csv", ("arm-3", "2026-11-05")),
        ("logs/2026-10-01/arm3_2026-11-05_run2.npz", ("arm3", "2026-11-05")),
        ("logs/arm3.npz", ("arm3", "")),
        ("logs/arm3_2026-13-45.npz", ("arm3", "")),
        ("logs/serial_20261105123.npz", ("serial_20261105123", "")),
    ],
)
def test_robot_and_date_from_a_path(path, expected):
    pattern = command._pattern(command.PATTERN)
    assert command.robot_and_date(Path(path), pattern) == expected


# --- many logs -----------------------------------------------------------------------------------------------------

# Stands for `jax-inertia diagnose`: as long as it takes, what it leaves, and how it dies.
PROGRAM = """
import json, os, signal, sys, time
log, out = sys.argv[1], sys.argv[sys.argv.index("--out") + 1]
with open(log + ".tries", "a") as file:
    file.write("x")
kind, seconds = open(log).read().split()
time.sleep(float(seconds))
if kind == "dies" or (kind == "dies-once" and len(open(log + ".tries").read()) == 1):
    os.kill(os.getpid(), signal.SIGKILL)
if kind == "bad":
    print("jax-inertia: error: no log", file=sys.stderr)
    sys.exit(2)
os.makedirs(out, exist_ok=True)
json.dump({"schema": 1, "verdict": "no_gap"}, open(os.path.join(out, "report.json"), "w"))
"""


def tasks_of(tmp_path: Path, kinds: dict[str, str]) -> list[Task]:
    program = tmp_path / "program.py"
    program.write_text(textwrap.dedent(PROGRAM))
    (tmp_path / "model.xml").write_text("<mujoco/>")
    out = []
    for name, kind in kinds.items():
        (tmp_path / name).write_text(kind)
        folder = tmp_path / "out" / name / "run"
        own = (sys.executable, str(program))
        out.append(Task(tmp_path / name, tmp_path / "model.xml", folder, (), "1", own))
    return out


def tries(task: Task) -> int:
    return len(Path(f"{task.log}.tries").read_text())


def test_a_log_that_dies_takes_no_other_with_it_and_what_is_done_is_not_done_again(tmp_path):
    kinds = {"good": "fine 0", "bad": "bad 0", "weak": "dies-once 0", "lost": "dies 0"}
    todo, heard = tasks_of(tmp_path, kinds), []
    ended = run_here(todo, 2, lambda outcome, k: heard.append(k))
    assert [o.status for o in ended] == ["done", "refused", "done", "lost"]
    assert [o.task for o in ended] == todo
    assert heard == [1, 2, 3, 4]
    assert ended[1].message == "no log"
    assert [tries(t) for t in todo] == [1, 1, 2, jobs.ATTEMPTS]
    again = run_here(todo[:3], 1, lambda outcome, k: None)
    assert [o.status for o in again] == ["before", "refused", "before"]
    assert [tries(t) for t in todo[:3]] == [1, 2, 2]
    # Another log under the same name, other options: done anew.
    todo[0].log.write_text("fine 0.0")
    other = [todo[0], todo[2]._replace(options=("--max-effects", "1"))]
    assert [o.status for o in run_here(other, 1, lambda outcome, k: None)] == ["done", "done"]


def test_a_report_that_another_process_is_writing_is_waited_for(tmp_path, monkeypatch):
    """The process of a worker that died goes on, and holds the folder: its work is not lost and not done twice."""
    (task,) = tasks_of(tmp_path, {"good": "fine 0"})
    monkeypatch.setattr(jobs, "PATIENCE", 0.05)
    busy = tmp_path / "busy.py"
    line = f"jax-inertia: error: cannot write to x: {jobs._BUSY}; wait for it"
    busy.write_text(
        f"import os, runpy, sys\nn = {str(tmp_path / 'n')!r}\nopen(n, 'a').write('x')\n"
        f"if os.path.getsize(n) < 3:\n    sys.stderr.write({line!r} + '\\n')\n    sys.exit(2)\n"
        f"runpy.run_path({str(tmp_path / 'program.py')!r})\n"
    )
    found = jobs.diagnose(task._replace(program=(sys.executable, str(busy))))
    assert found.status == "done"
    assert (tmp_path / "n").read_text() == "xxx"


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and that nobody has waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


SLEEPER = """
import os, sys, time
from jax_inertia.cli.console import end_with_input
end_with_input()
open(sys.argv[1] + ".pid", "w").write(str(os.getpid()))
time.sleep(60)
"""
PARENT = """
import sys
from pathlib import Path
from jax_inertia.fleet.jobs import Task, run_here
if __name__ == "__main__":
    log, program = Path(sys.argv[1]), sys.argv[2]
    tasks = [Task(log, log, log.with_suffix(f".{k}"), (), "1", (sys.executable, program)) for k in range(3)]
    run_here(tasks, 1, lambda outcome, k: None)
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="asks Linux which processes run")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_fleet_that_ends_ends_its_processes(tmp_path, how):
    for name, text in (("log", ""), ("sleeper.py", SLEEPER), ("parent.py", PARENT)):
        (tmp_path / name).write_text(text)
    words = [str(tmp_path / name) for name in ("parent.py", "log", "sleeper.py")]
    root = str(Path(__file__).parents[1])
    environment = os.environ | {"PYTHONPATH": root}
    with subprocess.Popen(
        [sys.executable, *words], env=environment, stderr=subprocess.DEVNULL
    ) as parent:
        told, end = tmp_path / "log.pid", time.monotonic() + 60
        while not (told.exists() and told.read_text()) and time.monotonic() < end:
            time.sleep(0.05)
        child = int(told.read_text())
        assert alive(child)
        parent.send_signal(how)
        parent.wait(20)
    end = time.monotonic() + 20
    while alive(child) and time.monotonic() < end:
        time.sleep(0.05)
    assert not alive(child)


def test_a_log_is_done_anew_where_a_part_of_its_model_changed(tmp_path):
    """An included file, a mesh, a file that an option names; and where its report is not sound any more."""
    (task,) = tasks_of(tmp_path, {"good": "fine 0"})
    (tmp_path / "parts").mkdir()
    include, mesh, motors = (
        tmp_path / "parts" / "a.xml",
        tmp_path / "parts" / "a.stl",
        tmp_path / "m.json",
    )
    task.model.write_text(
        '<mujoco><compiler meshdir="parts"/><include file="parts/a.xml"/><asset><mesh file="a.stl"/></asset></mujoco>'
    )
    include.write_text("<mujocoinclude/>")
    mesh.write_bytes(b"solid")
    motors.write_text("{}")
    task = task._replace(options=(f"--motors={motors}",))

    def run() -> str:
        return run_here([task], 1, lambda outcome, k: None)[0].status

    assert [run(), run()] == ["done", "before"]
    for part in (include, mesh, motors, task.model):
        part.write_bytes(part.read_bytes() + b" ")
        assert [run(), run()] == ["done", "before"], part
    (task.out / "report.json").write_text('{"schema": 1, "verdict": [}')
    assert [run(), run()] == ["done", "before"]


@pytest.mark.slow
def test_nothing_is_lost_when_a_dask_worker_is_killed(tmp_path):
    distributed = pytest.importorskip("distributed", reason="no Dask here")
    todo = tasks_of(tmp_path, {f"log{k}": "fine 1" for k in range(6)})
    killed = []

    def told(outcome: Outcome, ended: int) -> None:
        if not killed:
            with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
                pid = next(iter(client.run(os.getpid).values()))
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)

    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        ended = run_on_dask(todo, cluster.scheduler_address, told)
    assert killed
    assert {o.status for o in ended} <= {"done", "before"}
    assert all((t.out / "report.json").is_file() for t in todo)
    assert sum(map(tries, todo)) <= len(todo) + 1


def test_dask_that_is_not_there_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ValueError, match="needs Dask: pip install distributed"):
        run_on_dask(tasks_of(tmp_path, {"a": "fine 0"}), "tcp://x:1", lambda outcome, k: None)


def test_fleet_writes_one_table_of_what_there_is(tmp_path, monkeypatch, capsys):
    """Reports as given; robots, dates, drift and a refused log on the page and in JSON."""
    values = {"left_2026-09-01": 0.5, "left_2026-10-01": 0.9, "right_2026-09-01": 0.5}

    def ended(todo, count, told):
        out = []
        for task in todo:
            if task.log.stem in values:
                folder_with(task.out, report(values[task.log.stem]))
                out.append(Outcome(task, "done"))
            else:
                out.append(Outcome(task, "refused", "no log"))
        return out

    monkeypatch.setattr(jobs, "run_here", ended)
    (tmp_path / "arm.xml").write_text("<mujoco/>")
    logs = [str(tmp_path / f"{name}.npz") for name in (*values, "broken")]
    out = tmp_path / "out"
    assert main(["fleet", *logs, "--model", str(tmp_path / "arm.xml"), "--out", str(out)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "left drifts: viscous friction [N m s/rad] at elbow 0.5 → 0.9 in 2 logs" in said
    found = validated("compare", (out / "fleet.json").read_text())
    assert [(r["robot"], r["date"]) for r in found["reports"]] == [
        ("left", "2026-09-01"),
        ("left", "2026-10-01"),
        ("right", "2026-09-01"),
    ]
    assert found["refused"] == [{"name": "broken.npz", "reason": "no log"}]
    standing = [d for d in found["drifts"] if d["stands_out"]]
    assert [(d["robot"], d["family"]) for d in standing] == [("left", "viscous_friction")]
    assert math.isclose(standing[0]["per_30_days"]["value"], 0.4, rel_tol=1e-6)
    page = (out / "fleet.html").read_text()
    assert 'href="left/left_2026-09-01/report.html"' in page
    assert "broken.npz" in page


def test_each_log_takes_its_own_robot_s_test_log(tmp_path, monkeypatch, capsys):
    """Of the same date, else the robot's only one; another content of it is another task."""
    seen = {}

    def ended(todo, count, told):
        for task in todo:
            seen[task.log.stem] = None if task.test_log is None else task.test_log.stem
            folder_with(task.out, report(0.5))
        return [Outcome(task, "done") for task in todo]

    monkeypatch.setattr(jobs, "run_here", ended)
    (tmp_path / "arm.xml").write_text("<mujoco/>")
    names = ["left_2026-09-01", "left_2026-10-01", "right_2026-09-01", "third_2026-09-01"]
    checks = ["left_2026-09-01_check", "left_2026-10-01_check", "right_2026-08-01_check"]
    for name in checks:
        (tmp_path / f"{name}.npz").write_text("first")
    logs = [str(tmp_path / f"{name}.npz") for name in names]
    given = ["--test-logs", *(str(tmp_path / f"{name}.npz") for name in checks)]
    base = ["--model", str(tmp_path / "arm.xml"), "--out", str(tmp_path / "out")]
    assert main(["fleet", *logs, *base, *given]) == 0
    assert seen == dict(zip(names, [*checks, None], strict=True))

    assert main(["fleet", logs[-1], *base, *given]) == 2
    assert "no log is of its robot and date" in capsys.readouterr().err

    test = tmp_path / f"{checks[0]}.npz"
    task = Task(tmp_path / "log.npz", tmp_path / "arm.xml", tmp_path, (), "1", test_log=test)
    before = jobs._key(task)
    test.write_text("second")
    assert jobs._key(task) != before


def test_two_logs_of_one_name_are_refused(tmp_path, capsys):
    (tmp_path / "arm.xml").write_text("<mujoco/>")
    logs = [str(tmp_path / part / "arm_2026-01-01.npz") for part in "ab"]
    assert main(["fleet", *logs, "--model", str(tmp_path / "arm.xml")]) == 2
    assert "names of their own" in capsys.readouterr().err
