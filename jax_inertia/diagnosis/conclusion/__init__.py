"""What is stated of a selection: its causes, their list, and the diagnosis with its verdict."""
