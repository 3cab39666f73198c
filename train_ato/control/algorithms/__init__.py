"""Algorithms shared by laws, observers and compensations."""
