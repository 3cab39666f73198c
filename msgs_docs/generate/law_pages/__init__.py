"""Documentation of laws, observers and compensations: the text from their docstrings, the figures from our own runs."""
