"""The search for odd effects in replays, and for what would do as well in their place."""
