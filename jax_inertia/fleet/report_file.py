"""report.json of a diagnosis, checked against its published schema when it is read."""

import functools
import json
from importlib import resources
from pathlib import Path
from typing import Any, NoReturn

import jsonschema

from jax_inertia.logs.plain_file import read_plain

_SCHEMA = "report-1.schema.json"
_MOST_BYTES = 64 << 20
_SHOWN = 160
_MOST = 1e100


@functools.cache
def schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of report.json, version 1."""
    return json.loads(
        resources.files("jax_inertia.fleet").joinpath(_SCHEMA).read_text(encoding="utf-8")
    )


def read_report(path: Path) -> dict[str, Any]:
    """report.json of a diagnosis, from the file or from its folder.

    Raises ValueError with one line where the file is absent, no JSON or not as `schema` says, and names the entry.
    """
    path = path / "report.json" if path.is_dir() else path
    try:
        raw = read_plain(path, _MOST_BYTES)
        report = json.loads(
            raw.decode("utf-8"), parse_int=_number, parse_float=_number, parse_constant=_no_number
        )
        # Half of a surrogate pair is no text that a page could hold.
        json.dumps(report, ensure_ascii=False).encode("utf-8")
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        reason = str(error).partition("\n")[0][:_SHOWN]
        raise ValueError(
            f"{path} is no JSON ({reason}); give report.json, or a folder with it"
        ) from None
    _require_valid(path, report)
    return report


def _require_valid(path: Path, report: Any) -> None:
    validator = jsonschema.Draft202012Validator(schema())
    for error in validator.iter_errors(report):
        if not error.absolute_path:
            raise ValueError(
                f"{path} is no report of a diagnosis ({error.message[:_SHOWN]}); give report.json of jax-inertia "
                "diagnose, or a folder with it"
            )
        inner = max(
            error.context or [error],
            key=lambda e: (len(e.absolute_path), e.schema.get("type") != "null"),
        )
        raise ValueError(
            f"{path} is no sound report: {inner.json_path[:_SHOWN]}: {inner.message[:_SHOWN]}; diagnose the log again"
        )


def _number(text: str) -> float:
    """A number that sums and differences may be made of; what is next to 0 is 0."""
    number = float(text)
    if not abs(number) < _MOST:
        raise ValueError(f"{text[:20]} is no number")
    return number if abs(number) > 1.0 / _MOST else 0.0


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number")
