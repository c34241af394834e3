"""The model of a position-controlled robot with any numbers, and its replays."""
