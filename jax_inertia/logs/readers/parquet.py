"""Parquet: columns of numbers, or of lists as LeRobot's datasets have them."""

import contextlib
import json
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.readers import arrow_columns, column_plan, columns, normalised
from jax_inertia.logs.readers.options import Contents, Options, required
from jax_inertia.logs.schema import TEXTS
from jax_inertia.text.closest_names import listed

_MOST_INFO = 16 << 20
# What LeRobot's datasets call the arrays.
_LEROBOT = {
    "time": ("timestamp",),
    "qpos": ("observation.state", "observation.position", "observation.qpos"),
    "qvel": ("observation.velocity", "observation.qvel"),
    "tau": ("observation.effort", "observation.torque", "observation.current"),
    "qpos_target": ("action",),
}
# What its names of joints end in, after the joint's own name.
_SUFFIXES = (
    *(".pos", ".position", ".qpos", ".vel", ".velocity", ".qvel"),
    *(".effort", ".torque", ".tau", ".current"),
)
# Of these arrays there may be a column for each arm: observation.torque.left ...
_PARTED = {"qvel", "tau"}
_OPTIONS = ("columns", "joints", "rate", "episode", "calibration")


def read_parquet(path: Path, options: Options, max_bytes: int) -> Contents:
    """Read a Parquet file with columns as in `readers.columns`, or one episode of a LeRobot dataset.

    The dataset's meta/info.json, in a folder above, names the joints. Raises `LogError` for what is missing, and for
    more than `max_bytes` of numbers (as declared by the file, before they are read).
    """
    options.check("a Parquet file", _OPTIONS)
    return _read([path], _info_above(path), options, max_bytes)


def read_dataset(folder: Path, options: Options, max_bytes: int) -> Contents:
    """Read one episode of a LeRobot dataset, by the folder that holds meta/info.json."""
    options.check("a LeRobot dataset", _OPTIONS)
    files = sorted(folder.glob("data/chunk-*/*.parquet"))
    if options.episode is not None:
        # Older datasets keep one episode a file and name it by its number.
        own = f"episode_{options.episode:06d}.parquet"
        files = [file for file in files if file.name == own] or files
    if not files:
        raise LogError("a LeRobot dataset without data/chunk-*/*.parquet")
    return _read(files, _info(folder / "meta" / "info.json"), options, max_bytes)


def parquet_parts(
    path: Path, options: Options, rows: int
) -> Iterator[tuple[column_plan.Plan, dict[str, np.ndarray]]]:
    """The columns of `read_parquet` by heading, up to so many rows at a time and in bounded memory.

    Raises `LogError` as it does, and for columns of lists, as LeRobot's datasets have them.
    """
    options.check("a Parquet file in chunks", ("columns",))
    parquet = required("pyarrow.parquet", "Parquet")
    with _as_log_errors():
        headings, said = _schema(parquet, path, sys.maxsize)
        plan = column_plan.plan(headings, options)
        words = [name for name, column in plan.columns.items() if column.array in TEXTS]
        numbers = [name for name in plan.columns if name not in words]
        texts = arrow_columns.read(path, words, None, _MOST_INFO) if words else {}
        # What the metadata says goes for a column that says it in every row.
        stated = {plan.columns[name].array for name in words}
        more = {name: text for name, text in said.items() if name not in stated}
        plan = plan._replace(
            columns={
                **plan.columns,
                **{name: column_plan.Column(name, "", "", "") for name in more},
            }
        )
        texts |= {name: np.array(text) for name, text in more.items()}
        if not numbers:
            columns.arrays(plan, texts)
        for part in arrow_columns.batches(path, numbers, rows):
            yield plan, part | texts


