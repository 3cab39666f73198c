"""Recording of a run and what judges it: metrics, stops, tracking, requirements, verdict."""
