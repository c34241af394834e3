"""A log's arrays as a table of columns, CSV or Parquet, that `read_log` reads back to the last bit."""

import csv
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jax_inertia.logs.atomic_files import whole_file
from jax_inertia.logs.readers.columns import headings_of
from jax_inertia.logs.readers.options import required


def write_table(arrays: Mapping[str, np.ndarray], path: Path) -> None:
    """Write the contract's arrays as `.csv` or `.parquet`, whole or not at all; ValueError for another suffix."""
    columns, rows = headings_of(arrays), len(arrays["time"])
    whole = {name: np.broadcast_to(value, (rows,)) for name, value in columns.items()}
    if path.suffix.lower() == ".parquet":
        arrow, parquet = required("pyarrow", "Parquet"), required("pyarrow.parquet", "Parquet")
        table = arrow.table({name: np.ascontiguousarray(value) for name, value in whole.items()})
        with whole_file(path) as file:
            parquet.write_table(table, file)
    elif path.suffix.lower() == ".csv":
        with whole_file(path) as file:
            text = io.TextIOWrapper(file, encoding="utf-8", newline="")
            writer = csv.writer(text)
            writer.writerow(whole)
            # Python's shortest form of a float is the one that reads back as the same float.
            writer.writerows(zip(*(value.tolist() for value in whole.values()), strict=True))
            text.detach()
    else:
        raise ValueError(f"cannot write {path}: a table is written as .csv or .parquet")
