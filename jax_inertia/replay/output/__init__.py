"""What a diagnosis by replays is as JSON, as a page, as a figure and for a policy."""
