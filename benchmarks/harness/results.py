"""Where results go: JSON beside the figures, and each benchmark's own part of benchmarks/README.md."""

import importlib.metadata
import json
import os
import platform
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).parents[1]
RESULTS, FIGURES, PAGE = HERE / "results", HERE / "figures", HERE / "README.md"
LIBRARIES = ("jax", "jaxlib", "numpy", "mujoco", "mujoco-mjx", "pin")


def save_json(path: Path, data: Any) -> None:
    """Write `data` so that a reader sees the old file or the new one, never half of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(data, indent=1) + "\n")
    os.replace(part, path)


def commit() -> str:
    """The code that runs: its commit, and whether any of it was changed since (results may be)."""

    def git(*command: str) -> str:
        try:
            run = subprocess.run(
                ["git", *command], cwd=HERE, capture_output=True, text=True, check=True
            )
        except (OSError, subprocess.CalledProcessError):
            return ""
        return run.stdout.strip()

    own = git("rev-parse", "--short", "HEAD") or "unknown"
    changed = git("status", "--porcelain", "--", "../jax_inertia", "*.py", "*.sh")
    return own + (" with changes" if changed else "")


def circumstances() -> dict[str, str]:
    """Commit, versions and machine of this run."""
    import jax

    out = {"commit": commit()}
    for name in LIBRARIES:
        try:
            out[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            out[name] = "not installed"
    out["python"] = platform.python_version()
    out["processor"] = _processor()
    out["device"] = jax.devices()[0].device_kind
    if hasattr(os, "getloadavg"):
        out["load"] = f"{os.getloadavg()[1]:.1f}"
    return out


def _processor() -> str:
    lines = ()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.machine()}, {os.cpu_count()} cores"


def sentence(about: dict[str, str]) -> str:
    """The circumstances as a line of the page."""
    known = [f"{name} {about[name]}" for name in LIBRARIES if about[name] != "not installed"]
    load = (
        f", load average {about['load']} (shared with others) at the start"
        if "load" in about
        else ""
    )
    device = "" if about["device"] == "cpu" else f", {about['device']}"
    return (
        f"Commit {about['commit']}; Python {about['python']}, {', '.join(known)}; "
        f"{about['processor']}{device}{load}."
    )


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(x) for x in line) + " |" for line in lines)


def write_part(name: str, text: str, page: Path = PAGE) -> None:
    """Replace the part `name` of a page, which stands between two comments; the rest of the page stays."""
    begin, end = f"<!-- {name}: written by {name}.py -->", f"<!-- end of {name} -->"
    written = page.read_text() if page.exists() else "# Benchmarks\n"
    before, found, rest = written.partition(begin)
    after = rest.partition(end)[2] if found else "\n"
    body = f"{begin}\n\n{text.strip()}\n\n{end}"
    page.write_text(f"{before.rstrip()}\n\n{body}{after}")
