"""Operational speed profile: knots over time, its file formats and its sources."""
