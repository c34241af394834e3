"""Several reports at once: side by side, and of a fleet over the dates of its logs."""
