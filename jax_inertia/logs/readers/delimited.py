"""CSV and TSV, block by block: a heading row, then numbers."""

import csv
import dataclasses
import datetime
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TextIO

import numpy as np

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.readers import column_plan, columns
from jax_inertia.logs.readers.options import Contents, Options
from jax_inertia.logs.schema import TEXTS

_BLOCK = 1 << 22
_LONGEST_LINE = 1 << 20
_BLANKS = " "
_TIMES = ("s", "sec", "ms", "us", "µs", "ns")
_NOTHING = ("", "na", "n/a", "null", "none")


def read_csv(path: Path, options: Options, max_bytes: int) -> Contents:
    """Read columns parted by commas, semicolons, tabs or spaces, named as in `readers.columns`.

    Between semicolons, tabs or quotation marks a comma in a number is its decimal mark. Empty fields are NaN. A second
    row of units is read as such, stamps may be dates (ISO 8601). Raises
    `LogError` with the line for what is no number, for rows of another length, and for a file whose numbers would need
    more than `max_bytes`.
    """
    # In pieces, as logs grow, there is no first sample to count from.
    growing = _growing(path, dataclasses.replace(options, rate=None))
    size = os.path.getsize(path)
    table, _ = next(growing)
    for _, taken in growing:
        _check_budget(table, size / max(taken, 1), max_bytes)
    contents = columns.arrays(table.plan, table.values(), rate=options.rate)
    contents.notes = [*contents.notes, *table.notes]
    contents.in_seconds |= table.dated
    return contents


More = Callable[[TextIO], TextIO | None]
"""Given a file at its end, the one to go on with: the same once it has grown, its successor, or None: no more comes."""


def csv_parts(
    path: Path, options: Options, more: More | None = None
) -> Iterator[tuple[column_plan.Plan, dict[str, np.ndarray]]]:
    """The columns of `read_csv` by heading, some thousand rows at a time and in bounded memory; raises the same.

    At the file's end `more` is asked what to go on with, for a file that is still being written: its last line counts
    once it is whole, and a heading that comes again is left out.
    """
    for table, _ in _growing(path, options, more):
        yield table.plan, table.values()
        table.blocks.clear()


def _growing(
    path: Path, options: Options, more: More | None = None
) -> Iterator[tuple["_Table", int]]:
    """One table, before its first block and after each, and how many characters went into it."""
    options.check("a CSV file", ("columns",))
    try:
        encoding, notes = _encoding(path)
        with open(path, encoding=encoding) as file:
            headings, delimiter, first_line = _header(file)
            headings, rest, first_line, more_notes = _with_units(
                file, headings, delimiter, first_line
            )
            notes = [*notes, *more_notes]
            plan = column_plan.plan(headings, options)
            if not plan.columns:
                columns.arrays(plan, {})
            apart = "\t" if delimiter == _BLANKS else delimiter
            table, taken = _Table(headings, plan, apart, first_line, notes), 0
            yield table, taken
            for lines in _blocks(file, more, rest):
                if delimiter == _BLANKS:
                    lines = _tabbed(lines)
                if more is not None:
                    lines = [line for line in lines if not table.is_heading(line)]
                table.add(lines)
                taken += sum(map(len, lines)) + len(lines)
                yield table, taken
    except UnicodeDecodeError:
        raise LogError("not text in UTF-8; is it a CSV file?") from None
    except csv.Error as error:
        raise LogError(f"cannot be read as CSV: {error}") from None


