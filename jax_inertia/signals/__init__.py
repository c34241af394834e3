"""From a log to generalised motion and to the torque that the model leaves unexplained."""
