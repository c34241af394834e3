"""mypy accepts every program of the README, of the pages and of the notebooks, as a user's editor sees them."""

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
CHECKERS = {
    "mypy": ["--follow-imports=silent", "--ignore-missing-imports"],
}


def programs() -> dict[str, str]:
    """Python of each page that has any, and of each notebook, by file name."""
    out = {}
    for page in PAGES:
        if blocks := re.findall(
            r"^```python\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE
        ):
            out[f"page_{page.stem.lower()}.py"] = "\n".join(blocks)
    for book in sorted((ROOT / "notebooks").glob("*.ipynb")):
        cells = json.loads(book.read_text())["cells"]
        code = ["".join(c["source"]) for c in cells if c["cell_type"] == "code"]
        assert not any(line.startswith(("%", "!")) for text in code for line in text.splitlines())
        out[f"notebook_{book.stem}.py"] = "\n".join(code) + "\n"
    return out


@pytest.mark.parametrize("checker", CHECKERS)
def test_documented_programs_have_sound_types(checker, tmp_path):
    if importlib.util.find_spec(checker) is None:
        pytest.skip(f"{checker} is not installed")
    every = programs()
    assert len(every) > 12
    for name, text in every.items():
        (tmp_path / name).write_text(text)
    where = {"MYPYPATH": str(ROOT), "MYPY_CACHE_DIR": str(tmp_path / ".cache")}
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-m", checker, *CHECKERS[checker], *sorted(every)],
        cwd=tmp_path, env={**os.environ, **where, "PYTHONPATH": paths}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
