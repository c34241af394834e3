"""Position-controlled robots: the closed loop replayed in MuJoCo, and what makes its replays come true."""
