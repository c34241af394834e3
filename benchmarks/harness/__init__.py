"""What the speed and Monte Carlo benchmarks share: one core, clocks, states, and where results go."""
