"""Logs in the formats that people have them in, as the arrays of the log contract.

`jax_inertia.logs.log_files` chooses the reader by the kind of file. A reader takes nothing on trust: what a file
claims is checked before memory is taken for it, compressed data is unfolded within a bound, and whatever is wrong
becomes one `LogError`. Parquet, ROS bags and MCAP need the extra `readers`.
"""

from jax_inertia.logs.readers.options import Options, WrenchAxes

__all__ = ["Options", "WrenchAxes"]