def _read(
    files: Sequence[Path], info: Mapping[str, Any], options: Options, max_bytes: int
) -> Contents:
    parquet = required("pyarrow.parquet", "Parquet")
    with _as_log_errors():
        headings, texts = _schema(parquet, files[0], max_bytes)
        lerobot = "observation.state" in headings
        asked = _lerobot(headings, options) if lerobot else options
        plan = column_plan.plan(headings, asked)
        values = _values(files, plan, "episode_index" in headings, options.episode, max_bytes)
    names = {heading: _names(info, heading) for heading in plan.columns}
    plan, left_out = _without_others(plan, values, names, options)
    own = next((h for h, c in plan.columns.items() if c.array == "qpos" and not c.of), "")
    if options.joints:
        names[own] = list(options.joints)
    plan, values = columns.spread(plan, values, names)
    contents = columns.arrays(plan, values, options.joints or names.get(own, ()), options.rate)
    if lerobot:
        contents.notes = [*contents.notes, *_sources(plan, left_out)]
        normalised.seen_to(contents, options)
    elif options.calibration is not None:
        raise LogError(
            "the option calibration does not apply to a Parquet file that is not LeRobot's"
        )
    for name, text in texts.items():
        contents.arrays.setdefault(name, np.array(text))
    return contents


@contextlib.contextmanager
def _as_log_errors() -> Iterator[None]:
    try:
        yield
    except LogError:
        raise
    except MemoryError:
        raise LogError("needs more memory than there is; cut the log") from None
    except Exception as error:
        # Arrow raises many kinds on damaged files, and none of them is ours to know.
        text = " ".join(str(error).split())[:200] or type(error).__name__
        own = type(error) is ValueError
        raise LogError(text if own else f"cannot be read as Parquet: {text}") from None


def _values(
    files: Sequence[Path],
    plan: column_plan.Plan,
    by_episode: bool,
    episode: int | None,
    max_bytes: int,
) -> dict[str, np.ndarray]:
    """The planned columns of all files, of one episode."""
    wanted = [*plan.columns, *(["episode_index"] if by_episode else [])]
    if not plan.columns:
        return {}
    parts, left = [], max_bytes
    for file in files:
        if by_episode and episode is not None and len(files) > 1:
            # Cheap compared with the rest: most files of a dataset have nothing of one episode.
            own = arrow_columns.read(file, ["episode_index"], None, left)["episode_index"]
            if episode not in own:
                continue
        part = arrow_columns.read(file, wanted, episode if by_episode else None, left)
        if lacking := [name for name in wanted if name not in part]:
            raise LogError(f"column {lacking[0]!r} is not in every file of the dataset")
        if any(value.size for value in part.values() if value.ndim):
            parts.append(part)
            left -= sum(value.nbytes for value in part.values())
        if by_episode:
            _one_episode(parts)
    if not parts:
        which = "" if episode is None else f" of episode {episode}"
        raise LogError(f"holds no rows{which}")
    return {name: arrow_columns.joined(name, [p[name] for p in parts]) for name in plan.columns}


def _schema(parquet: Any, file: Path, max_bytes: int) -> tuple[list[str], dict[str, str]]:
    """Column names, and what the file says of the torque in its metadata."""
    with arrow_columns.opened(parquet, file) as opened:
        schema = opened.schema_arrow
        said = schema.metadata or {}
        texts = {
            name: said[name.encode()].decode("utf-8", "replace")
            for name in ("tau_unit", "tau_kind")
            if name.encode() in said
        }
        names = list(schema.names)
        # Not by column: for some damaged files Arrow's columns end the process instead of raising.
        rows = opened.metadata.num_rows
    if 8 * rows * 3 > max_bytes:
        raise LogError(
            f"declares {rows} rows, more than the limit of {max_bytes} bytes has room for; cut the log or raise "
            "max_bytes"
        )
    if repeated := [name for name, count in Counter(names).items() if count > 1]:
        raise LogError(f"two columns are named {repeated[0][:60]!r}; keep one")
    return names, texts


def _one_episode(parts: Sequence[Mapping[str, np.ndarray]]) -> None:
    """Refuse more than one episode as soon as a second one is seen."""
    present = sorted({float(k) for part in parts for k in np.unique(part["episode_index"])})
    if len(present) > 1:
        raise LogError(
            f"holds several episodes ({present[0]:g}, {present[1]:g} ...); choose one with --episode"
        )


