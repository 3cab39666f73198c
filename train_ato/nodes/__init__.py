"""Nodes of the graph: thin shells around the roles, made from the topic table."""
