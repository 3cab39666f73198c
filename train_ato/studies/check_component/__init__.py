"""Contract checks of a control law, an observer or a delay compensation."""
