"""Online estimation beyond the paper: honest covariance, which link carries a load, gates, composite adaptation."""
