"""What is wrong with a log, said before anything is fitted to it."""
