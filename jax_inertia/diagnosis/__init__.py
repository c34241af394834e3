"""Diagnosis of the whole robot: ordinary physics of every joint at once, and odd effects beyond it, by one evidence."""
