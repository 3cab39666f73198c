"""Pandas tables of a recorded run: reading of messages in bulk, names and units of the columns."""
