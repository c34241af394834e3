"""A robot's model from MJCF or URDF, and models written back with other inertial parameters."""
