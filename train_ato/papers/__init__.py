"""Reproduction of the claims of five papers."""
