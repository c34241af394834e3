"""What MuJoCo warns of, kept from the terminal and from a file MUJOCO_LOG.TXT in the user's folder."""

import contextlib
from collections.abc import Callable, Iterator

import mujoco


@contextlib.contextmanager
def mujoco_warnings(tell: Callable[[str], None] = lambda line: None) -> Iterator[list[str]]:
    """The different warnings that MuJoCo gives while the block runs, one line each, as they come.

    Its default prints each and appends it to MUJOCO_LOG.TXT in the current folder. One handler serves the process.
    """
    said: list[str] = []

    def hear(message: str | bytes) -> None:
        text = message.decode("utf-8", "replace") if isinstance(message, bytes) else message
        line = " ".join(text.split())
        if line not in said:
            said.append(line)
            tell(line)

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(hear)
    try:
        yield said
    finally:
        mujoco.set_mju_user_warning(before)
