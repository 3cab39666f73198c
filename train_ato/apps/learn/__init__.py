"""Learning from run to run: the resistance by place that repeats on a line."""
