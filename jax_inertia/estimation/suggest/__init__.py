"""A motion that makes parameters identifiable, within the limits of a robot."""
