"""How far a long computation is: stages by name, each with the share of the whole that is usually done before it."""

from collections.abc import Callable

Progress = Callable[[str], None]

SHARES = {
    # Torque → motion.
    "looking at the log": 0.02,
    "filtering the log": 0.05,
    "ordinary physics of every joint": 0.15,
    "ordinary physics alone": 0.25,
    "columns of every other effect": 0.26,
    "odd effects by their evidence": 0.40,
    "checking on rows that numbers": 0.70,
    "what this log would have shown": 0.80,
    "the error of what is handed over": 0.81,
    "rolling models out in MuJoCo": 0.82,
    # Replays of targets.
    "as modelled": 0.03,
    "looking for kp and delay": 0.04,
    "the same with a friction that creeps": 0.18,
    "with kp, delay, friction": 0.42,
    "looking for odd effects": 0.44,
    "taking each effect back": 0.75,
    "fitting all of it": 0.85,
    "writing, reading back": 0.95,
    "replaying the test": 0.96,
    # Estimates.
    "resampling, low-pass, differences": 0.05,
    "calibrating on the logs without load": 0.10,
    "start-up bias": 0.25,
    "batch fit": 0.30,
    "noise": 0.50,
    "filter": 0.60,
    "load and calibration in one fit": 0.75,
    "what the log can tell": 0.85,
    "writing": 0.97,
}
"""Beginning of a stage's text: share of the time before it, measured on the logs of the first-hour pages."""


class Stage(str):
    """The text of a stage, with the share of the whole work (0 to 1) that is usually done when it begins."""

    share: float

    def __new__(cls, text: str, share: float) -> "Stage":
        stage = super().__new__(cls, text)
        stage.share = share
        return stage


def shared(progress: Progress) -> Progress:
    """A callback that hands `Stage`s on to `progress`; shares never fall, and a text without one keeps the last."""
    share = 0.0

    def report(text: str) -> None:
        nonlocal share
        known = text.share if isinstance(text, Stage) else share_of(text)
        share = max(share, known or 0.0)
        progress(Stage(text, share))

    return report


def share_of(text: str) -> float | None:
    """Share of the time before a stage; None for one that is not in the list."""
    return next((share for start, share in SHARES.items() if text.startswith(start)), None)
