"""Trip planner of long trains: traction, electric brake and air-brake applications of a whole journey."""
