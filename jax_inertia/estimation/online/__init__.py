"""Online beyond the paper: a filter with exact memory, and a bank that tells which link a load is on."""
