"""Effects that a model may lack: one class each, with equation, prior, columns and numbers."""
