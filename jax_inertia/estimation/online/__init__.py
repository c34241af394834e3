"""Online beyond the paper: a filter with exact memory, a bank that finds which link carries a load, a step in C."""
