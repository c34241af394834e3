"""Pictures of README and of the page on reports: `python docs/figures/readme.py` (needs chromium, takes two minutes).

Logs are those of the pages start_arm.md and start_policy.md, and the demo's; pictures are what
the commands draw of them.
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

from matplotlib import image
from PIL import Image

FIGURES = Path(__file__).parent
JAX_INERTIA = (sys.executable, "-m", "jax_inertia")
WIDTH = 1200
# Numbers at the parts of a page that report.md explains, in their order.
ANNOTATED = """<style>
.badge::before { content: "1"; } .badge + .soft::before { content: "2"; } h1::before { content: "3"; }
section:nth-of-type(1) h2::before { content: "4"; } section:nth-of-type(2) h2::before { content: "5"; }
section:nth-of-type(3) h2::before { content: "6"; } section:nth-of-type(4) h2::before { content: "7"; }
section:nth-of-type(5) h2::before { content: "8"; } section:nth-of-type(6) h2::before { content: "9"; }
section:nth-of-type(7) h2::before { content: "10"; } section:nth-of-type(8) h2::before { content: "11"; }
.badge::before, .badge + .soft::before, h1::before, h2::before {
  display: inline-block; min-width: 1.5em; margin-right: .5em; padding: 0 .3em; border-radius: 99px;
  background: #000; color: #fff; font: 700 1rem/1.5 sans-serif; text-align: center; }
</style>"""


def run(folder: Path, *words: str) -> None:
    subprocess.run(words, cwd=folder, check=True, stdout=subprocess.DEVNULL)


def recorded(folder: Path, page: str) -> None:
    """The log of a page's first program."""
    text = (FIGURES.parent / page).read_text()
    program = re.search(r"```python\n(.*?)```", text, re.DOTALL)
    assert program
    (folder / "record.py").write_text(program[1])
    run(folder, sys.executable, "record.py")


def screenshot(page: Path, target: Path, high: int) -> None:
    size = f"--window-size={WIDTH},{high}"
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", size)
    run(page.parent, "chromium", *options, f"--screenshot={target}", page.as_uri())
    smaller(target)


def smaller(target: Path) -> None:
    """64 colours are enough for pages and charts, and a third of the bytes."""
    picture = Image.open(target).convert("RGB").quantize(64, dither=Image.Dither.NONE)
    picture.save(target, optimize=True)


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        recorded(folder, "start_arm.md")
        run(
            folder,
            *JAX_INERTIA,
            "diagnose",
            "log.npz",
            "--model",
            "arm.xml",
            "--test-log",
            "other.npz",
        )
        report = folder / "out" / "log" / "report.html"
        screenshot(report, FIGURES / "readme_diagnose.png", 1010)
        annotated = report.with_name("annotated.html")
        annotated.write_text(report.read_text().replace("</head>", ANNOTATED + "</head>"))
        screenshot(annotated, FIGURES / "report_annotated.png", 2600)

        run(folder, *JAX_INERTIA, "demo")
        demo = ("out/demo/log.npz", "--model", "out/demo/model.xml", "--bodies", "hand")
        run(folder, *JAX_INERTIA, "estimate", *demo, "--out", "out/hand")
        whole = image.imread(folder / "out" / "hand" / "estimate.png")
        # Mass and centre of mass: the upper part.
        image.imsave(FIGURES / "readme_estimate.png", whole[: round(0.405 * len(whole))])
        smaller(FIGURES / "readme_estimate.png")

        recorded(folder, "start_policy.md")
        run(folder, *JAX_INERTIA, "replay", "log.npz", "--model", "leg.xml", "--out", "out/replay")
        (FIGURES / "readme_replay.png").write_bytes(
            (folder / "out" / "replay" / "replay.png").read_bytes()
        )
        smaller(FIGURES / "readme_replay.png")


if __name__ == "__main__":
    main()
