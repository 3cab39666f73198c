"""Falsification: search for the smallest change of a scenario that breaks a requirement."""
