"""Real runs of commands ended at random moments: what they leave, and who outlives them.

    python benchmarks/kills.py --trials 50

Each trial starts a command on a folder that holds the whole output of a run on other logs, sends it SIGINT, SIGTERM or
SIGKILL after a time drawn evenly from that of a whole run, and then asks: is every file whole, are all of one run, has
a report gone without a successor, does any process live on, did it end within `PATIENCE`? At the end each
command runs once more, undisturbed, and must leave nothing but its output.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 20.0
ENDS = {".png": b"IEND\xaeB`\x82", ".html": b"</html>"}
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)


def made(folder: Path) -> dict[str, list[list[str]]]:
    """Logs and a model in a folder, and each command on the old and on the new ones, without its `--out`."""
    sys.path.insert(0, str(ROOT))
    from jax_inertia import write_log
    from jax_inertia.robots.pendulum import double_pendulum, swing

    mujoco.mj_saveLastXML(str(folder / "arm.xml"), double_pendulum())
    logs = []
    for kind, seconds in (("old", 6.0), ("new", 7.0)):
        (folder / kind).mkdir()
        for k in range(2):
            logs.append(str(folder / kind / f"arm{k}_2026-01-0{k + 1}.npz"))
            write_log(swing(seconds=seconds + k), logs[-1])
    model = ["--model", str(folder / "arm.xml")]
    return {
        "diagnose": [["diagnose", log, *model] for log in logs[::2]],
        "fleet": [["fleet", *two, *model, "--jobs", "1"] for two in (logs[:2], logs[2:])],
        "estimate": [["estimate", log, *model, "--bodies", "lower"] for log in logs[::2]],
    }


def started(words: list[str], out: Path) -> subprocess.Popen:
    own = {**os.environ, "PYTHONPATH": str(ROOT)}
    line = [sys.executable, "-m", "jax_inertia", *words, "--out", str(out)]
    return subprocess.Popen(
        line, env=own, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )


def files(out: Path) -> dict[str, bytes]:
    return {str(p.relative_to(out)): p.read_bytes() for p in out.rglob("*") if p.is_file()}


def shown(found: dict[str, bytes]) -> dict[str, bytes]:
    """Without what is being written, whose names begin with a dot."""
    return {n: x for n, x in found.items() if not any(p[0] == "." for p in n.split("/"))}


def faults(before: dict[str, bytes], out: Path) -> list[str]:
    """What is wrong with what a run left."""
    said, after = [], shown(files(out))
    for name, content in after.items():
        try:
            if name.endswith(".json"):
                json.loads(content)
            elif name.endswith(".xml"):
                ET.fromstring(content)
            elif not content.rstrip().endswith(ENDS.get(Path(name).suffix, b"")):
                raise ValueError("no end")
        except ValueError as error:
            said.append(f"half written: {name} ({error})")
    for report in [n for n in before if n.endswith("report.json")]:
        folder = report.removesuffix("report.json")
        ours = {n: x for n, x in after.items() if n.startswith(folder)}
        if report not in ours:
            # What ended between the old report and the new one has neither, and no product of either.
            if any(not n.endswith("task.json") for n in ours):
                said.append(f"a run without its report: {sorted(ours)}")
            continue
        new = [n for n in ours if ours[n] != before.get(n)]
        if new and ours[report] == before[report]:
            said.append(f"an old report with new files: {new}")
    return said


def living(out: Path) -> list[int]:
    """Processes whose command names the folder."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                words = (entry / "cmdline").read_bytes()
            except OSError:
                continue
            if str(out).encode() in words:
                found.append(int(entry.name))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description="End real runs at random moments")
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    # A shell's background jobs ignore Ctrl-C, and so would what they start.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    rng, bad = np.random.default_rng(args.seed), 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        commands = made(folder)
        whole, names, lasts = {}, {}, {}
        for kind, (old, new) in commands.items():
            for words in (old, new):
                shutil.rmtree(folder / kind, ignore_errors=True)
                begin = time.monotonic()
                process = started(words, folder / kind)
                _, said = process.communicate()
                assert process.returncode == 0, said
                lasts[kind] = time.monotonic() - begin
                if words is old:
                    whole[kind] = files(folder / kind)
            names[kind] = set(files(folder / kind))
            print(f"{kind}: {lasts[kind]:.0f} s, {len(whole[kind])} files", flush=True)
        ended = dict.fromkeys(commands, 0)
        # An estimate takes longer than the two others.
        turns = ["diagnose", "fleet", "diagnose", "fleet", "estimate"]
        for k in range(args.trials):
            kind = turns[k % len(turns)]
            out, how = folder / kind, SIGNALS[rng.integers(len(SIGNALS))]
            shutil.rmtree(out)
            for path, content in whole[kind].items():
                (out / path).parent.mkdir(parents=True, exist_ok=True)
                (out / path).write_bytes(content)
            process, wait = started(commands[kind][1], out), rng.uniform(0.0, lasts[kind])
            try:
                _, said = process.communicate(timeout=wait)
            except subprocess.TimeoutExpired:
                process.send_signal(how)
                sent = time.monotonic()
                try:
                    _, said = process.communicate(timeout=PATIENCE)
                    ended[kind] += 1
                except subprocess.TimeoutExpired:
                    said = ""
                    print(f"{kind} {how.name} at {wait:.1f} s: still there", flush=True)
                    bad += 1
                    process.kill()
                    process.wait()
                while living(out) and time.monotonic() < sent + PATIENCE:
                    time.sleep(0.1)
            found = faults(whole[kind], out)
            found += [f"a traceback: {said[-300:]}"] * ("Traceback" in said)
            found += [f"lives on: {pid}" for pid in living(out)]
            if how == signal.SIGINT and process.returncode not in (0, 130, -2):
                found.append(f"status {process.returncode} after SIGINT")
            for line in found:
                print(f"{kind} {how.name} at {wait:.1f} s: {line}", flush=True)
            bad += bool(found)
        for kind, (_, words) in commands.items():
            process = started(words, folder / kind)
            _, said = process.communicate()
            left = set(files(folder / kind))
            if process.returncode or left != names[kind]:
                bad += 1
                print(f"{kind}, at the end: {said[-300:]} {sorted(left ^ names[kind])}")
        print(f"{args.trials} trials, ended before their time: {ended}; at fault: {bad}")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
