"""Motions that show effects, and that tell those apart which one log cannot."""

import dataclasses
from collections.abc import Mapping


@dataclasses.dataclass(frozen=True)
class Advice:
    """The motion that shows an effect; `{joint}` stands for where."""

    kind: str
    """Short and stable: scripts read it."""
    text: str
    numbers: Mapping[str, float]
    """By name with unit, such as `speed_below_rad_s`."""
    why: str = ""
    """What tells effects that share this advice from each other."""
    alone: bool = False
    """Whether it tells an effect from those of any other advice too."""


WIDE = Advice(
    "wide and at many speeds",
    "Move {joint} over its whole range at slow, usual and high speed, with reversals at each",
    {"seconds": 20.0},
    "the two effects have the same torque only along this log's path",
)
SLOW_REVERSALS = Advice(
    "slow reversals",
    "Turn {joint} slowly to and fro, well below 0.1 rad/s, and at several loads",
    {"speed_below_rad_s": 0.05, "reversals": 10.0},
    "dry friction laws differ only at low speed, in their direction, and with load",
)
STARTS_AND_STOPS = Advice(
    "starts and stops",
    "Start and stop {joint} as fast as it may, in small moves about one posture",
    {"moves": 10.0},
)
BOTH_WAYS = Advice(
    "postures from both sides",
    "Come to rest with {joint} in several postures, each reached slowly from either side",
    {"postures": 6.0},
)
FROM_COLD = Advice(
    "from cold",
    "Begin the log with {joint} cold, and repeat one motion until it is as warm as in use",
    {"seconds": 600.0},
)
SLOW_SWEEP = Advice(
    "slow sweep",
    "Turn {joint} once over its whole range at a steady low speed, and back",
    {"speed_below_rad_s": 0.1},
)
KNOWN_WEIGHT = Advice(
    "with a known weight",
    "Record one motion of {joint} twice, without and with a weight that was put on a scale",
    {"runs": 2.0},
)
SMALL_AND_LARGE = Advice(
    "small and large torques",
    "Repeat one motion of {joint} at half and at full speed",
    {"peak_torque_share_low": 0.4, "peak_torque_share_high": 1.0},
    "a limit shows at large torques only, a gain at all of them",
    alone=True,
)
FAST_SWEEP = Advice(
    "fast sweep",
    "Sweep the torque from 5 to 25 Hz",
    {"from_hz": 5.0, "to_hz": 25.0},
    "a delay and a first-order lag have the same phase when slow, and differ above some ten hertz",
)
TORQUE_REVERSALS = Advice(
    "torque reversals",
    "Let the torque at {joint} change sign often, slowly and quickly, in several postures",
    {"torque_reversals": 20.0},
    "play opens at every reversal, a spring follows the torque, an offset does neither",
    alone=True,
)
BRISK = Advice(
    "brisk, in many postures",
    "Turn the same body through very different postures, and accelerate it hard in some of them",
    {"postures": 6.0, "acceleration_rad_s2": 10.0},
    "weight follows gravity, inertia follows acceleration, a cable's pull follows neither",
)
TURNED_BASE = Advice(
    "links level, turned about",
    "Hold the links level, and turn the whole arm about the vertical once",
    {"turns": 1.0},
)
AGAIN = Advice(
    "once more", "Record the same motion once more, and let nobody touch it", {"runs": 2.0}
)
ONE_AT_A_TIME = Advice(
    "one joint at a time",
    "Move {joint} with the joint before it held still, then that one with {joint} held still",
    {"seconds_each": 10.0},
)
ON_A_SCALE = Advice(
    "on a scale", "Stand still, in several postures, on a scale or a force plate", {"postures": 4.0}
)
ALONE = Advice(
    "one joint alone",
    "Move {joint} alone, the others held still, over its whole range at slow and usual speed, in several postures of "
    "the others",
    {"seconds": 20.0},
    "what remains is mostly there, and then it is seen apart from the other joints",
)
ANOTHER = Advice(
    "another motion",
    "Record a different motion of the same robot and give it as the test log",
    {"seconds": 15.0},
    "so far every check is on stretches of the one motion",
)
