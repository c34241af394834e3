"""A robot's log: its schema, how it is read from files of many kinds, whole or in chunks, and how it is written."""
