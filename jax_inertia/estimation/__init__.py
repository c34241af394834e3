"""Inertial parameters from logs: filter, batch fit, priors, identifiability, and the motion that excites them."""
