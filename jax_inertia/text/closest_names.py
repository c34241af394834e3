"""Names that people type and files hold: what was meant by one that is not there."""

import difflib
from collections.abc import Sequence

_LONGEST, _MOST = 80, 200


def suggestion(name: str, known: Sequence[str]) -> str:
    """A few words that name what may have been meant, or all that there is.

    Names from a file may be of any length and number, and comparing them is quadratic in both: it is done, and they
    are listed, within bounds.
    """
    short = [other[:_LONGEST] for other in known[:_MOST]]
    if close := difflib.get_close_matches(name[:_LONGEST], short, n=1, cutoff=0.6):
        return f"did you mean {close[0]!r}?"
    return f"valid names: {listed(short)}"


def listed(names: Sequence[str], most: int = 60) -> str:
    """Names in a row, as many as fit a message."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(name[:_LONGEST] for name in names[:most]) + more
