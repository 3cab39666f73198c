"""Node graph of a run: its environment, and its execution in one process or in several."""
