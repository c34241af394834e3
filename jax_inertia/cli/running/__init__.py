"""What commands do while they run: show stages, keep compiled programs."""
