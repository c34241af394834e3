"""Found effects in simulation: the corrected model, its step law, rollouts compared with the log."""
