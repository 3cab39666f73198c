"""Nodes in separate processes."""
