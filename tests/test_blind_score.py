"""The scorer on answers made by hand: every number that sealed.json holds, by counting."""

import hashlib
import json
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

BLIND = Path(__file__).parents[1] / "benchmarks" / "blind"

from benchmarks.exam import page  # noqa: E402
from benchmarks.exam.rates import Share, confidence_error, count, median  # noqa: E402


def row(log: str, stratum: str, hidden: str, right: bool = True, **more) -> dict:
    base = {
        "log": log, "stratum": stratum, "hidden": hidden, "right": right, "robot": "r", "engine": "mujoco",
        "validation": False, "verdict": "explained", "confidence": 0.95, "said": "", "seconds": 9.0, "sigmas": 9.0,
        "asked": True, "found": right, "there": [True], "listed": [], "confident_wrong": False,
    }  # fmt: skip
    return base | more


def errors(tool: float | None, squares: float, stated: float) -> dict:
    return {
        "errors": {"nominal": 1.0, "least_squares": squares, "oracle": 0.01, "tool": tool, "stated": stated},
        "covers": [19, 20], "width": 1.5,
    }  # fmt: skip


ROWS = [
    row("a", "one_effect", "backlash at x"),
    row("b", "one_effect", "cogging at x", right=False, confident_wrong=True),
    row("c", "one_effect", "cogging at x", right=True, found=False, asked=False),
    row("d", "bare_odd", "joint_elasticity at x", **errors(0.02, 0.1, 0.02)),
    row("e", "bare_odd", "payload at x", right=False, **errors(0.04, 0.1, 0.02)),
    row("f", "bare", "ordinary physics", there=[True, False], **errors(0.06, 0.1, 0.02)),
    row("g", "outside", "resonance at x", verdict="partly", **errors(None, 0.1, 0.02)),
    row("h", "sound", "nothing", verdict="no_gap"),
    row("i", "sound", "nothing", right=False),
    row("j", "misread", "degrees", verdict="refused", confidence=None),
    row("k", "position", "dead_band at x", named=[True, False], right=False, replay={"nominal": 1.0, "tool": 0.1}),
    row("l", "position", "nothing", named=[], verdict="no_gap", replay={"nominal": 0.1, "tool": 0.1}),
    row("m", "position_torque", "backlash at x", named=[True], replay={"nominal": 1.0, "tool": 0.2}),
    row("n", "imu", "payload at x", named=[True], mass_error=0.04),
    row("o", "imu", "payload at x", named=[False], right=False, verdict="refused", confidence=None, mass_error=None),
]  # fmt: skip
PACE = [row("k", "position", "dead_band at x", named=[], replay={"nominal": 1.0, "tool": 0.4})]


def test_every_number_is_what_one_counts():
    made = page.summary(ROWS, PACE)
    json.dumps(made)
    assert set(made) == {"logs"} | {
        f"{n}{end}" for n in page.GOALS for end in ("", "_low", "_high")
    }
    expected = {
        "logs": 15, "one_effect_family": 1 / 2, "play_and_elasticity": 1.0, "cad_precision": 4 / 5, "cad_odd": 1 / 2,
        "sound_no_gap": 2 / 3, "position_family": 2 / 3, "feet_family": 1 / 2, "handed_over_vs_least_squares": 0.4,
        "handed_over_vs_stated": 2.0, "position_replay_vs_pace": 0.25, "wrong_and_confident": 1 / 15,
        "confidence_error": abs(0.95 - 9 / 13),
    }  # fmt: skip
    for name, value in expected.items():
        assert made[name] == pytest.approx(value), name
        if name != "logs":
            assert made[f"{name}_low"] <= made[name] + 1e-9
            assert made[name] <= made[f"{name}_high"] + 1e-9
    shares = page.shares(ROWS)
    assert shares["interval_coverage"] == Share(76, 80)
    assert shares["refused"] == Share(1, 14)
    assert shares["cad_inventions"] == Share(1, 1)
    assert shares["feet_mass_within_5_percent"] == Share(1, 2)


