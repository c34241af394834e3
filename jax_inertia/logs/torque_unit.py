"""What a logged torque is measured in, and where it comes from."""

import re
from enum import StrEnum

_UNIT_END = r"(?=$|\s*[\[(,;:])"
_UNITS = (
    (r"n(?:ewtons?)?[\s·⋅∙*._-]*m(?:et(?:re|er)s?)?", "N m"),
    (r"a(?:mp(?:ere)?s?)?(?:\s*(?:rms|peak))?", "A"),
    (r"m\s?a(?:\s*(?:rms|peak))?|milliamp(?:ere)?s?", "mA"),
)


class TorqueUnit(StrEnum):
    """What `Log.tau` is measured in; anything but N m means an unknown drive gain per joint."""

    NEWTON_METRE = "N m"
    AMPERE = "A"
    MILLIAMPERE = "mA"
    PWM = "PWM"
    UNKNOWN = "unknown"

    @classmethod
    def parse(cls, text: str) -> "TorqueUnit":
        """Read a unit at the start of free text: `"Nm (joint torque sensor)"`, `"A, measured"`,
        `"PWM counts"`.

        What follows the unit must be a remark (bracket, comma, semicolon, colon), so that `"Nm/A"`
        stays unknown.
        """
        head = text.strip().lower()
        if bracketed := re.fullmatch(r"[\[(]([^\])]*)[\])]", head):
            head = bracketed.group(1).strip()
        for pattern, unit in _UNITS:
            if re.match(f"(?:{pattern}){_UNIT_END}", head):
                return cls(unit)
        return cls.PWM if re.match(r"[^(,;:]*\bpwm\b", head) else cls.UNKNOWN


class TorqueKind(StrEnum):
    """Where `Log.tau` comes from."""

    COMMANDED = "commanded"
    CURRENT = "current"
    SENSOR = "sensor"
    UNKNOWN = "unknown"
