"""The notebooks: cleared of outputs, each opening with a picture, and their code runs.

Their code compiles for a minute each and stands on code that has tests of its own: it is `slow`, and CI runs it.
"""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
NOTEBOOKS = sorted((HERE.parent / "notebooks").glob("*.ipynb"))


def cells_of(path: Path) -> list[dict]:
    return json.loads(path.read_text())["cells"]


def test_there_are_seven():
    assert [path.stem[:2] for path in NOTEBOOKS] == [f"{k}_" for k in range(1, 8)]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_is_text_and_code_without_outputs(path):
    whole = json.loads(path.read_text())
    assert (whole["nbformat"], whole["nbformat_minor"]) >= (4, 5)
    cells = whole["cells"]
    assert cells[0]["cell_type"] == "markdown"
    assert cells[0]["source"][0].startswith(f"# {path.stem[0]} · ")
    ids = [cell["id"] for cell in cells]
    assert len(set(ids)) == len(ids)
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
    # The first cell of code draws.
    assert "plt.show()" in "".join(code[0]["source"]) or "show(" in "".join(code[0]["source"])
    for cell in code:
        ast.parse("".join(cell["source"]))


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_runs(path, tmp_path):
    # In a process of its own, as for a reader: nothing is left of the tests' settings.
    done = subprocess.run(
        [sys.executable, HERE / "run_notebook.py", path],
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        timeout=850,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    first = next(line for line in done.stdout.splitlines() if line.startswith("cell 1: "))
    assert not first.startswith("cell 1: 0 figures")
    # Where it takes its time it says what for; nothing is said that the reader can do nothing about.
    assert " ... " in done.stdout
    assert "warp" not in done.stdout + done.stderr
