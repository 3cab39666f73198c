"""Supervision of speed and distance: braking curves, supervision limits and supervisor after SUBSET-026, chapter 3.13.

Pure functions of numbers: no ROS and no files. The conventions are in ``msgs_docs/supervision.md``.
"""
