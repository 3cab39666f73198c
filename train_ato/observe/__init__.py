"""Disturbance observers."""
