"""Choices where a paper gives nothing: declaration, measured sensitivity and page."""
