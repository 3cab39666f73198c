"""Layouts of viewers for the run at hand."""
