"""The numbers of a replay that fits: errors, their derivatives, steps, and fits."""
