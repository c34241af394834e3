"""The closed-loop likelihood: torque columns of effects, seen in the positions of a position-controlled robot."""
