"""Search for the parameters of a control law that give the best runs of one or more scenarios."""
