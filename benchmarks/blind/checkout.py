"""Which state of the repository this is."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path


def commit() -> str:
    """Of the git checkout that this file lies in; else what GIT_COMMIT says, or `unknown`."""
    here = str(Path(__file__).parent)
    try:
        out = subprocess.run(
            ["git", "-C", here, "rev-parse", "HEAD"], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return os.environ.get("GIT_COMMIT", "unknown")
    return out.stdout.strip()
