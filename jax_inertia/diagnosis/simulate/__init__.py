"""Found effects in simulation: the corrected model, its step law, rollouts beside the log."""
