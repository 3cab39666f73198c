"""Planner of speed profiles within timetable, speed limits, forces and comfort limits."""
