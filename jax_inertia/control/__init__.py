"""Whole-body control of the humanoid: QP, tasks, walking. A leaf: nothing else in the package imports it."""
