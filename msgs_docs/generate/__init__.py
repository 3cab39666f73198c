"""Generators of pages and schemas from the code."""
