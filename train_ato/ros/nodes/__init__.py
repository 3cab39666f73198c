"""Nodes of the graph: stages of the loop with endpoints from the topic table."""