# --- LeRobot -----------------------------------------------------------------------------------------------------


def _lerobot(headings: Sequence[str], options: Options) -> Options:
    """The options with LeRobot's names for what they leave open."""
    known: dict[str, str | Sequence[str]] = {}
    for target, sources in _LEROBOT.items():
        if target in options.columns:
            continue
        parts = [h for s in sources for h in headings if h.startswith(s + ".")]
        whole = next((source for source in sources if source in headings), None)
        if whole is not None:
            known[target] = whole
        elif target in _PARTED and parts:
            known[target] = parts
    if not {"tau", "qpos_target"} & (known.keys() | options.columns.keys()):
        own = [h for h in headings if h.startswith(("observation.", "action"))]
        raise LogError(
            "this dataset has no torque (observation.effort) and no targets (action); name what "
            f"stands for one with --column tau=NAME or qpos_target=NAME; it has {listed(own, 20)}"
        )
    return Options(**{**vars(options), "columns": {**known, **options.columns}})


def _without_others(
    plan: column_plan.Plan,
    values: Mapping[str, np.ndarray],
    names: Mapping[str, Sequence[str]],
    options: Options,
) -> tuple[column_plan.Plan, list[str]]:
    """The plan without guessed columns that are of no joint: an action may be of the hand, or of a base."""
    kept, left_out = dict(plan.columns), []
    for place, column in plan.columns.items():
        if column.array != "qpos" or column.of or values[place].ndim != 2:
            continue
        for heading, other in plan.columns.items():
            if other.array not in ("qvel", "qpos_target") or other.array in options.columns:
                continue
            fits = values[heading].shape == values[place].shape
            if not fits and not set(names[heading]) & set(names[place]):
                del kept[heading]
                left_out.append(heading)
    return column_plan.Plan(kept, (*plan.others, *left_out)), left_out


def _sources(plan: column_plan.Plan, left_out: Sequence[str]) -> list[str]:
    """Which of a dataset's columns each array was taken from, and those that are of no joint."""
    found: dict[str, dict[str, None]] = {}
    for heading, column in plan.columns.items():
        found.setdefault(column.array, {})[heading.partition("[")[0]] = None
    told = [f"columns: {', '.join(f'{to} from {listed(list(own))}' for to, own in found.items())}"]
    return told + [f"left out, not of the joints: {listed(left_out)}"] * bool(left_out)


def _info_above(path: Path) -> Mapping[str, Any]:
    """The meta/info.json of the dataset that a file is part of, empty where it is part of none."""
    for folder in path.resolve().parents[:4]:
        if (folder / "meta" / "info.json").is_file():
            return _info(folder / "meta" / "info.json")
    return {}


def _info(path: Path) -> Mapping[str, Any]:
    try:
        with open(path, "rb") as file:
            text = file.read(_MOST_INFO)
        info = json.loads(text)
    except (OSError, ValueError, RecursionError) as error:
        raise LogError(
            f"{path.name} cannot be read: {' '.join(str(error).split())[:200]}"
        ) from None
    if not isinstance(info, dict):
        raise LogError(f"{path.name} does not hold an object")
    return info


def _names(info: Mapping[str, Any], source: str) -> list[str]:
    """Joint names of a column of lists, as meta/info.json gives them."""
    features = info.get("features")
    feature = features.get(source) if isinstance(features, dict) else None
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict) and names:
        # Names come in groups, {"motors": [...]}, or as a map from names to places.
        first = next(iter(names.values()))
        names = first if isinstance(first, list) else list(names)
    if isinstance(names, list) and len(names) == 1 and isinstance(names[0], list):
        names = names[0]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return []
    return [_bare(name) for name in names]


def _bare(name: str) -> str:
    end = next((s for s in _SUFFIXES if name.endswith(s) and len(name) > len(s)), "")
    return name.removesuffix(end)
