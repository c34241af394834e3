"""Marking: what was right, rates with their bounds, tables and figures."""
