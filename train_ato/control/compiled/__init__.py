"""Compiled twins of laws: the same numbers as the laws in Python, bit for bit."""
