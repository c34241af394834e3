"""Outputs that the first-hour pages quote: `python docs/quoted.py` runs their commands and writes them anew.

A line `<!-- output of COMMAND -->` stands before an indented block: the first lines of what the command prints.
`--check` writes nothing; it fails where a quoted text differs, or a number by more than `CLOSE` of itself (of a ± b:
and of b).
"""

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

PAGES = tuple(Path(__file__).with_name(name) for name in ("start_arm.md", "start_policy.md"))
CLOSE = 0.1
"""Of a number: another processor rounds otherwise."""
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?")
BLOCK = re.compile(r"<!-- output of (?P<command>.+?) -->\n\n(?P<block>(?:    .*\n)+)")


def outputs(page: str, folder: Path) -> dict[str, str]:
    """What each command of a page prints, in the page's order, on the log that its program records."""
    program = re.search(r"```python\n(.*?)```", page, re.DOTALL)
    assert program
    (folder / "record.py").write_text(program[1])
    subprocess.run([sys.executable, "record.py"], cwd=folder, check=True)
    root = Path(__file__).parents[1]
    own = {**os.environ, "COLUMNS": "118", "PYTHONPATH": str(root)}
    out = {}
    for command in re.findall(r"^    (jax-inertia .+)$", page, re.MULTILINE):
        words = [sys.executable, "-m", "jax_inertia", *shlex.split(command)[1:]]
        if "install" in command or "suggest-motion" in command:
            continue
        done = subprocess.run(
            words, cwd=folder, env=own, capture_output=True, text=True, check=True
        )
        out[command] = done.stdout
    return out


def renewed(page: str, printed: dict[str, str]) -> str:
    """The page with its quoted blocks as the commands print them now."""

    def block(hit: re.Match) -> str:
        count = len(hit["block"].splitlines())
        lines = printed[hit["command"]].splitlines()[:count]
        text = "".join(f"    {line.rstrip()}\n" for line in lines)
        return f"<!-- output of {hit['command']} -->\n\n{text}"

    return BLOCK.sub(block, page)


def sized(text: str) -> Iterator[tuple[float, float]]:
    """Each number, and its interval's half-width where one follows, else 0."""
    hits = list(NUMBER.finditer(text))
    for hit, after in zip(hits, [*hits[1:], None], strict=True):
        half = after is not None and text[hit.end() : after.start()] == " ± "
        yield float(hit[0]), float(after[0]) if half and after else 0.0


def differences(old: str, new: str) -> list[str]:
    """Quoted texts that are not what is printed now; numbers may differ a little."""
    out = []
    for was, now in zip(BLOCK.finditer(old), BLOCK.finditer(new), strict=True):
        texts = [" ".join(NUMBER.sub("#", x["block"]).split()) for x in (was, now)]
        numbers = [[*sized(x["block"])] for x in (was, now)]
        far = [
            f"{a:g} is now {b:g}"
            for (a, size), (b, _) in zip(*numbers, strict=False)
            if abs(a - b) > CLOSE * max(abs(a), size)
        ]
        if texts[0] != texts[1]:
            far = [f"quoted:\n{was['block']}printed now:\n{now['block']}"]
        out += [f"{was['command']}: {text}" for text in far]
    return out


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true")
    check = parser.parse_args().check
    wrong = []
    for path in PAGES:
        page = path.read_text()
        with tempfile.TemporaryDirectory() as folder:
            new = renewed(page, outputs(page, Path(folder)))
        if check:
            wrong += [f"{path.name}: {text}" for text in differences(page, new)]
        else:
            path.write_text(new)
    print("\n".join(wrong), end="\n" * bool(wrong))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
