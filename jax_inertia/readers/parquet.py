"""Parquet: columns of numbers, or of lists as LeRobot's datasets have them."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jax_inertia._names import listed
from jax_inertia._npz import LogError
from jax_inertia.readers import columns
from jax_inertia.readers.options import Contents, Options, required

_MOST_INFO = 16 << 20
# What LeRobot's datasets call the arrays.
_LEROBOT = {
    "time": ("timestamp",),
    "qpos": ("observation.state", "observation.position", "observation.qpos"),
    "qvel": ("observation.velocity", "observation.qvel"),
    "tau": ("observation.effort", "observation.torque", "observation.current"),
    "qpos_target": ("action",),
}
_SUFFIXES = (".pos", ".position", ".qpos")


def read_parquet(path: Path, options: Options, max_bytes: int) -> Contents:
    """Read a Parquet file with columns as in `readers.columns`, or one episode of a LeRobot dataset.

    The dataset's meta/info.json, in a folder above, names the joints. Raises `LogError` for what is missing, and for
    more than `max_bytes` of numbers (as declared by the file, before they are read).
    """
    options.check("a Parquet file", ("columns", "joints", "episode"))
    return _read([path], _info_above(path), options, max_bytes)


def read_dataset(folder: Path, options: Options, max_bytes: int) -> Contents:
    """Read one episode of a LeRobot dataset, by the folder that holds meta/info.json."""
    options.check("a LeRobot dataset", ("columns", "joints", "episode"))
    files = sorted(folder.glob("data/chunk-*/*.parquet"))
    if options.episode is not None:
        # Older datasets keep one episode a file and name it by its number.
        own = f"episode_{options.episode:06d}.parquet"
        files = [file for file in files if file.name == own] or files
    if not files:
        raise LogError("a LeRobot dataset without data/chunk-*/*.parquet")
    return _read(files, _info(folder / "meta" / "info.json"), options, max_bytes)


def _read(
    files: Sequence[Path], info: Mapping[str, Any], options: Options, max_bytes: int
) -> Contents:
    parquet = required("pyarrow.parquet", "Parquet")
    try:
        headings, texts = _schema(parquet, files[0])
        asked = _lerobot(headings, options) if "observation.state" in headings else options
        plan = columns.plan(headings, asked)
        wanted = list(plan.columns)
        by_episode = "episode_index" in headings
        if by_episode:
            wanted.append("episode_index")
        parts = []
        for file in files:
            part = _columns(
                parquet, file, wanted, options.episode if by_episode else None, max_bytes
            )
            if len(next(iter(part.values()), ())):
                parts.append(part)
            if by_episode:
                _one_episode(parts)
    except LogError:
        raise
    except MemoryError:
        raise LogError("needs more memory than there is; cut the log") from None
    except Exception as error:
        # Arrow raises many kinds on damaged files, and none of them is ours to know.
        text = " ".join(str(error).split())[:200]
        raise LogError(f"cannot be read as Parquet: {text or type(error).__name__}") from None
    if not parts:
        which = "" if options.episode is None else f" of episode {options.episode}"
        raise LogError(f"holds no rows{which}")
    for name in plan.columns:
        if any(name not in part for part in parts):
            raise LogError(f"column {name!r} is not in every file of the dataset")
    values = {name: _joined(name, [part[name] for part in parts]) for name in plan.columns}
    contents = columns.arrays(plan, values, options.joints or _names(info, plan))
    for name, text in texts.items():
        contents.arrays.setdefault(name, np.array(text))
    return contents


def _schema(parquet: Any, file: Path) -> tuple[list[str], dict[str, str]]:
    """Column names, and what the file says of the torque in its metadata."""
    with _opened(parquet, file) as opened:
        schema = opened.schema_arrow
        said = schema.metadata or {}
        texts = {
            name: said[name.encode()].decode("utf-8", "replace")
            for name in ("tau_unit", "tau_kind")
            if name.encode() in said
        }
        names = list(schema.names)
    if repeated := [name for name, count in Counter(names).items() if count > 1]:
        raise LogError(f"two columns are named {repeated[0][:60]!r}; keep one")
    return names, texts


def _opened(parquet: Any, file: Path) -> Any:
    return parquet.ParquetFile(
        file, thrift_string_size_limit=1 << 24, thrift_container_size_limit=1 << 22
    )


def _columns(
    parquet: Any, file: Path, wanted: Sequence[str], episode: int | None, max_bytes: int
) -> dict[str, np.ndarray]:
    """The wanted columns of one file, rows of one episode where asked for."""
    with _opened(parquet, file) as opened:
        _check_budget(opened.metadata, wanted, max_bytes)
        out: dict[str, list[np.ndarray]] = {}
        total = 0
        for batch in opened.iter_batches(batch_size=1 << 16, columns=list(wanted)):
            part = {n: _numbers(n, batch.column(n)) for n in batch.schema.names if n in wanted}
            if episode is not None:
                keep = part["episode_index"] == episode
                part = {name: value[keep] for name, value in part.items()}
            for name, value in part.items():
                total += value.nbytes
                out.setdefault(name, []).append(value)
            if total > max_bytes:
                raise LogError(f"holds more than the limit of {max_bytes} bytes; cut the log")
    return {name: _joined(name, parts) for name, parts in out.items()}


def _check_budget(metadata: Any, wanted: Sequence[str], max_bytes: int) -> None:
    """Add up what the file declares of the columns that are wanted."""
    total = 0
    for g in range(metadata.num_row_groups):
        group = metadata.row_group(g)
        for c in range(group.num_columns):
            column = group.column(c)
            owner = column.path_in_schema
            if any(owner == name or owner.startswith(f"{name}.") for name in wanted):
                total += 8 * max(column.num_values, group.num_rows)
    if total > max_bytes or metadata.num_rows * 8 > max_bytes:
        raise LogError(
            f"declares {metadata.num_rows} rows, {max(total, metadata.num_rows * 8)} bytes of "
            f"numbers, above the limit of {max_bytes}; cut the log or raise max_bytes"
        )


def _numbers(name: str, column: Any) -> np.ndarray:
    """One column as float64 (T,) or (T, width), or its text."""
    kind = str(column.type)
    if kind.startswith(("string", "large_string", "dictionary<values=string")):
        return np.array([str(x or "") for x in column.to_pylist()], dtype=np.str_)
    if kind.startswith("timestamp"):
        return column.cast("timestamp[ns]").cast("int64").to_numpy(zero_copy_only=False) * 1e-9
    if kind.startswith(("list", "large_list", "fixed_size_list")):
        if column.null_count:
            raise LogError(f"column {name!r} has rows without a list")
        flat = column.flatten()
        rows = len(column)
        lengths = column.value_lengths().to_numpy(zero_copy_only=False) if rows else np.zeros(0)
        if rows and (lengths != lengths[0]).any():
            raise LogError(f"column {name!r} holds lists of different lengths")
        if not _is_number(str(flat.type)):
            raise LogError(f"column {name!r} holds lists of {flat.type}; expected numbers")
        width = int(lengths[0]) if rows else 0
        return flat.to_numpy(zero_copy_only=False).astype(float).reshape(rows, width)
    if not _is_number(kind):
        raise LogError(f"column {name!r} holds {kind[:60]}; expected numbers")
    return column.to_numpy(zero_copy_only=False).astype(float)


def _is_number(kind: str) -> bool:
    return kind.startswith(("int", "uint", "float", "double", "halffloat", "bool"))


def _joined(name: str, parts: Sequence[np.ndarray]) -> np.ndarray:
    if len({part.shape[1:] for part in parts}) > 1:
        raise LogError(f"column {name!r} holds lists of different lengths")
    whole = np.concatenate([np.atleast_1d(part) for part in parts])
    if whole.dtype.kind == "U":
        words = sorted(set(whole.tolist()))
        if len(words) != 1:
            raise LogError(f"column {name!r} holds {listed(words, 3)}; it is one text, repeated")
        return np.array(words[0])
    return whole


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
    known = {
        target: source
        for target, sources in _LEROBOT.items()
        for source in sources
        if source in headings and target not in options.columns
    }
    if "tau" not in known and "tau" not in options.columns:
        own = [h for h in headings if h.startswith(("observation.", "action"))]
        raise LogError(
            "this dataset has no torque (observation.effort); name what stands for it with "
            f"--column tau=NAME; it has {listed(own, 20)}"
        )
    return Options(**{**vars(options), "columns": {**known, **options.columns}})


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


def _names(info: Mapping[str, Any], plan: columns.Plan) -> list[str]:
    """Joint names of the list column that the positions are in, as meta/info.json gives them."""
    source = next((h for h, c in plan.columns.items() if c.array == "qpos" and not c.of), "")
    features = info.get("features")
    feature = features.get(source) if isinstance(features, dict) else None
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict) and names:
        # Names come in groups, {"motors": [...]}, or as a map from names to places.
        first = next(iter(names.values()))
        names = first if isinstance(first, list) else list(names)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return []
    return [_bare(name) for name in names]


def _bare(name: str) -> str:
    end = next((s for s in _SUFFIXES if name.endswith(s) and len(name) > len(s)), "")
    return name.removesuffix(end)
