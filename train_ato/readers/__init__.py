"""Readers of other tools' files: trains and lines from open libraries."""
