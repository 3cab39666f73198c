"""Compensation of the delay between a command and its action."""
