"""What a file calls a model's joints: with a prefix, a namespace or an ending of its own, or without the model's."""

import difflib
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from jax_inertia.text.closest_names import listed

# Names are compared in pairs, each place of one with each of the other.
_LONGEST, _MOST = 80, 200


class Affixes(NamedTuple):
    """What stands before and after the part of a name that a file and a model share."""

    file: tuple[str, str]
    model: tuple[str, str]

    def of_model(self, name: str) -> str | None:
        """The model's name for a file's; None where the file's is none with these affixes.

        >>> from jax_inertia.logs.joint_names import Affixes
        >>> Affixes(("left_", ""), ("", "_joint")).of_model("left_elbow")
        'elbow_joint'
        """
        (before, after), (ours, end) = self
        if len(name) <= len(before) + len(after):
            return None
        core = name[len(before) : len(name) - len(after)]
        return ours + core + end if name == before + core + after else None


def fitted(joints: Sequence[str], wanted: Sequence[str]) -> dict[str, str]:
    """The model's name of each joint of a file; none where one fits as it stands, and where several ways do.

    At either end of its names the file or the model may have more than the other, the same at every joint. Upper and
    lower case, and what parts words, are no difference. Every joint of the model must fit, or every one of the file.

    >>> from jax_inertia.logs.joint_names import fitted
    >>> fitted(("joint1", "joint2", "joint3"), ("panda_joint1", "panda_joint2", "panda_joint3", "panda_finger_joint1"))
    {'joint1': 'panda_joint1', 'joint2': 'panda_joint2', 'joint3': 'panda_joint3'}
    """
    theirs, ours = _plain(joints), _plain(wanted)
    if not theirs or not ours or set(wanted) & set(joints):
        return {}
    ways = {
        frozenset(found.items())
        for affixes in _aligned(theirs, ours)
        if (found := _pairs(affixes, theirs, ours))
    }
    return dict(sorted(next(iter(ways)))) if len(ways) == 1 else {}


def proposal(joints: Sequence[str], wanted: Sequence[str]) -> str:
    """`FILE*=MODEL*` as `--rename` has it, where names differ by more than an affix of one side; else empty.

    A right arm's names differ so from a left one's: it is for the user to say that they are the same.

    >>> from jax_inertia.logs.joint_names import proposal
    >>> proposal(("fr3_joint1", "fr3_joint2"), ("panda_joint1", "panda_joint2"))
    'fr3*=panda*'
    """
    if max(map(len, (*joints, *wanted)), default=0) > _LONGEST:
        return ""
    theirs, ours = ({x: x for x in names[:_MOST]} for names in (joints, wanted))
    for one, other in _ends(theirs, ours):
        a, b, size = difflib.SequenceMatcher(None, one, other, autojunk=False).find_longest_match()
        if not size:
            continue
        affixes = Affixes((one[:a], one[a + size :]), (other[:b], other[b + size :]))
        if _pairs(affixes, theirs, ours):
            return "=".join(f"{before}*{after}" for before, after in affixes)
    return ""


def note_of(names: dict[str, str]) -> str:
    """A note of joints that go by other names."""
    return f"the file's joints are the model's by other names: {listed([f'{x} is {y}' for x, y in names.items()], 4)}"


def _pairs(affixes: Affixes, theirs: dict[str, str], ours: dict[str, str]) -> dict[str, str]:
    """Names of both by affixes, where these are all of one side's."""
    found = {theirs[x]: ours[y] for x in theirs if (y := affixes.of_model(x)) in ours}
    return found if len(found) in (len(theirs), len(ours)) else {}


def _plain(names: Sequence[str]) -> dict[str, str]:
    """Names by their letters and digits; none where two are the same then, or are too many or long to compare."""
    out = {re.sub(r"[\W_]+", "_", name.casefold()): name for name in names[: _MOST + 1]}
    same = len(out) == len(names) <= _MOST
    return out if same and max(map(len, out), default=0) <= _LONGEST else {}


def _ends(theirs: Iterable[str], ours: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Pairs among which one is right, if all names of one side have a counterpart."""
    theirs, ours = list(theirs), list(ours)
    yield from ((theirs[0], other) for other in ours)
    yield from ((one, ours[0]) for one in theirs[1:])


def _aligned(theirs: Iterable[str], ours: Iterable[str]) -> set[Affixes]:
    """Ways to lay one name along another so that they are the same where both are."""
    out = set()
    for one, other in _ends(theirs, ours):
        for k in range(1 - len(one), len(other)):
            # one[0] lies at other[k].
            a, b = max(-k, 0), max(k, 0)
            size = min(len(one) - a, len(other) - b)
            if one[a : a + size] == other[b : b + size]:
                out.add(Affixes((one[:a], one[a + size :]), (other[:b], other[b + size :])))
    return out