class _Table:
    """The numbers read so far, and the first row's words."""

    def __init__(
        self,
        headings: Sequence[str],
        plan: column_plan.Plan,
        delimiter: str,
        line: int,
        notes: Sequence[str],
    ) -> None:
        self.headings, self.plan, self.delimiter, self.line = headings, plan, delimiter, line
        wanted = [headings.index(heading) for heading in plan.columns]
        self.words = [k for k in wanted if plan.columns[headings[k]].array in TEXTS]
        self.numbers = [k for k in wanted if k not in self.words]
        self.stamps = {k for k in wanted if plan.columns[headings[k]].array == "time"}
        self.start: datetime.datetime | None = None
        """The first stamp, where stamps are dates."""
        self.said: dict[int, str] = {}
        self.blocks: list[np.ndarray] = []
        self.rows = 0
        self.decimal: str | None = None
        """The decimal mark, once a number has one."""
        self._notes = notes

    @property
    def notes(self) -> list[str]:
        """What was assumed of the file's text."""
        commas = ["numbers have decimal commas"] * (self.decimal == ",")
        dates = [f"stamps are dates; time counts from {self.start}"] if self.dated else []
        return [*self._notes, *commas, *dates]

    @property
    def dated(self) -> bool:
        """Whether stamps are dates, and time is in seconds from the first."""
        return self.start is not None

    def is_heading(self, line: str) -> bool:
        """Whether it is the heading once more, as a writer that starts anew begins with."""
        return [x.strip().strip('"') for x in line.split(self.delimiter)] == list(self.headings)

    def add(self, lines: list[str]) -> None:
        if not any(line.strip() for line in lines):
            self.line += len(lines)
            return
        fields = None
        if any('"' in line for line in lines):
            fields = list(csv.reader(lines, delimiter=self.delimiter))
            if len(fields) != len(lines):
                raise LogError(f"a quoted field after line {self.line - 1} runs over its line")
        for k, line in enumerate(lines):
            count = len(fields[k]) if fields else line.count(self.delimiter) + 1
            if count != len(self.headings) and line.strip():
                raise LogError(
                    f"line {self.line + k} has {count} fields, the heading {len(self.headings)}; "
                    "is the file cut off, or has it decimal commas between commas?"
                )
        if not self.said:
            k = next(k for k, line in enumerate(lines) if line.strip())
            first = fields[k] if fields else lines[k].split(self.delimiter)
            self.said = {k: first[k].strip() for k in self.words}
        text = "\n".join(lines)
        commas = "," in text and self.delimiter != "," and fields is None
        try:
            if commas and ("." in text or self.decimal == "."):
                # Both marks: field by field it shows whether they are of the same numbers.
                raise ValueError
            plain = text.replace(",", ".").split("\n") if commas else lines
            block = np.loadtxt(
                [line for line in plain if line.strip()],
                delimiter=self.delimiter,
                usecols=self.numbers,
                comments=None,
                quotechar='"',
                ndmin=2,
            )
            # The commas may be of columns that are not read: those say nothing of the numbers.
            if commas and self.decimal is None and any(self._comma_in(line) for line in lines):
                self.decimal = ","
        except ValueError:
            block = self._slowly(lines)
        self.line += len(lines)
        self.rows += len(block)
        self.blocks.append(block)

    def _slowly(self, lines: list[str]) -> np.ndarray:
        """Field by field: empty ones are NaN, and what is no number is named with its line."""
        rows = []
        for k, row in enumerate(csv.reader(lines, delimiter=self.delimiter)):
            if not row:
                continue
            values = []
            for column in self.numbers:
                text = row[column].strip()
                where = f"line {self.line + k}, column {self.headings[column]!r}"
                if column in self.stamps and (date := _date(text)) is not None:
                    self.start = self.start or date
                    values.append(_seconds(date, self.start, where))
                    continue
                mark = next((c for c in ",." if c in text), None)
                if mark is not None and self.decimal not in (None, mark):
                    raise LogError(
                        f"{where}: {text[:40]!r}, but numbers before it have a decimal "
                        f"{'point' if self.decimal == '.' else 'comma'}; write all alike, without thousands separators"
                    )
                self.decimal = self.decimal or mark
                try:
                    plain = text.replace(",", ".")
                    values.append(np.nan if text.lower() in _NOTHING else float(plain))
                except ValueError:
                    raise LogError(f"{where}: {text[:40]!r} is no number") from None
            rows.append(values)
        return np.array(rows, dtype=float).reshape(len(rows), len(self.numbers))

    def _comma_in(self, line: str) -> bool:
        fields = line.split(self.delimiter) if "," in line else []
        return any("," in fields[k] for k in self.numbers if k < len(fields))

    def values(self) -> dict[str, np.ndarray]:
        whole = np.concatenate(self.blocks) if self.blocks else np.zeros((0, len(self.numbers)))
        out = {self.headings[k]: whole[:, i] for i, k in enumerate(self.numbers)}
        return out | {self.headings[k]: np.array(text) for k, text in self.said.items()}


def _date(text: str) -> datetime.datetime | None:
    """A date with a time of day (ISO 8601); None for what is none, a number above all."""
    if not (len(text) > 10 and text[4:5] == "-" and text[7:8] == "-"):
        return None
    try:
        return datetime.datetime.fromisoformat(text)
    except ValueError:
        return None


def _seconds(date: datetime.datetime, start: datetime.datetime, where: str) -> float:
    try:
        return (date - start).total_seconds()
    except TypeError:
        raise LogError(f"{where}: some dates have a time zone and others have none") from None


