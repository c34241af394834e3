"""The paper's experiments in closed loop: `python -m benchmarks.paper` reruns them all."""
