"""Studies over many runs: sweep, search for gains, falsification, learning; case files and contract checks."""
