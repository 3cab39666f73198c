"""Shared by every program of the package: version, command line, Ctrl-C and SIGTERM, failure of a run."""
