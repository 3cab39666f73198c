"""Studies over many runs of a scenario."""
