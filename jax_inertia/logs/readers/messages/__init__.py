"""Messages of logs, by who defines them: ros2_control, robots' own drivers, loggers without ROS."""
