"""Functions of small arrays as lists of scalar operations: for a GPU's threads, and as C."""
