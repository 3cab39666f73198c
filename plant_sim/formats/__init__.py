"""Readers of trains and lines in the formats of open libraries."""