def test_the_page_says_what_falls_short_and_shows_every_wrong_row():
    text = page.page({"set": "T", "head": ["About it."]}, {"diagnose": ROWS, "pace_like": PACE})
    assert "# Sealed set T: 15 logs, diagnose" in text
    assert "| one effect family | 0.500 [0.09, 0.91] (1/2) | ≥ 0.99 | **short** |" in text
    assert "| position replay vs pace | 0.25 [0.25, 0.25] | ≤ 0.5 |  |" in text
    wrong = text.split("## Wrong rows")[1]
    assert [r["log"] for r in ROWS if f"| {r['log']} |" in wrong] == ["b", "e", "i", "k", "o"]
    assert "**wrong and confident**" in wrong


def test_bounds():
    # Wilson 1927, by the closed form for k = n: lower bound n / (n + z²).
    low, high = Share(20, 20).bounds
    assert low == pytest.approx(20 / (20 + 1.959964**2))
    assert high == 1.0
    assert Share(0, 0).rate is None
    assert count([True, None, False, True]) == Share(2, 3)
    assert median([]) == (None, None, None)
    honest = np.repeat([[0.75, 1.0], [0.75, 1.0], [0.75, 1.0], [0.75, 0.0]], 50, axis=0)
    assert confidence_error(honest)[0] == pytest.approx(0.0)


def test_the_stored_page_is_that_of_the_stored_rows():
    from benchmarks.blind import score

    if not score.STORED.exists():
        pytest.skip("no set is opened")
    command = [sys.executable, "-m", "benchmarks.blind.score", "page", "--check"]
    assert subprocess.run(command, check=False).returncode == 0
    stored = json.loads(score.STORED.read_text())["tools"]
    made = page.summary(next(iter(stored.values())), stored.get(page.PACE, []))
    assert made == json.loads(score.SUMMARY.read_text())


def test_the_adapter_of_the_protocol_answers_a_folder_of_logs(tmp_path, monkeypatch):
    """The example's text runs, has thirty lines at most, and finds friction that is all there is."""
    text = (BLIND / "PROTOCOL.md").read_text().split("```python\n")[1].split("```")[0]
    assert len(text.splitlines()) <= 30
    log = tmp_path / "logs" / "abc"
    log.mkdir(parents=True)
    (log / "nominal.xml").write_text(
        '<mujoco><worldbody><body><joint name="a" axis="0 0 1"/><geom size="0.1" mass="1"/></body></worldbody></mujoco>'
    )
    time = np.arange(0, 4, 0.01)
    q, inertia = np.sin(2 * time)[:, None], 0.4 * 0.1**2
    tau = 0.3 * 2 * np.cos(2 * time)[:, None] - inertia * 4 * q
    np.savez(log / "log.npz", time=time, joint_names=np.array(["a"]), qpos=q, tau=tau)
    (tmp_path / "adapter.py").write_text(text)
    monkeypatch.setattr(sys, "argv", ["adapter.py", str(tmp_path / "logs"), str(tmp_path / "out")])
    runpy.run_path(str(tmp_path / "adapter.py"), run_name="__main__")
    report = json.loads((tmp_path / "out" / "results" / "abc" / "report.json").read_text())
    assert [e["family"] for e in report["effects"]] == ["viscous_friction"]
    value = report["effects"][0]["parameters"]["damping"]["value"]
    assert value == pytest.approx(0.3, rel=0.02)


def test_what_is_opened_was_committed_to():
    """Seed and manifest of every opened set, by their hashes in COMMITMENTS.md."""
    told = (BLIND / "COMMITMENTS.md").read_text()
    for seed in BLIND.glob("*.seed"):
        manifest = seed.with_suffix(".json")
        digests = [hashlib.sha256(file.read_bytes()).hexdigest() for file in (seed, manifest)]
        assert all(digest in told for digest in digests)
        assert json.loads(manifest.read_text())["seed_sha256"] == digests[0]