def _tabbed(lines: list[str]) -> list[str]:
    """Lines whose fields are parted by any number of blanks, parted by one tab each."""
    return ["\t".join(line.split()) for line in lines]


def _with_units(
    file: TextIO, headings: list[str], delimiter: str, line: int
) -> tuple[list[str], str, int, list[str]]:
    """Headings with the units of a second row; the text read ahead, the number of its line, and a note.

    Units are words where the first row of numbers has none: the time's, and no number in any column.
    """
    start = file.readline(_LONGEST_LINE)
    bare = start.strip()
    if not bare or '"' in bare:
        return headings, start, line, []
    fields = [x.strip() for x in (bare.split() if delimiter == _BLANKS else bare.split(delimiter))]
    units = [x.strip("[]()") for x in fields]
    words = [x for x in units if x]
    if len(fields) != len(headings) or not words or not set(units) & set(_TIMES):
        return headings, start, line, []
    if any(_is_number(x) or _date(x) for x in words):
        return headings, start, line, []
    told = [
        heading if not unit or "[" in heading else f"{heading} [{unit}]"
        for heading, unit in zip(headings, units, strict=True)
    ]
    return told, "", line + 1, [f"line {line} holds the columns' units"]


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return text.lower() in _NOTHING
    return True


def _encoding(path: Path) -> tuple[str, list[str]]:
    """The encoding of the file's text, and a note where it is not the usual UTF-8.

    Spreadsheets write UTF-16, which they mark, and in Western Europe Windows-1252, where ° is one byte.
    """
    with open(path, "rb") as file:
        start = file.readline(_LONGEST_LINE)
    if start[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16", ["the text is in UTF-16"]
    try:
        start.decode("utf-8")
    except UnicodeDecodeError:
        # Control characters are in no heading: such a file is no text at all.
        if all(byte >= 32 or byte in b"\t\r\n" for byte in start):
            return "cp1252", ["the text is not in UTF-8 and was read as Windows-1252"]
    # A byte order mark is not part of the first heading.
    return "utf-8-sig", []


def _header(file: TextIO) -> tuple[list[str], str, int]:
    """Headings, the delimiter, and the number of the line that follows."""
    number, text = 0, ""
    while not text:
        line = file.readline(_LONGEST_LINE)
        if not line:
            raise LogError("the file is empty; a log starts with a row of column names")
        if len(line) >= _LONGEST_LINE or "\0" in line:
            raise LogError("the first line is no heading; is it a CSV file?")
        # NumPy and MATLAB write a heading as a comment, and rostopic.
        number, text = number + 1, line.strip().lstrip("#%").strip()
    delimiter = max(",;\t", key=text.count)
    if delimiter not in text and len(text.split()) > 1:
        # NumPy's savetxt and UR's recorder part columns by blanks.
        delimiter, headings = _BLANKS, text.split()
    else:
        headings = [name.strip() for name in next(csv.reader([text], delimiter=delimiter))]
    if 2 * sum(_is_number(name) for name in headings if name) > len(headings):
        raise LogError(
            "the first line holds numbers, and names of columns are expected: write a line of names before it, with "
            "joints' own: time,qpos.elbow,tau.elbow"
        )
    if repeated := [name for name, count in Counter(headings).items() if name and count > 1]:
        raise LogError(f"two columns are named {repeated[0][:60]!r}; keep one")
    return headings, delimiter, number + 1


def _blocks(file: TextIO, more: More | None, rest: str = "") -> Iterator[list[str]]:
    """The lines that follow `rest`, many at a time, and no line without bound."""
    while True:
        if not (block := file.read(_BLOCK)):
            if more is None or (after := more(file)) is None:
                break
            # A line that a file was cut off in is none.
            file, rest = after, rest if after is file else ""
            continue
        *lines, rest = (rest + block).split("\n")
        if len(rest) > _LONGEST_LINE:
            raise LogError(f"a line is longer than {_LONGEST_LINE} characters; is it a CSV file?")
        if lines:
            yield lines
    if rest and more is None:
        yield [rest.rstrip("\n")]


def _check_budget(table: _Table, left: float, max_bytes: int) -> None:
    """Refuse early: `left` is how many times as long as what was read the whole file is."""
    so_far = table.rows * max(len(table.numbers), 1) * 8
    if so_far * max(left, 1.0) > max_bytes:
        rows = int(table.rows * max(left, 1.0))
        raise LogError(
            f"about {rows} rows of {len(table.numbers)} columns need more than the limit of "
            f"{max_bytes} bytes; cut the log or raise max_bytes"
        )
