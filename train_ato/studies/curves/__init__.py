"""Braking curves from a case file or from a scenario: input, table and figure."""
