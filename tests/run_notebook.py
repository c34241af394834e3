"""Run the code of a notebook, cell by cell, without a kernel: `python run_notebook.py NOTEBOOK`.

Prints how many figures each cell drew and how long it took; ends with status 1 and the cell's number where one fails.
"""

import json
import sys
import time
import traceback
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot as plt


def main(path: Path) -> int:
    cells = json.loads(path.read_text())["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    drawn = 0

    def show() -> None:
        nonlocal drawn
        for number in plt.get_fignums():
            plt.figure(number).canvas.draw()
            drawn += 1
        plt.close("all")

    plt.show = show
    namespace: dict = {"__name__": "__main__"}
    for k, text in enumerate(code):
        start, drawn = time.perf_counter(), 0
        try:
            exec(compile(text, f"{path.name}, code cell {k + 1}", "exec"), namespace)
        except Exception:
            traceback.print_exc()
            return 1
        print(f"cell {k + 1}: {drawn} figures, {time.perf_counter() - start:.1f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
