"""Measured runs: the CSV of an on-board recorder as a profile and a run folder."""
