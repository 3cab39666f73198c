"""One run on a grid of CPU targets, threads, modes and Python versions: one hash, or the first difference."""
