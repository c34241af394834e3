"""Several reports as one page: one file, nothing in it is fetched, nothing in it runs."""

import dataclasses
from collections.abc import Sequence
from typing import Any

from jax_inertia.fleet.drift import Drift, changing
from jax_inertia.fleet.numbers import Errors, Interval, Quantity, errors, lacks, numbers
from jax_inertia.text.report_page import rendered
from jax_inertia.text.words import chance, number, plain


@dataclasses.dataclass(frozen=True)
class Column:
    """One report, as it stands in the table."""

    name: str
    report: dict[str, Any]
    robot: str = ""
    date: str = ""
    link: str = ""
    """Its own page, from this one."""

    @property
    def errors(self) -> Errors | None:
        """Error on the run that it checks itself on."""
        return errors(self.report)

    @property
    def lacks(self) -> list[str]:
        """What its model lacks, in words."""
        return lacks(self.report)


@dataclasses.dataclass(frozen=True)
class Refused:
    """A log that could not be diagnosed, and why."""

    name: str
    reason: str


@dataclasses.dataclass(frozen=True)
class Row:
    """One number in all reports; None where a report lacks it."""

    quantity: Quantity
    cells: tuple[Interval | None, ...]
    changes: bool


def table(columns: Sequence[Column]) -> list[Row]:
    """Every number of the reports, in the order in which they come; which differ by more than their intervals say."""
    found = [numbers(c.report) for c in columns]
    every = {
        q: tuple(one.get(q) for one in found)
        for q in dict.fromkeys(q for one in found for q in one)
    }
    marked = changing(every)
    return [Row(q, cells, q in marked) for q, cells in every.items()]


def page(
    title: str,
    columns: Sequence[Column],
    drifts: Sequence[Drift] = (),
    refused: Sequence[Refused] = (),
) -> str:
    """The reports side by side as HTML, every name in it escaped; with `drifts` of a fleet."""
    filters = {"plain": plain, "number": number, "chance": chance, "title": label}
    rows = table(columns)
    return rendered(
        "jax_inertia.fleet",
        filters,
        title=title,
        columns=columns,
        rows=rows,
        changed=[row for row in rows if row.changes],
        drifts=drifts,
        dated=bool(drifts),
        fleet=any(c.robot for c in columns),
        refused=refused,
    )


def label(q: Quantity) -> str:
    """A quantity in words, without its place."""
    name = plain(q.family) + (f", {plain(q.parameter)}" if q.parameter else "")
    return name + (f" [{q.unit}]" if q.unit else "")


def _finite(e: Errors) -> dict[str, Any]:
    return {k: None if x != x else x for k, x in e._asdict().items()}


def to_json(
    columns: Sequence[Column], drifts: Sequence[Drift] = (), refused: Sequence[Refused] = ()
) -> dict[str, Any]:
    """The same for scripts."""

    def one(i: Interval | None) -> dict[str, Any] | None:
        return None if i is None else {"value": i.value, "ci95": [i.low, i.high]}

    return {
        "schema": 1,
        "reports": [
            {
                "name": c.name,
                "robot": c.robot,
                "date": c.date,
                "verdict": c.report["verdict"],
                "confidence": c.report.get("confidence"),
                "lacks": c.lacks,
                "error": None if c.errors is None else _finite(c.errors),
            }
            for c in columns
        ],
        "numbers": [
            {
                **row.quantity._asdict(),
                "values": [one(x) for x in row.cells],
                "changes": row.changes,
            }
            for row in table(columns)
        ],
        "drifts": [
            {
                "robot": d.robot,
                **d.quantity._asdict(),
                "first": d.first,
                "last": d.last,
                "logs": d.logs,
                "per_30_days": one(d.per_month),
                "stands_out": d.stands_out,
            }
            for d in drifts
        ],
        "refused": [dataclasses.asdict(r) for r in refused],
    }
