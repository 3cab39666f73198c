"""The planner: which speed where, so that time, limits, forces and comfort are kept."""
