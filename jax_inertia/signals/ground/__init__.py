"""The ground under a floating base: when feet stand, how deep they sink, and with what forces it holds the robot."""
