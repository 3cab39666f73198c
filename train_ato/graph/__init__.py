"""The node graph: its environment, and running it in one process or in several."""
