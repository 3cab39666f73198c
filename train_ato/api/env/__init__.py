"""Environment: the caller gives the force of every step in place of a law."""
