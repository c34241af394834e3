"""Arrays only: spatial algebra, inertial parameters, charts, Kalman filtering, least squares. No robot, no log."""
