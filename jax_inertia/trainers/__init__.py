"""What a diagnosis hands to those who train policies: ranges, draws, and files for their simulators."""

SIMULATORS = "isaaclab", "playground"
"""For which `exports.py` writes files; MuJoCo itself reads corrected.xml."""
